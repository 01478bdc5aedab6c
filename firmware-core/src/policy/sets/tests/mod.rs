// SPDX-License-Identifier: MIT OR Apache-2.0
//! Tests of policies for any mission.

mod features;
mod file;
mod missions;
mod network;
mod observation;
mod policy;
mod reference;
