//! The solution of a slot problem by the convex solver, with verified constraints.

use clarabel::solver::SolverStatus;
use firmware_core::inner::LimitedBy;

/// The status of a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ConicStatus {
    /// The optimum to the solver's accuracy ([`bisect`](super::bisect)), or the point where the iteration
    /// converged ([`alternate`](super::alternate)).
    Solved,
    /// The limit on iterations was reached; the constraints hold.
    IterationLimit,
    /// `Gamma` cannot be met.
    Infeasible,
    /// `Gamma` cannot be met with any power, because the channels are not known well enough.
    ErrorFloor,
    /// Clarabel gave up; the constraints hold for the best point before that.
    SolverFailed(SolverStatus),
}

impl ConicStatus {
    /// Returns whether `Gamma` cannot be met.
    pub fn is_infeasible(&self) -> bool {
        matches!(self, Self::Infeasible | Self::ErrorFloor)
    }
}

/// A solution whose constraints were verified.
#[derive(Clone, Debug, PartialEq)]
pub struct ConicSolution {
    /// The status of the solution.
    pub status: ConicStatus,
    /// The rate `R`, bit/s/Hz.
    pub rate: f64,
    /// The user's power `p`, watts.
    pub user_power_w: f64,
    /// The sensors' coefficients `|b_j|`, square root of watts.
    pub sensor_coefficients: Vec<f64>,
    /// The normalizing factor `eta`, one over square root of watts.
    pub normalizing_factor: f64,
    /// The least MSE that the channels allow, as found by the solver.
    pub least_mse: f64,
    /// The constraint that limits the rate.
    pub limited_by: LimitedBy,
    /// The number of convex problems that were solved.
    pub solves: u32,
}
