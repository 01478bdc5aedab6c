// SPDX-License-Identifier: MIT OR Apache-2.0
//! Parameters of the vehicle that are read before a flight: those that limit the mission, and
//! settings of the autopilot's own failsafes.
//!
//! Parameters are read by name, one after the other; one that does not exist is given up after a
//! few attempts (ArduPilot does not answer). A parameter that limits the mission is reported, and
//! the reference is planned within its limit, so that the vehicle is slow but follows.
//!
//! Nothing is changed, unless
//! [`AutopilotSettings::set_parameters`](super::AutopilotSettings::set_parameters) is set. Then
//! parameters that limit the mission are set to what it needs, and restored after the flight, once
//! the motors stand still.

mod finding;
mod manager;
mod rules;

pub use finding::Finding;
pub use manager::ChangedParameter;
pub(super) use manager::ParameterManager;
pub(super) use rules::Needs;
pub use rules::{Advice, advice};

#[cfg(test)]
mod tests;
