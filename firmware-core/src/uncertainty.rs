// SPDX-License-Identifier: MIT OR Apache-2.0
//! Statistics of channel errors: what is known about channels that are not known exactly.
//!
//! A sensor aligns its signal to an estimate of its channel. The true channel differs from the
//! estimate by an error of zero mean and variance `eps_j |h_j|^2`, and the signal arrives with a
//! random phase error `theta_j` (synchronization, residual carrier offset), of which only the
//! *coherence* `rho_j = E[cos theta_j]` matters. The served user's channel has the relative error
//! variance `eps_g`. Receiver and controller know these statistics, not the errors. All errors are
//! independent. `docs/mathematics.md`, section 10, derives what follows from them:
//!
//! ```text
//! J^2 MSE = sum_j ( (eta y_j - 1)^2 + 2 (1 - rho_j) eta y_j + eps_j (eta y_j)^2 )
//!           + eta^2 ( (1 + eps_g) q + sigma^2 )
//! SINR    = q / ( sigma^2 + sum_j (1 + eps_j) y_j^2 + eps_g q )
//! ```
//!
//! With `eps_j = 0`, `rho_j = 1` and `eps_g = 0` these are the paper's formulas.

use core::{error::Error, fmt};

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::scalar::Scalar;

/// The name of [`SensorUncertainty::error_variance`] in files and messages.
const SENSOR_ERROR_VARIANCE: &str = "sensor_error_variance";
/// The name of the phase error in files and messages.
const SENSOR_PHASE_ERROR: &str = "sensor_phase_error_rad";
/// The name of [`SensorUncertainty::coherence`] in messages.
const SENSOR_COHERENCE: &str = "sensor_coherence";
/// The name of the user's error variance in files and messages.
const USER_ERROR_VARIANCE: &str = "user_error_variance";

/// Error returned for numbers that are not statistics of channel errors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum UncertaintyError<T: fmt::Display> {
    /// A number is out of its range.
    OutOfRange {
        /// The name of the number.
        field: &'static str,
        /// The sensor that it belongs to, where that is known.
        sensor: Option<usize>,
        /// The invalid value.
        value: T,
        /// The valid range.
        expected: &'static str,
    },
    /// There are statistics of more sensors than the type has space for.
    TooManySensors {
        /// The number of sensors.
        sensors: usize,
        /// The capacity.
        capacity: usize,
    },
}

impl<T: fmt::Display> fmt::Display for UncertaintyError<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfRange {
                field,
                sensor: Some(sensor),
                value,
                expected,
            } => write!(f, "{field}[{sensor}] is {value}, but must be {expected}"),
            Self::OutOfRange {
                field,
                sensor: None,
                value,
                expected,
            } => write!(f, "{field} is {value}, but must be {expected}"),
            Self::TooManySensors { sensors, capacity } => write!(
                f,
                "there are error statistics of {sensors} sensors, but the capacity is {capacity}"
            ),
        }
    }
}

impl<T: fmt::Debug + fmt::Display> Error for UncertaintyError<T> {}

impl<T: Scalar> UncertaintyError<T> {
    /// Returns the same error, which names the sensor.
    #[must_use]
    pub fn of_sensor(self, index: usize) -> Self {
        match self {
            Self::OutOfRange {
                field,
                value,
                expected,
                ..
            } => Self::OutOfRange {
                field,
                sensor: Some(index),
                value,
                expected,
            },
            other => other,
        }
    }

    /// Returns an error unless `value` is a variance.
    fn check_variance(field: &'static str, value: T) -> Result<(), Self> {
        Self::check(
            (T::zero()..=T::LARGEST).contains(&value),
            (field, value),
            "a finite variance of at least 0, relative to the power gain",
        )
    }

    pub(crate) fn check(
        is_valid: bool,
        (field, value): (&'static str, T),
        expected: &'static str,
    ) -> Result<(), Self> {
        if is_valid {
            return Ok(());
        }
        Err(Self::OutOfRange {
            field,
            sensor: None,
            value,
            expected,
        })
    }
}

/// The error statistics of one sensor's channel. A value that exists is valid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    try_from = "SensorStatistics<T>",
    into = "SensorStatistics<T>",
    bound = "T: Scalar"
)]
pub struct SensorUncertainty<T> {
    error_variance: T,
    coherence: T,
    /// `(1 + eps_j) / rho_j`.
    excess: T,
    weight: T,
}

/// [`SensorUncertainty`] as it is written.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct SensorStatistics<T> {
    error_variance: T,
    coherence: T,
}

impl<T: Scalar> TryFrom<SensorStatistics<T>> for SensorUncertainty<T> {
    type Error = UncertaintyError<T>;

    fn try_from(written: SensorStatistics<T>) -> Result<Self, Self::Error> {
        Self::new(written.error_variance, written.coherence)
    }
}

impl<T: Scalar> From<SensorUncertainty<T>> for SensorStatistics<T> {
    fn from(sensor: SensorUncertainty<T>) -> Self {
        Self {
            error_variance: sensor.error_variance,
            coherence: sensor.coherence,
        }
    }
}

