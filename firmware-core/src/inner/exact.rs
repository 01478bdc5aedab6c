// SPDX-License-Identifier: MIT OR Apache-2.0
//! The global optimum of the slot problem in closed form (`docs/mathematics.md`, section 3).
//!
//! With `q = p |g|^2 / sigma^2`, `Q = p^max |g|^2 / sigma^2` and the levels of [`SensorField`], the
//! slot problem has one unknown number: the slot is feasible iff `f(c*) >= kappa`, and then either
//! **accuracy** limits it (`c = c*`) or **power** does (`q = Q`, and `c` is the root below `c*` of
//! `A^2 = kappa (Q + E)`: between two neighbouring `a_j` a quadratic).
//!
//! Where channels are not known exactly, the levels are weighted and `q`, `Q` are `1 + eps_g` times as
//! large; all formulas keep their form (section 10).
//!
//! Worst case per user, once the sensors are sorted: `log2 J` comparisons and one quadratic; no
//! iteration to a tolerance, no allocation.

use super::{
    LimitedBy, SlotError, Solution, Status,
    level::{Level, Segment, SensorField},
};
use crate::{scalar::Scalar, units::PowerGain};

impl<T: Scalar> SensorField<'_, T> {
    /// Returns the optimal solution with a user of gain `|g|^2` served, or nobody (`None`).
    ///
    /// Where no rate is possible, the solution of least MSE is returned.
    ///
    /// # Errors
    /// Returns an error if a gain is NaN, infinite or negative.
    pub fn solve(&self, user: Option<PowerGain<T>>) -> Result<Solution<T>, SlotError<T>> {
        let gain = SlotError::check_user(user)?;
        let (status, level, signal) = self.operating_point(self.normalized_budget(gain));
        Ok(self.solution(status, &level, signal, gain))
    }

    /// Returns only the rate of the solution that `solve` would return, bit/s/Hz; 0 where the slot
    /// is infeasible or the gain is invalid. This is cheaper than `solve`.
    pub fn rate(&self, user: PowerGain<T>) -> T {
        if !user.is_valid() {
            return T::zero();
        }
        let (_, level, signal) = self.operating_point(self.normalized_budget(user));
        self.rate_of(signal, &level)
    }

    /// Returns the status, level and user signal `q` of the optimum for a budget `Q`.
    fn operating_point(&self, budget: T) -> (Status<T>, Level<T>, T) {
        let optimal = |limited_by| Status::Optimal { limited_by };
        if !self.is_feasible() {
            return (self.infeasible(self.least_mse()), self.peak, T::zero());
        }
        if budget <= T::zero() {
            return (optimal(LimitedBy::None), self.peak, T::zero());
        }
        let affordable = self.affordable_signal();
        if affordable <= budget {
            return (optimal(LimitedBy::Accuracy), self.peak, affordable);
        }
        let level = self.quietest_level(budget);
        (optimal(LimitedBy::Power), level, budget)
    }

    /// Returns the largest user signal that `Gamma` allows at the peak: `(f(c*)/kappa - 1) E(c*)`.
    pub(super) fn affordable_signal(&self) -> T {
        let headroom = self.peak.efficiency() / self.kappa - T::one();
        headroom.max(T::zero()) * self.peak.energy
    }

    /// Returns the least level at which the average tolerates a user signal `q`: the root below
    /// `c*` of `D(c) = A(c)^2 - kappa (q + E(c))`, which the caller knows to be positive at `c*`.
    /// Wherever `f >= kappa`, `D` rises, and below that it is negative: it changes sign once.
    pub(super) fn quietest_level(&self, signal: T) -> Level<T> {
        let reaches = |segment: Segment<T>, c: T| {
            let level = segment.level(c);
            level.sum * level.sum >= self.kappa * (signal + level.energy)
        };
        // With r sensors at the level, P and W the sums below, divided by r:
        // (r - kappa) c^2 + 2 P c - (kappa (q + 1 + W) - P^2) / r = 0. The root where D rises,
        // in the form that does not cancel.
        self.first_level(self.peak.c, reaches, |Segment { strong, below }| {
            let missing = (self.kappa * (signal + T::one() + below.energy)
                - below.amplitude * below.amplitude)
                / strong;
            let discriminant = below.amplitude * below.amplitude + (strong - self.kappa) * missing;
            missing / (below.amplitude + discriminant.max(T::zero()).sqrt())
        })
    }
}
