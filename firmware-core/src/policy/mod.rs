// SPDX-License-Identifier: MIT OR Apache-2.0
//! Policies decide where to fly and which user to serve.
//!
//! A [`Policy`] receives an [`Observation`] (the paper's state `s_n`, M + 4 numbers) and returns an
//! [`Action`]: a displacement and a score per user. A policy may return anything: the
//! [shield](crate::shield) makes every action admissible.
//!
//! This module has the two rule-based policies of the paper's comparisons, and trained ones:
//! [`mlp`] flies the map that it was trained on and [`sets`] any map, both on every platform and from
//! a `.policy` file; `onnx` (a feature, needs std) runs `.onnx` files.

mod container;
mod interface;
pub mod mlp;
#[cfg(feature = "onnx")]
pub mod onnx;
mod provenance;
mod rules;
pub mod sets;

pub use container::{ContainerError, format_version};
pub use interface::{
    Action, MeasuredGains, OUTPUT_EXTRA, Observation, PlanQuality, Policy, STATE_EXTRA, output_len,
    state_len,
};
pub use provenance::{PolicyMismatch, Provenance, REQUIRED_METADATA};
pub use rules::{FixedPosition, StraightLine};
