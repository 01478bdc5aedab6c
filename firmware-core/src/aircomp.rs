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
//! Where channels are not known exactly, the same formulas are averaged over the errors
//! ([`uncertainty`](crate::uncertainty)), and the paper's are their case without errors, to the bit.
//!
//! These functions are the reference implementation: solvers work with other forms and are tested
//! against these.

use crate::{
    scalar::Scalar,
    uncertainty::{SensorUncertainty, SlotUncertainty},
    units::{PowerGain, Watt},
};

/// A slot as the receiver observes it: the signals that arrive from every sensor and from the user.
#[derive(Clone, Copy, Debug)]
pub struct Slot<'a, T> {
    /// `|h_j|^2` of every sensor, as it is known; its length is `J`.
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

    /// Returns the normalizing factor of least MSE (eq:eta_), one over square root of watts.
    pub fn normalizing_factor(&self) -> T {
        self.normalizing_factor_under(&Errors::none())
    }

    /// Returns the MSE of the average at a given `eta` (second line of the derivation after eq:md).
    pub fn mse(&self, normalizing_factor: T) -> T {
        self.mse_under(&Errors::none(), normalizing_factor)
    }

    /// Returns the served user's rate (eq:rate), bit/s/Hz.
    pub fn rate(&self) -> T {
        self.rate_under(&Errors::none())
    }

    /// Returns the normalizing factor of least expected MSE: that of [`normalizing_factor`](Self::normalizing_factor) where
    /// the channels differ from the gains by errors of these statistics.
    pub fn expected_normalizing_factor(&self, uncertainty: &SlotUncertainty<'_, T>) -> T {
        self.normalizing_factor_under(&Errors::of(uncertainty))
    }

    /// Returns the expected MSE at a given `eta`: the [`mse`](Self::mse) averaged over errors of these
    /// statistics.
    pub fn expected_mse(&self, uncertainty: &SlotUncertainty<'_, T>, normalizing_factor: T) -> T {
        self.mse_under(&Errors::of(uncertainty), normalizing_factor)
    }

    /// Returns a rate that the served user can achieve with errors of these statistics, bit/s/Hz: what
    /// is not known of a signal counts as noise.
    pub fn achievable_rate(&self, uncertainty: &SlotUncertainty<'_, T>) -> T {
        self.rate_under(&Errors::of(uncertainty))
    }

    /// Returns `E = sum_j (1 + eps_j) |b_j h_j|^2 + sigma^2`, the interference and noise that the
    /// user's signal competes with, watts.
    fn disturbance_w(&self, errors: &Errors<'_, T>) -> T {
        self.amplitudes()
            .zip(errors.sensors())
            .fold(self.noise_power.0, |sum, (y, sensor)| {
                sum + received_power(y, &sensor)
            })
    }

    fn normalizing_factor_under(&self, errors: &Errors<'_, T>) -> T {
        let signals = self.amplitudes().zip(errors.sensors());
        let sum = signals.fold(T::zero(), |sum, (y, sensor)| sum + sensor.coherence() * y);
        sum / (self.disturbance_w(errors) + self.user_signal_w() * errors.user_excess())
    }

    fn mse_under(&self, errors: &Errors<'_, T>, eta: T) -> T {
        let signals = self.amplitudes().zip(errors.sensors());
        let symbol_errors = signals.map(|(y, sensor)| expected_symbol_error(eta * y, &sensor));
        let noise_w = self.user_signal_w() * errors.user_excess() + self.noise_power.0;
        mse(symbol_errors, noise_w, eta)
    }

    fn rate_under(&self, errors: &Errors<'_, T>) -> T {
        let signal_w = self.user_signal_w();
        let noise_w = self.disturbance_w(errors) + errors.user_variance * signal_w;
        (signal_w / noise_w).ln_1p() * T::of(core::f64::consts::LOG2_E)
    }
}

/// The errors that a formula is averaged over.
#[derive(Debug)]
struct Errors<'a, T> {
    /// `None` without errors.
    sensors: Option<&'a [SensorUncertainty<T>]>,
    user_variance: T,
}

impl<'a, T: Scalar> Errors<'a, T> {
    fn none() -> Self {
        Self {
            sensors: None,
            user_variance: T::zero(),
        }
    }

    fn of(uncertainty: &SlotUncertainty<'a, T>) -> Self {
        Self {
            sensors: Some(uncertainty.sensors()),
            user_variance: uncertainty.user_error_variance(),
        }
    }

    /// Returns the statistics of sensor after sensor; those beyond the list are known exactly.
    fn sensors(&self) -> impl Iterator<Item = SensorUncertainty<T>> + use<'a, T> {
        let listed = self.sensors.unwrap_or_default();
        let exact = core::iter::repeat(SensorUncertainty::exactly_known());
        listed.iter().copied().chain(exact)
    }

    fn user_excess(&self) -> T {
        T::one() + self.user_variance
    }
}

/// Returns the expected power of a sensor's signal that arrives with the estimated amplitude `y_j`:
/// `(1 + eps_j) y_j^2`.
fn received_power<T: Scalar>(y: T, sensor: &SensorUncertainty<T>) -> T {
    (T::one() + sensor.error_variance()) * y * y
}

/// Returns the share of a sensor in `J^2 MSE`, `(x - 1)^2`, from `x = eta y_j`.
pub fn symbol_error<T: Scalar>(x: T) -> T {
    let misalignment = x - T::one();
    misalignment * misalignment
}

/// Returns the expected share of a sensor in `J^2 MSE` where its channel is not known exactly,
/// `E|eta b_j h e^(i theta) - 1|^2`, from `x = eta y_j`: `(x - 1)^2 + 2 (1 - rho_j) x + eps_j x^2`.
pub fn expected_symbol_error<T: Scalar>(x: T, sensor: &SensorUncertainty<T>) -> T {
    let incoherence = T::one() - sensor.coherence();
    symbol_error(x) + (incoherence + incoherence) * x + sensor.error_variance() * x * x
}

/// Returns the MSE of an average of sensors, from the share of each ([`symbol_error`] or
/// [`expected_symbol_error`]), beside `q +
/// sigma^2` watts of other signals and noise, at a given `eta`.
pub fn mse<T: Scalar>(
    symbol_errors: impl Iterator<Item = T>,
    noise_w: T,
    normalizing_factor: T,
) -> T {
    let eta = normalizing_factor;
    let (misalignment, sensors) = symbol_errors.fold((T::zero(), 0), |(sum, sensors), error| {
        (sum + error, sensors + 1)
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
