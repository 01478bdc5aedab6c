// SPDX-License-Identifier: MIT OR Apache-2.0
//! Over-the-air computation in one slot: mean-square error, rate and normalizing factor, each
//! as the paper prints it, for any powers and coefficients.
//!
//! The received signal is eq:yr; the average is estimated as `F-hat = eta s-hat / J` (eq:Fhat).
//! Phases are aligned (each `b_j` carries the conjugate phase of its channel), so the magnitudes
//! below are all that matters. In the paper's symbols, with `y_j = |b_j h_j|`, `q = |g|^2 p`:
//!
//! ```text
//! MSE = ( sum_j (eta y_j - 1)^2 + eta^2 (q + sigma^2) ) / J^2        second line of eq:md
//! R   = log2( 1 + q / (sum_j y_j^2 + sigma^2) )                      eq:rate, eta cancels
//! eta = sum_j y_j / (sum_j y_j^2 + q + sigma^2)                      eq:eta_, least MSE
//! ```
//!
//! These functions are the reference implementation: solvers work with other forms and are tested
//! against these.

use crate::{
    scalar::Scalar,
    units::{PowerGain, Watt},
};

/// A slot as the receiver observes it: the signals that arrive from every sensor and from the user.
#[derive(Clone, Copy, Debug)]
pub struct Slot<'a, T> {
    /// `|h_j|^2` of every sensor; its length is `J`.
    pub sensor_gains: &'a [PowerGain<T>],
    /// `|b_j|`, square root of watts; one per sensor.
    pub sensor_coefficients: &'a [T],
    /// `|g|^2` of the served user; any value where no user is served and the power is 0.
    pub user_gain: PowerGain<T>,
    /// `p`, the served user's power.
    pub user_power: Watt<T>,
    /// `sigma^2`.
    pub noise_power: Watt<T>,
}

impl<T: Scalar> Slot<'_, T> {
    /// Returns `y_j = |b_j h_j|`, the received amplitudes, square root of watts.
    fn amplitudes(&self) -> impl Iterator<Item = T> + '_ {
        self.sensor_gains
            .iter()
            .zip(self.sensor_coefficients)
            .map(|(gain, &coefficient)| coefficient * gain.amplitude())
    }

    /// Returns `q = |g|^2 p`, watts.
    fn user_signal_w(&self) -> T {
        self.user_gain.0 * self.user_power.0
    }

    /// Returns `sum_j |b_j h_j|^2 + sigma^2`, the interference and noise that the user's signal
    /// competes with, watts.
    fn disturbance_w(&self) -> T {
        self.amplitudes()
            .fold(self.noise_power.0, |sum, y| sum + y * y)
    }

    /// Returns the normalizing factor of least MSE (eq:eta_), one over square root of watts.
    pub fn normalizing_factor(&self) -> T {
        let sum = self.amplitudes().fold(T::zero(), |sum, y| sum + y);
        sum / (self.disturbance_w() + self.user_signal_w())
    }

    /// Returns the MSE of the average at a given `eta` (second line of the derivation after eq:md).
    pub fn mse(&self, normalizing_factor: T) -> T {
        let noise_w = self.user_signal_w() + self.noise_power.0;
        mse(self.amplitudes(), noise_w, normalizing_factor)
    }

    /// Returns the served user's rate (eq:rate), bit/s/Hz.
    pub fn rate(&self) -> T {
        let sinr = self.user_signal_w() / self.disturbance_w();
        sinr.ln_1p() * T::of(core::f64::consts::LOG2_E)
    }
}

/// Returns the MSE of an average of sensors whose signals arrive with the amplitudes `y_j` (square
/// root of watts), beside `q + sigma^2` watts of other signals and noise, at a given `eta`.
pub fn mse<T: Scalar>(amplitudes: impl Iterator<Item = T>, noise_w: T, normalizing_factor: T) -> T {
    let eta = normalizing_factor;
    let (misalignment, sensors) = amplitudes.fold((T::zero(), 0), |(sum, sensors), y| {
        let error = eta * y - T::one();
        (sum + error * error, sensors + 1)
    });
    let sensors = T::count(sensors);
    (misalignment + eta * eta * noise_w) / (sensors * sensors)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAINS: [PowerGain<f64>; 3] = [PowerGain(4e-12), PowerGain(1e-12), PowerGain(0.0)];

    fn slot(user_power_w: f64) -> Slot<'static, f64> {
        Slot {
            sensor_gains: &GAINS,
            sensor_coefficients: &[0.1, 0.2, 0.05],
            user_gain: PowerGain(2e-12),
            user_power: Watt(user_power_w),
            noise_power: Watt(3e-13),
        }
    }

    /// The closed form is a minimum: a step to either side costs.
    #[test]
    fn normalizing_factor_minimises_the_mse() {
        let slot = slot(0.1);
        let eta = slot.normalizing_factor();
        let least = slot.mse(eta);
        for factor in [0.5, 0.9, 0.999, 1.001, 1.1, 2.0] {
            assert!(slot.mse(eta * factor) > least);
        }
        // A^2 / (q + E) saved of J: the identity that the exact solver uses.
        let a = 0.1 * 2e-6 + 0.2 * 1e-6;
        let e = 0.01 * 4e-12 + 0.04 * 1e-12 + 3e-13 + 0.1 * 2e-12;
        assert!((least - (3.0 - a * a / e) / 9.0).abs() < 1e-12);
    }

    #[test]
    fn a_silent_user_has_no_rate() {
        assert_eq!(slot(0.0).rate(), 0.0);
        let sinr: f64 = 0.1 * 2e-12 / (0.01 * 4e-12 + 0.04 * 1e-12 + 3e-13);
        assert!((slot(0.1).rate() - (1.0 + sinr).log2()).abs() < 1e-12);
    }
}
