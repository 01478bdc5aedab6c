// SPDX-License-Identifier: MIT OR Apache-2.0
//! The slot problem (eq:p1): the powers, coefficients and normalizing factor that give the
//! served user the highest rate while the average stays accurate.
//!
//! ```text
//! maximise R   subject to   MSE <= Gamma         (eq:mse)
//!                           |b_j|^2 <= p_b^max   (eq:bjn)
//!                           0 <= p <= p^max      (eq:pmn)
//!                           eta >= 0             (eq:eta0)
//! ```
//!
//! [`exact`] solves it in closed form and is the default; [`alternating`] is the paper's own
//! algorithm; [`bounded`] gives guarantees for gains within bounds; [`Method`] also has the paper's
//! comparison schemes. All of them work on a [`SensorField`]: the sensors of a position, sorted and
//! summed once. Where channels are not known exactly, an [`UncertainWorkspace`] makes a field from
//! their error statistics ([`uncertainty`](crate::uncertainty)); every method then solves the slot
//! for the expected MSE and an achievable rate.
//!
//! The result of a solve is a value: a slot in which no choice meets `Gamma` is
//! [`Status::Infeasible`], with the least MSE that is possible, or [`Status::ErrorFloor`] where no
//! power would help. Errors are for input that is not a
//! slot problem.

//!
//! ```
//! use firmware_core::{PowerGain, Watt, inner::{SlotLimits, Status, Workspace}};
//!
//! let limits = SlotLimits {
//!     sensor_power_max: Watt(0.05),
//!     user_power_max: Watt(0.2),
//!     noise_power: Watt::from_dbm(-95.0),
//!     mse_threshold: 0.015,
//! };
//! let mut workspace = Workspace::<f64, 8>::default();
//! let near = [PowerGain(4e-10), PowerGain(3e-10), PowerGain(5e-10)];
//! let field = workspace.sensors(&limits, &near)?;
//! let slot = field.solve(Some(PowerGain(2e-12)))?;
//! assert!(slot.status.is_feasible() && slot.user_power.0 <= 0.2);
//!
//! // Sensors that are too far: no powers meet the threshold, and the least MSE is reported.
//! let far = [PowerGain(4e-16); 3];
//! let field = workspace.sensors(&limits, &far)?;
//! let slot = field.solve(Some(PowerGain(2e-12)))?;
//! assert!(matches!(slot.status, Status::Infeasible { .. }));
//! # Ok::<(), firmware_core::inner::SlotError<f64>>(())
//! ```

mod allocation;
pub mod alternating;
pub mod bounded;
mod error;
pub mod exact;
mod level;
mod limits;
mod method;
mod prefix_sum;
mod rate;
mod scheme;
mod solution;
mod sort;
mod weighted;

pub use allocation::SlotAllocation;
pub use error::SlotError;
pub use level::{SensorField, UncertainWorkspace, Workspace};
pub use limits::SlotLimits;
pub use method::{ExactSolver, Method, SlotSolver};
pub use prefix_sum::PrefixSum;
pub use solution::{LimitedBy, Solution, Status};
pub use weighted::WeightedAmplitude;
