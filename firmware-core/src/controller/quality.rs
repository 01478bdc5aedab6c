// SPDX-License-Identifier: MIT OR Apache-2.0
//! The quality of the channel estimates that the ground sends, as it is sent: a byte per number.
//!
//! | quantity | code 0 | codes 1 to 255 |
//! |---|---|---|
//! | error variance, relative to the power gain | 0, exactly known | `1e-5 10^(6 (code - 1) / 254)`: 1e-5 to 10 in steps of 5.6 % |
//! | phase error, standard deviation | 0, exactly known | `pi code / 255` rad |
//!
//! A number between two codes gets the larger one, so that a quality is never better than it was
//! stated to be. [`SensorUncertainty`] says what the numbers mean.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{
    collect::collect_first,
    mission::Mission,
    scalar::Scalar,
    uncertainty::{SensorUncertainty, UncertaintyError},
};

/// The smallest variance above 0 that a code can state.
const LEAST_VARIANCE: f64 = 1e-5;
/// The largest variance that a code can state, over the smallest one.
const VARIANCE_RANGE: f64 = 1e6;

/// The relative error variance of a channel estimate, in a byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct VarianceCode(u8);

impl VarianceCode {
    /// Returns the code of the least variance that is not below `variance`. Worst case: eight
    /// exponential functions.
    ///
    /// # Errors
    /// Returns an error that names `field` unless the variance is from 0 to 10.
    fn new<T: Scalar>(field: &'static str, variance: T) -> Result<Self, UncertaintyError<T>> {
        UncertaintyError::check(
            variance >= T::zero() && variance <= Self(u8::MAX).variance(),
            (field, variance),
            "a variance from 0 to 10, relative to the power gain",
        )?;
        Ok(Self(least_code(|code| {
            Self(code).variance::<T>() >= variance
        })))
    }

    /// Returns the relative error variance.
    pub fn variance<T: Scalar>(self) -> T {
        if self.0 == 0 {
            return T::zero();
        }
        if self.0 == u8::MAX {
            return T::of(LEAST_VARIANCE * VARIANCE_RANGE);
        }
        let steps = T::count(usize::from(self.0 - 1)) / T::of(254.0);
        T::of(LEAST_VARIANCE) * (steps * T::of(core::f64::consts::LN_10 * 6.0)).exp()
    }
}

/// The quality of a sensor's channel estimate, in two bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorQuality {
    error_variance: VarianceCode,
    /// In units of pi/255 rad.
    phase_error: u8,
}

impl SensorQuality {
    /// Creates a quality from the error variance relative to the power gain, 0 to 10, and the
    /// standard deviation of the phase error, 0 to pi (rad). Both are rounded up.
    ///
    /// # Errors
    /// Returns an error if a number is NaN or out of its range.
    pub fn new<T: Scalar>(
        error_variance: T,
        phase_error_rad: T,
    ) -> Result<Self, UncertaintyError<T>> {
        let error_variance = VarianceCode::new("sensor_error_variance", error_variance)?;
        SensorUncertainty::with_phase_error(T::zero(), phase_error_rad)?;
        let phase_error = least_code(|code| {
            let quality = Self {
                error_variance,
                phase_error: code,
            };
            quality.phase_error_rad::<T>() >= phase_error_rad
        });
        Ok(Self {
            error_variance,
            phase_error,
        })
    }

    /// Returns the error variance relative to the power gain.
    pub fn error_variance<T: Scalar>(&self) -> T {
        self.error_variance.variance()
    }

    /// Returns the standard deviation of the phase error, rad.
    pub fn phase_error_rad<T: Scalar>(&self) -> T {
        T::count(self.phase_error.into()) / T::of(255.0) * T::pi()
    }

    /// Returns the statistics as the slot solver takes them. Worst case: two exponential functions.
    pub fn uncertainty<T: Scalar>(&self) -> SensorUncertainty<T> {
        let statistics =
            SensorUncertainty::with_phase_error(self.error_variance(), self.phase_error_rad());
        // Every code states a valid number.
        debug_assert!(statistics.is_ok(), "{self:?}: {statistics:?}");
        statistics.unwrap_or_default()
    }

    /// Returns the worse one of each number.
    fn worse(self, other: Self) -> Self {
        Self {
            error_variance: self.error_variance.max(other.error_variance),
            phase_error: self.phase_error.max(other.phase_error),
        }
    }
}

/// The quality of a user's channel estimate, in a byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct UserQuality(VarianceCode);

impl UserQuality {
    /// Creates a quality from the error variance relative to the power gain, 0 to 10, which is
    /// rounded up.
    ///
    /// # Errors
    /// Returns an error if it is NaN or out of its range.
    pub fn new<T: Scalar>(error_variance: T) -> Result<Self, UncertaintyError<T>> {
        VarianceCode::new("user_error_variance", error_variance).map(Self)
    }

    /// Returns the error variance relative to the power gain.
    pub fn error_variance<T: Scalar>(&self) -> T {
        self.0.variance()
    }
}

/// The quality of the channel estimates of a slot and of the slots after it, until it is replaced.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChannelQuality<const M: usize, const J: usize> {
    /// The first slot whose channel state has this quality.
    pub slot: u32,
    /// One entry per user.
    pub users: Vec<UserQuality, M>,
    /// One entry per sensor.
    pub sensors: Vec<SensorQuality, J>,
}

impl<const M: usize, const J: usize> ChannelQuality<M, J> {
    /// Creates a quality that is the same for all users and the same for all sensors of the mission.
    pub fn uniform<T: Scalar>(
        mission: &Mission<T, M, J>,
        slot: u32,
        user: UserQuality,
        sensor: SensorQuality,
    ) -> Self {
        Self {
            slot,
            users: collect_first(core::iter::repeat_n(user, mission.user_count())),
            sensors: collect_first(core::iter::repeat_n(sensor, mission.sensor_count())),
        }
    }

    /// Returns whether all channels are known exactly, which is also the case without entries.
    pub fn is_exact(&self) -> bool {
        self.users
            .iter()
            .all(|user| *user == UserQuality::default())
            && (self.sensors.iter()).all(|sensor| *sensor == SensorQuality::default())
    }

    /// Returns the quality of a user; of one without an entry, which has joined since, the worst
    /// one of the others.
    pub fn user(&self, index: usize) -> UserQuality {
        let worst = || {
            UserQuality(
                self.users
                    .iter()
                    .map(|user| user.0)
                    .max()
                    .unwrap_or_default(),
            )
        };
        self.users.get(index).copied().unwrap_or_else(worst)
    }

    /// Returns the quality of a sensor; of one without an entry, which has joined since, the worst
    /// one of the others in each number.
    pub fn sensor(&self, index: usize) -> SensorQuality {
        let worst =
            || (self.sensors.iter().copied()).fold(SensorQuality::default(), SensorQuality::worse);
        self.sensors.get(index).copied().unwrap_or_else(worst)
    }
}

/// Returns the least code for which `suffices` is true; it is false below that code and true above,
/// and true for the last one. Worst case: eight calls.
fn least_code(suffices: impl Fn(u8) -> bool) -> u8 {
    let (mut low, mut high) = (0_u8, u8::MAX);
    while low < high {
        let middle = low + (high - low) / 2;
        if suffices(middle) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    low
}