impl<T: Scalar> Default for SensorUncertainty<T> {
    fn default() -> Self {
        Self::exactly_known()
    }
}

impl<T: Scalar> SensorUncertainty<T> {
    /// Creates the statistics of a channel that is known exactly: `eps_j = 0`, `rho_j = 1`.
    pub fn exactly_known() -> Self {
        Self {
            error_variance: T::zero(),
            coherence: T::one(),
            excess: T::one(),
            weight: T::one(),
        }
    }

    /// Creates statistics from the relative error variance `eps_j` and the coherence `rho_j`.
    ///
    /// # Errors
    /// Returns an error if the variance is NaN, infinite or negative, or if the coherence is not in
    /// (0, 1].
    pub fn new(error_variance: T, coherence: T) -> Result<Self, UncertaintyError<T>> {
        UncertaintyError::check_variance(SENSOR_ERROR_VARIANCE, error_variance)?;
        UncertaintyError::check(
            coherence > T::zero() && coherence <= T::one(),
            (SENSOR_COHERENCE, coherence),
            "above 0 and at most 1",
        )?;
        let power = T::one() + error_variance;
        Ok(Self {
            error_variance,
            coherence,
            // Of a sensor that is hardly coherent the quotient may not be finite.
            excess: (power / coherence).min(T::LARGEST),
            weight: coherence * coherence / power,
        })
    }

    /// As [`new`](Self::new), with a phase error that is Gaussian with the standard deviation
    /// `phase_error_rad` (rad): `rho_j = exp(-phase_error_rad^2 / 2)`.
    ///
    /// # Errors
    /// Returns an error if the variance is NaN, infinite or negative, or if the phase error is not
    /// from 0 to pi.
    pub fn with_phase_error(
        error_variance: T,
        phase_error_rad: T,
    ) -> Result<Self, UncertaintyError<T>> {
        UncertaintyError::check_variance(SENSOR_ERROR_VARIANCE, error_variance)?;
        UncertaintyError::check(
            phase_error_rad >= T::zero() && phase_error_rad <= T::pi(),
            (SENSOR_PHASE_ERROR, phase_error_rad),
            "a standard deviation from 0 to pi (3.1416)",
        )?;
        let coherence = (-phase_error_rad * phase_error_rad / T::of(2.0)).exp();
        Self::new(error_variance, coherence)
    }

    /// Returns `eps_j`, the variance of the channel's error relative to `|h_j|^2`.
    pub fn error_variance(&self) -> T {
        self.error_variance
    }

    /// Returns `rho_j`, the mean cosine of the phase error.
    pub fn coherence(&self) -> T {
        self.coherence
    }

    /// Returns `m_j = rho_j^2 / (1 + eps_j)`, from 0 to 1: what the sensor counts for in the slot
    /// problem, where one that is known exactly counts for 1.
    pub fn weight(&self) -> T {
        self.weight
    }

    /// Returns the amplitude gain `|h_j| (1 + eps_j) / rho_j` by which the slot problem sorts and
    /// limits the sensor, for its estimated amplitude gain `|h_j|`.
    pub fn effective_amplitude(&self, amplitude_gain: T) -> T {
        amplitude_gain * self.excess
    }
}

/// The error statistics of a slot: one entry per sensor, in the order of the gains, and the served
/// user's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlotUncertainty<'a, T> {
    sensors: &'a [SensorUncertainty<T>],
    user_error_variance: T,
}

impl<'a, T: Scalar> SlotUncertainty<'a, T> {
    /// Creates the statistics of a slot; `user_error_variance` is `eps_g`.
    ///
    /// # Errors
    /// Returns an error if the user's variance is NaN, infinite or negative.
    pub fn new(
        sensors: &'a [SensorUncertainty<T>],
        user_error_variance: T,
    ) -> Result<Self, UncertaintyError<T>> {
        UncertaintyError::check_variance(USER_ERROR_VARIANCE, user_error_variance)?;
        Ok(Self {
            sensors,
            user_error_variance,
        })
    }

    /// Returns the statistics of the sensors.
    pub fn sensors(&self) -> &'a [SensorUncertainty<T>] {
        self.sensors
    }

    /// Returns `eps_g`, the variance of the user's channel error relative to `|g|^2`.
    pub fn user_error_variance(&self) -> T {
        self.user_error_variance
    }

    /// Returns `1 + eps_g`: a user signal `q` costs as much accuracy as one of `(1 + eps_g) q` that is
    /// known exactly.
    pub fn user_excess(&self) -> T {
        T::one() + self.user_error_variance
    }
}

/// The error statistics of up to `J` sensors and of the served user, with their own memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    try_from = "Statistics<T, J>",
    into = "Statistics<T, J>",
    bound = "T: Scalar"
)]
pub struct Uncertainty<T, const J: usize> {
    sensors: Vec<SensorUncertainty<T>, J>,
    user_error_variance: T,
}

/// [`Uncertainty`] as it is written.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
struct Statistics<T, const J: usize> {
    sensors: Vec<SensorUncertainty<T>, J>,
    user_error_variance: T,
}

