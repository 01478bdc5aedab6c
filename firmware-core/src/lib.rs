//! The onboard controller.
#![no_std]
#![deny(missing_docs)]

#[cfg(test)]
extern crate std;

pub mod aircomp;
pub mod autopilot;
pub mod channel;
pub mod controller;
pub mod inner;
pub mod link;
pub mod mission;
pub mod onboard;
pub mod policy;
pub mod scalar;
pub mod shield;
#[cfg(test)]
mod test_missions;
pub mod time;
pub mod units;

pub use mission::Mission;
pub use scalar::{Displacement, Position, Scalar};
pub use units::{PowerGain, Watt};

/// Users that the controller holds at its default capacity.
pub const USERS_MAX: usize = 16;
/// Sensors that the controller holds at its default capacity.
pub const SENSORS_MAX: usize = 64;
