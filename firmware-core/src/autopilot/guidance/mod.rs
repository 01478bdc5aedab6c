// SPDX-License-Identifier: MIT OR Apache-2.0
//! Where the vehicle should be *now*: trajectories between waypoints.
//!
//! Autopilots treat a bare position as a place to stop at; flown at the mission's speed the vehicle
//! lags by a hundred metres. The client therefore streams position, velocity and acceleration of a
//! moving reference. A [`Trajectory`] is a polynomial of degree five per axis, defined by position,
//! velocity and acceleration at both ends; the acceleration at its end is zero.
//!
//! [`Guide`] connects trajectories:
//!
//! * a **leg** reaches its waypoint at the slot's end, passing through it with the mean velocity of
//!   the leg. Where [`MotionLimits`](crate::MotionLimits) do not allow that (from rest, round a sharp
//!   corner, to a place behind the vehicle) the acceleration changes, linearly over the leg, to the
//!   one that follows the waypoints best: their own velocity, plus a correction no faster than can be
//!   braked.
//! * a **transit** goes from rest to rest, in the least time that the limits allow.
//! * a **coast** follows a leg until the next one is known: the vehicle flies on with the leg's
//!   final velocity while its position is measured and the next waypoint is decided.
//! * a **stop** follows a trajectory that was not continued: the reference decelerates to rest. A
//!   stream never ends with a velocity in it.
//!
//! All times in this module are on the vehicle's clock.

mod guide;
mod motion;
mod trajectory;

pub use guide::Guide;
pub use motion::Motion;
pub use trajectory::Trajectory;

#[cfg(test)]
mod tests;