impl<T: Scalar, const J: usize> TryFrom<Statistics<T, J>> for Uncertainty<T, J> {
    type Error = UncertaintyError<T>;

    fn try_from(written: Statistics<T, J>) -> Result<Self, Self::Error> {
        Self::new(&written.sensors, written.user_error_variance)
    }
}

impl<T: Scalar, const J: usize> From<Uncertainty<T, J>> for Statistics<T, J> {
    fn from(uncertainty: Uncertainty<T, J>) -> Self {
        Self {
            sensors: uncertainty.sensors,
            user_error_variance: uncertainty.user_error_variance,
        }
    }
}

impl<T: Scalar, const J: usize> Uncertainty<T, J> {
    /// Creates the statistics of these sensors and of a user with the relative error variance
    /// `eps_g`.
    ///
    /// # Errors
    /// Returns an error if there are more than `J` sensors, or if the user's variance is NaN,
    /// infinite or negative.
    pub fn new(
        sensors: &[SensorUncertainty<T>],
        user_error_variance: T,
    ) -> Result<Self, UncertaintyError<T>> {
        SlotUncertainty::new(sensors, user_error_variance)?;
        let too_many = UncertaintyError::TooManySensors {
            sensors: sensors.len(),
            capacity: J,
        };
        Ok(Self {
            sensors: Vec::from_slice(sensors).map_err(|_| too_many)?,
            user_error_variance,
        })
    }

    /// Returns the statistics as the slot solver takes them.
    pub fn of_slot(&self) -> SlotUncertainty<'_, T> {
        SlotUncertainty {
            sensors: &self.sensors,
            user_error_variance: self.user_error_variance,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    fn refused(
        result: Result<SensorUncertainty<f64>, UncertaintyError<f64>>,
    ) -> std::string::String {
        result.expect_err("refused").to_string()
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        for bad in [-1e-300, f64::NAN, f64::INFINITY] {
            let expected = std::format!(
                "sensor_error_variance is {bad}, but must be a finite variance of at least 0"
            );
            assert!(refused(SensorUncertainty::new(bad, 1.0)).starts_with(&expected));
            assert!(refused(SensorUncertainty::with_phase_error(bad, 0.0)).starts_with(&expected));
            let user = SlotUncertainty::new(&[], bad).expect_err("refused");
            assert!(user.to_string().starts_with("user_error_variance is "));
        }
        for bad in [0.0, -0.5, 1.0 + 1e-15, f64::NAN] {
            let message = refused(SensorUncertainty::new(0.0, bad));
            assert!(message.starts_with("sensor_coherence is "), "{message}");
        }
        for bad in [-0.1, 3.15, f64::NAN, f64::INFINITY] {
            let message = refused(SensorUncertainty::with_phase_error(0.0, bad));
            let expected = "sensor_phase_error_rad is ";
            assert!(message.starts_with(expected), "{message}");
        }
        let named = SensorUncertainty::new(-1.0, 1.0).map_err(|error| error.of_sensor(3));
        assert!(refused(named).starts_with("sensor_error_variance[3] is -1,"));
        let sensors = [SensorUncertainty::exactly_known(); 3];
        let three = Uncertainty::<f64, 2>::new(&sensors, 0.0).expect_err("refused");
        let expected = "there are error statistics of 3 sensors, but the capacity is 2";
        assert_eq!(three.to_string(), expected);
    }

    /// The ends of the ranges are valid in both precisions, and nothing is NaN there.
    #[test]
    fn the_ends_of_the_ranges_are_valid() {
        assert!(SensorUncertainty::with_phase_error(0.0_f32, core::f64::consts::PI as f32).is_ok());
        assert!(SensorUncertainty::with_phase_error(0.0_f64, core::f64::consts::PI).is_ok());
        let worst = SensorUncertainty::new(f32::MAX, f32::MIN_POSITIVE).expect("valid");
        assert_eq!((worst.excess, worst.weight), (f32::MAX, 0.0));
        assert_eq!(worst.effective_amplitude(0.0), 0.0);
        let exact = SensorUncertainty::with_phase_error(0.0, 0.0).expect("valid");
        assert_eq!(exact, SensorUncertainty::<f64>::exactly_known());
    }

    /// What is read back is checked, too.
    #[test]
    fn statistics_are_written_and_read() {
        let sensor = SensorUncertainty::with_phase_error(0.05_f64, 0.3).expect("valid");
        let statistics = Uncertainty::<f64, 2>::new(&[sensor], 0.1).expect("valid");
        let mut buffer = [0; 64];
        let bytes = postcard::to_slice(&statistics, &mut buffer).expect("space");
        assert_eq!(postcard::from_bytes(bytes), Ok(statistics));
        let mut invalid = [0; 16];
        invalid[..8].copy_from_slice(&(-1.0_f64).to_le_bytes());
        invalid[8..].copy_from_slice(&1.0_f64.to_le_bytes());
        assert!(postcard::from_bytes::<SensorUncertainty<f64>>(&invalid).is_err());
    }
}
