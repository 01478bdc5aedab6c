// SPDX-License-Identifier: MIT OR Apache-2.0
//! Tests of policies for any mission.

mod missions;
mod observation;
