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
//! summed once.
//!
//! The result of a solve is a value: a slot in which no choice meets `Gamma` is
//! [`Status::Infeasible`], with the least MSE that is possible. Errors are for input that is not a
//! slot problem.

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

pub use allocation::SlotAllocation;
pub use error::SlotError;
pub use level::{SensorField, Workspace};
pub use limits::SlotLimits;
pub use method::{ExactSolver, Method, SlotSolver};
pub use prefix_sum::PrefixSum;
pub use solution::{LimitedBy, Solution, Status};
