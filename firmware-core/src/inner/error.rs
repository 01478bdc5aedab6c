// SPDX-License-Identifier: MIT OR Apache-2.0
//! Errors for input that is not a slot problem.

use core::{error::Error, fmt};

use crate::{scalar::Scalar, uncertainty::UncertaintyError, units::PowerGain};

/// Error returned for input that is not a slot problem.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SlotError<T: fmt::Display> {
    /// There are no sensors to average.
    NoSensors,
    /// A sensor's gain is NaN, infinite or negative.
    SensorGain {
        /// Which sensor.
        index: usize,
        /// Its gain.
        value: T,
    },
    /// The user's gain is NaN, infinite or negative.
    UserGain {
        /// The gain.
        value: T,
    },
    /// A limit or an error statistic is out of its range.
    OutOfRange {
        /// The name of the number.
        field: &'static str,
        /// The invalid value.
        value: T,
        /// The valid range.
        expected: &'static str,
    },
    /// There are not as many error statistics as sensors.
    UncertaintyCount {
        /// The number of error statistics.
        statistics: usize,
        /// `J`, the number of sensors.
        sensors: usize,
    },
    /// The workspace is too small.
    TooManySensors {
        /// `J`, the number of sensors.
        sensors: usize,
        /// The capacity of the workspace.
        capacity: usize,
    },
}

impl<T: fmt::Display> fmt::Display for SlotError<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoSensors => {
                f.write_str("sensor_gain is empty, but at least one sensor must be averaged")
            }
            Self::SensorGain { index, value } => write!(
                f,
                "sensor_gain[{index}] is {value}, but must be a finite power gain of at least 0"
            ),
            Self::UserGain { value } => write!(
                f,
                "user_gain is {value}, but must be a finite power gain of at least 0"
            ),
            Self::OutOfRange {
                field,
                value,
                expected,
            } => write!(f, "{field} is {value}, but must be {expected}"),
            Self::UncertaintyCount {
                statistics,
                sensors,
            } => write!(
                f,
                "there are error statistics of {statistics} sensors, but gains of {sensors}"
            ),
            Self::TooManySensors { sensors, capacity } => write!(
                f,
                "there are {sensors} sensors, but the capacity is {capacity}"
            ),
        }
    }
}

impl<T: fmt::Debug + fmt::Display> Error for SlotError<T> {}

impl<T: Scalar> From<UncertaintyError<T>> for SlotError<T> {
    fn from(error: UncertaintyError<T>) -> Self {
        match error {
            UncertaintyError::OutOfRange {
                field,
                value,
                expected,
                ..
            } => Self::OutOfRange {
                field,
                value,
                expected,
            },
            UncertaintyError::TooManySensors { sensors, capacity } => {
                Self::TooManySensors { sensors, capacity }
            }
        }
    }
}

impl<T: Scalar> SlotError<T> {
    /// Returns the gain of the user to serve, 0 for nobody, or an error if the gain is invalid.
    pub(super) fn check_user(user: Option<PowerGain<T>>) -> Result<PowerGain<T>, Self> {
        match user {
            Some(gain) if !gain.is_valid() => Err(Self::UserGain { value: gain.0 }),
            Some(gain) => Ok(gain),
            None => Ok(PowerGain(T::zero())),
        }
    }
}

/// Checks the gains of all sensors.
pub(super) fn check_gains<T: Scalar>(
    mut sensor_gains: impl Iterator<Item = PowerGain<T>>,
) -> Result<(), SlotError<T>> {
    let mut numbered = (0..).zip(sensor_gains.by_ref());
    match numbered.find(|(_, gain)| !gain.is_valid()) {
        Some((index, gain)) => Err(SlotError::SensorGain {
            index,
            value: gain.0,
        }),
        None => Ok(()),
    }
}
