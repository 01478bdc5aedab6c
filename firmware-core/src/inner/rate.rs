// SPDX-License-Identifier: MIT OR Apache-2.0
//! The rate of a user.

use super::level::{Level, SensorField};
use crate::scalar::Scalar;

/// Returns `log2(1 + sinr)`, also accurate for small `sinr`.
pub(super) fn rate_of_sinr<T: Scalar>(sinr: T) -> T {
    sinr.ln_1p() * T::of(core::f64::consts::LOG2_E)
}

impl<T: Scalar> SensorField<'_, T> {
    /// Returns the rate of a user signal at a level, bit/s/Hz. What is not known of the signal counts
    /// as noise: with `s = (1 + eps_g) q / E`, the SINR `q / (E + eps_g q)` is `s / (1 + eps_g + eps_g s)`.
    pub(super) fn rate_of(&self, signal: T, level: &Level<T>) -> T {
        let s = signal / level.energy;
        rate_of_sinr(match self.sorted.uncertainty() {
            None => s,
            Some(uncertainty) => {
                s / (uncertainty.user_excess() + uncertainty.user_error_variance() * s)
            }
        })
    }
}
