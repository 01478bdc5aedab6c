// SPDX-License-Identifier: MIT OR Apache-2.0
//! Laws over all inputs of small sizes.
//!
//! Each harness takes its input from [`choices`]. As a test it runs for every combination of the
//! values; under `cargo kani --tests -p firmware-core` the values are symbolic, and the same laws are
//! proved for them (see CONTRIBUTING.md).

#![allow(unexpected_cfgs)] // Kani sets `kani`

mod choices;
mod parsers;
mod shield;
mod solver;
#[path = "../../src/test_missions.rs"]
mod test_missions;
