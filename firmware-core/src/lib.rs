// SPDX-License-Identifier: MIT OR Apache-2.0
//! The onboard controller of a UAV that serves ground users' uplinks and, on the same frequency
//! and in the same slots, computes the average of what ground sensors measure over the air.
//!
//! The crate uses no std, no allocator, no I/O, no clock, no threads and no globals: bytes and time
//! come in as arguments, bytes and decisions go out. Everything numeric is generic over [`Scalar`]
//! (`f64` on a host, `f32` on a microcontroller).
//!
//! # Capacities
//!
//! The types are generic over their capacities `M` for users and `J` for sensors, 16 and 64 by
//! default; a mission has that many or fewer. All that grows with users or sensors follows `M` and `J`.
//! Together they may be 65,535. The frames of the ground link are as long as `M`, `J` and the number
//! type need: [`link::secure_frame_max`] computes the length, and a decoder, an end of the link, an
//! onboard computer or a buffer that is too short for its messages does not compile. Lengths that
//! depend neither on users nor on sensors are constants of the modules; the memory of the planner is
//! the caller's and follows [`planner::Capacity`].
//!
//! # A slot
//!
//! ```text
//! measured position --plan--> admissible waypoint + user --(fly)--> channel state --allocate--> slot command
//!                    ^                                                                              |
//!                    +-------------- state [counts; R_n; MSE_n; x_n, y_n] (M + 4) <-----------------+
//! ```
//!
//! # The modules, from the paper's equations to the vehicle
//!
//! | module | feature | contents |
//! |---|---|---|
//! | [`mission`] | | the validated parameters of a mission (Table I) |
//! | [`channel`] | | the mean gain: the probabilistic line of sight (eq:gain to eq:gmn), and 3GPP's models |
//! | [`aircomp`] | | MSE, rate and normalizing factor as printed: the reference implementation |
//! | [`uncertainty`] | | statistics of channel errors |
//! | [`inner`] | | the slot problem (eq:p1): the exact optimum, and the paper's own algorithm |
//! | [`shield`] | | the hard constraints, enforced on every action of a policy |
//! | [`policy`] | `policy` | the policies that decide where to fly and whom to serve |
//! | [`controller`] | `policy` | the slot cycle: plan, then allocate |
//! | [`planner`] | `planner` | a near-optimal plan for any mission, improved step by step, also in flight |
//! | [`link`] | `link` | frames to and from the ground |
//! | [`autopilot`] | `autopilot` | the MAVLink client |
//! | [`onboard`] | `link`, `autopilot` | the whole onboard computer: bytes in, bytes out |
//! | [`console`] | `link`, `autopilot`, `planner` | orders to a board before a flight, and its test bench |
//! | [`time`], [`scalar`], [`units`], [`limits`], [`counter`] | | time, numbers, units, limits and counters that the other modules use |
//!
//! Without features the crate depends on nalgebra, heapless, libm and serde only. `onnx` adds
//! policies as ONNX files and needs std; `defmt` adds `defmt::Format`, `embassy-time` conversions
//! of times.
//!
//! # A slot problem, solved
//!
//! ```
//! use firmware_core::{PowerGain, Watt, inner::{SlotLimits, Workspace}};
//!
//! let limits = SlotLimits {
//!     sensor_power_max: Watt(0.05),
//!     user_power_max: Watt(0.2),
//!     noise_power: Watt::from_dbm(-95.0),
//!     mse_threshold: 0.015,
//! };
//! let sensors = [PowerGain(4e-12); 36];
//! let mut workspace = Workspace::<f64, 64>::default();
//! let field = workspace.sensors(&limits, &sensors)?;
//! let slot = field.solve(Some(PowerGain(2e-12)))?;
//! assert!(slot.status.is_feasible());
//! // No position can do better: log2(1 / (1 - J Gamma)).
//! assert!(slot.rate > 0.0 && slot.rate < 1.121);
//! # Ok::<(), firmware_core::inner::SlotError<f64>>(())
//! ```
#![no_std]
#![deny(missing_docs)]

#[cfg(any(test, feature = "onnx"))]
extern crate std;

#[cfg(all(feature = "onnx", target_os = "none"))]
compile_error!(
    "the feature `onnx` needs std, which this target does not have: convert the policy with \
     `trainer convert F.onnx F.policy`, and use the feature `policy`"
);

pub mod aircomp;
#[cfg(feature = "autopilot")]
pub mod autopilot;
pub mod channel;
mod collect;
#[cfg(all(feature = "link", feature = "planner", feature = "autopilot"))]
pub mod console;
#[cfg(feature = "policy")]
pub mod controller;
pub mod counter;
pub mod inner;
pub mod limits;
#[cfg(feature = "link")]
pub mod link;
pub mod mission;
#[cfg(all(feature = "link", feature = "autopilot"))]
pub mod onboard;
#[cfg(feature = "policy")]
mod place_rates;
#[cfg(feature = "planner")]
pub mod planner;
#[cfg(feature = "policy")]
pub mod policy;
pub mod scalar;
pub mod shield;
mod sort;
// `test_missions` names the crate as the tests in `tests/` do.
#[cfg(test)]
extern crate self as firmware_core;
#[cfg(test)]
mod test_missions;
pub mod time;
pub mod uncertainty;
pub mod units;

// The examples of the README are tested.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}

// Crates whose types appear in this crate's interface.
pub use heapless;
#[cfg(feature = "autopilot")]
pub use mavlink;
pub use nalgebra;

pub use limits::MotionLimits;
pub use mission::Mission;
pub use scalar::{Displacement, Position, Scalar};
pub use units::{PowerGain, Watt};

/// Users that the controller holds at its default capacity.
pub const USERS_MAX: usize = 16;
/// Sensors that the controller holds at its default capacity.
pub const SENSORS_MAX: usize = 64;
