// SPDX-License-Identifier: MIT OR Apache-2.0
//! From gains to powers, coefficients and the MSE that they give: the one path that the controller,
//! the training environment and `host-sim solve` take.

use super::{error::SlotError, level::SensorField, method::SlotSolver, solution::Solution};
use crate::{aircomp, scalar::Scalar, units::PowerGain};

/// A solved slot and the MSE of its average.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlotAllocation<T> {
    /// Powers, normalizing factor, rate and status.
    pub solution: Solution<T>,
    /// The MSE of the average with these powers and coefficients, in the paper's own form (second
    /// line after eq:md); where channels are not known exactly, its expectation.
    pub mse: T,
}

impl<T: Scalar> SensorField<'_, T> {
    /// Solves the slot with a user of gain `|g|^2` served, or nobody (`None`), and writes `|b_j|` of
    /// every sensor, square root of watts, into `coefficients`. `amplitude_gains` are the `|h_j|`
    /// that the field was made of, in the order in which the coefficients are wanted: the field
    /// keeps them sorted only.
    ///
    /// Worst case: that of the solver, and `O(J)`.
    ///
    /// # Errors
    /// Returns an error if the user's gain is NaN, infinite or negative.
    pub fn allocate(
        &self,
        solver: &impl SlotSolver<T>,
        amplitude_gains: &[T],
        user: Option<PowerGain<T>>,
        coefficients: &mut [T],
    ) -> Result<SlotAllocation<T>, SlotError<T>> {
        let solution = solver.solve(self, user)?;
        let signal_w = user.unwrap_or_default().0 * solution.user_power.0;
        let eta = solution.normalizing_factor;
        let noise_power = self.limits().noise_power.0;
        let sensors = amplitude_gains.iter().zip(coefficients);
        let mse = match self.sorted.uncertainty() {
            None => {
                let symbol_errors = sensors.map(|(&amplitude, coefficient)| {
                    *coefficient = solution.coefficient_of_amplitude(amplitude);
                    aircomp::symbol_error(eta * (*coefficient * amplitude))
                });
                aircomp::mse(symbol_errors, signal_w + noise_power, eta)
            }
            Some(uncertainty) => {
                let sensors = sensors.zip(uncertainty.sensors());
                let symbol_errors = sensors.map(|((&amplitude, coefficient), sensor)| {
                    let effective = sensor.effective_amplitude(amplitude);
                    *coefficient = solution.coefficient_of_amplitude(effective);
                    aircomp::expected_symbol_error(eta * (*coefficient * amplitude), sensor)
                });
                let noise_w = signal_w * uncertainty.user_excess() + noise_power;
                aircomp::mse(symbol_errors, noise_w, eta)
            }
        };
        Ok(SlotAllocation { solution, mse })
    }
}
