// SPDX-License-Identifier: MIT OR Apache-2.0
//! The validated parameters of a mission: the paper's Table I and the positions of everything.
//!
//! [`MissionParameters`] is the unchecked input; [`Mission::new`] is the only function that checks
//! it. A [`Mission`] that exists is valid, and the rest of the crate relies on it:
//!
//! * every number is finite, every length, duration, speed and power in its range;
//! * start and destination lie in the area `Lambda`, and the destination can be reached:
//!   `||q_o - q_f|| <= (N + 1) V_max delta` (arrival means that `q_f` is at most one more slot
//!   away, eq:traj2 as corrected in `docs/mathematics.md`);
//! * `Gamma < 1/J`, so that the accuracy constraint is not met trivially.
//!
//! What is known of a mission can change in flight: [`Mission::change`]. Users and sensors that left
//! keep their numbers and are [absent](Mission::has_user).

mod change;
mod check;
mod error;
mod parameters;
mod tolerance;
mod validated;

pub use change::{ChangeError, MissionChange};
pub use check::SLOTS_MAX;
pub use error::{MissionError, Parameter};
pub use parameters::{Area, Environment, ExcessLoss, MissionParameters, RadioModel};
pub use tolerance::{MEASUREMENT_M, rounding_m};
pub use validated::Mission;
