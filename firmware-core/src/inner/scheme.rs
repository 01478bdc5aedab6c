// SPDX-License-Identifier: MIT OR Apache-2.0
//! The paper's comparison schemes: one variable is fixed, the rest is still optimal, each in closed
//! form (`docs/mathematics.md`, section 6, derives them).
//!
//! * **Fixed user power**: `p` is `p_f` or, where the average could not be accurate beside it, 0.
//!   With `q` given the rate is highest where `E` is least: the least level at which the average
//!   tolerates `q`.
//! * **Fixed sensor power**: `|b_j|^2 = p_f` for every sensor. `A` and `E` are given, and the user
//!   may transmit with the power that accuracy leaves, `q = A^2 / kappa - E`.
//!
//! The paper does not give the powers; they are parameters here.

use super::{LimitedBy, SlotError, Solution, Status, level::Level, level::SensorField};
use crate::{
    scalar::Scalar,
    units::{PowerGain, Watt},
};

impl<T: Scalar> SensorField<'_, T> {
    /// Returns the best solution in which the user transmits with `power` (at most `p^max`) or not
    /// at all. Worst case: `log2 J` comparisons and one quadratic.
    ///
    /// # Errors
    /// Returns an error if a gain is NaN, infinite or negative.
    pub fn with_fixed_user_power(
        &self,
        user: Option<PowerGain<T>>,
        power: Watt<T>,
    ) -> Result<Solution<T>, SlotError<T>> {
        let gain = SlotError::check_user(user)?;
        let fraction = (power.0 / self.limits.user_power_max.0).min(T::one());
        let signal = self.normalized_budget(gain) * fraction;
        // This is also false for 0/0, where there is no power to fix.
        if !(self.is_feasible() && signal > T::zero()) {
            return self.solve(None);
        }
        if signal > self.affordable_signal() {
            let status = Status::Optimal {
                limited_by: LimitedBy::Accuracy,
            };
            return Ok(self.solution(status, &self.peak, T::zero(), gain));
        }
        let status = Status::Optimal {
            limited_by: LimitedBy::Power,
        };
        let level = self.quietest_level(signal);
        Ok(self.solution(status, &level, signal, gain))
    }

    /// Returns the best solution in which every sensor transmits with `power` (at most `p_b^max`);
    /// infeasible where accuracy would need sensors to reduce it. Worst case: `O(1)` once the sums
    /// are computed.
    ///
    /// # Errors
    /// Returns an error if a gain is NaN, infinite or negative.
    pub fn with_fixed_sensor_power(
        &self,
        user: Option<PowerGain<T>>,
        power: Watt<T>,
    ) -> Result<Solution<T>, SlotError<T>> {
        let gain = SlotError::check_user(user)?;
        let budget = self.normalized_budget(gain);
        let coefficient = power.0.max(T::zero()).sqrt().min(self.coefficient_max);
        let fraction = if coefficient > T::zero() {
            coefficient / self.coefficient_max
        } else {
            T::zero()
        };
        let all = self.at_full_power();
        let level = Level {
            sum: all.sum * fraction,
            energy: T::one() + (all.energy - T::one()) * fraction * fraction,
            ..all
        };
        let affordable = (level.efficiency() / self.kappa - T::one()) * level.energy;
        let (status, signal) = if level.efficiency() < self.limits.kappa(self.sensor_count()) {
            let sensors = T::count(self.sensor_count());
            let least_mse = (sensors - level.efficiency()) / (sensors * sensors);
            (self.infeasible(least_mse), T::zero())
        } else {
            let limited_by = if budget <= T::zero() {
                LimitedBy::None
            } else if affordable <= budget {
                LimitedBy::Accuracy
            } else {
                LimitedBy::Power
            };
            let signal = affordable.max(T::zero()).min(budget);
            (Status::Optimal { limited_by }, signal)
        };
        Ok(Solution {
            // No sensor reduces its amplitude to a level.
            level: T::max_value().unwrap_or(self.noise_amplitude),
            coefficient_max: coefficient,
            ..self.solution(status, &level, signal, gain)
        })
    }
}
