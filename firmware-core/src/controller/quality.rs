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

    /// Returns whether all channels are known exactly, which is also the case without entries. Worst
    /// case: one pass over the entries.
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

impl<const M: usize, const J: usize> ChannelQuality<M, J> {
    /// Replaces this quality. Without entries where `other` is exact, so that
    /// [`is_exact`](Self::is_exact) takes no time.
    pub(super) fn replace(&mut self, other: &Self) {
        self.clone_from(other);
        if other.is_exact() {
            self.users.clear();
            self.sensors.clear();
        }
    }

    /// Returns the statistics of these sensors, as many as there are and in their order. Worst case:
    /// two exponential functions per sensor; neighbours with equal quality share them.
    pub(super) fn statistics<T: Scalar>(
        &self,
        sensors: impl Iterator<Item = usize>,
    ) -> Vec<SensorUncertainty<T>, J> {
        let mut last = (SensorQuality::default(), SensorUncertainty::exactly_known());
        collect_first(sensors.map(|sensor| {
            let quality = self.sensor(sensor);
            if quality != last.0 {
                last = (quality, quality.uncertainty());
            }
            last.1
        }))
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

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use proptest::prelude::*;

    use super::*;
    use crate::test_missions::table_one;

    fn with_codes(variance: u8, phase_error: u8) -> SensorQuality {
        SensorQuality {
            error_variance: VarianceCode(variance),
            phase_error,
        }
    }

    /// What a code states has that code, and the statistics of every pair of codes are valid.
    fn codes_state_themselves<T: Scalar>() {
        for variance in 0..=u8::MAX {
            for phase_error in 0..=u8::MAX {
                let quality = with_codes(variance, phase_error);
                let (eps, phase) = (
                    quality.error_variance::<T>(),
                    quality.phase_error_rad::<T>(),
                );
                assert_eq!(SensorQuality::new(eps, phase), Ok(quality));
                let known = SensorUncertainty::with_phase_error(eps, phase).expect("valid");
                assert_eq!(quality.uncertainty::<T>(), known);
            }
            let user = UserQuality(VarianceCode(variance));
            assert_eq!(UserQuality::new(user.error_variance::<T>()), Ok(user));
        }
    }

    #[test]
    fn every_code_states_itself() {
        codes_state_themselves::<f64>();
        codes_state_themselves::<f32>();
    }

    /// The ground codes in double precision what a vehicle reads in single precision.
    #[test]
    fn precisions_agree() {
        for code in 0..=u8::MAX {
            let quality = with_codes(code, code);
            let variance = quality.error_variance::<f64>();
            let rounded = f64::from(quality.error_variance::<f32>());
            assert!(
                (rounded - variance).abs() <= 2e-6 * variance,
                "{rounded} {variance}"
            );
            let phase = quality.phase_error_rad::<f64>();
            assert!((f64::from(quality.phase_error_rad::<f32>()) - phase).abs() < 1e-6);
        }
    }

    #[test]
    fn the_ends_are_exact() {
        let exact = SensorQuality::new(0.0, 0.0).expect("valid");
        assert_eq!(exact, SensorQuality::default());
        assert_eq!(
            exact.uncertainty::<f64>(),
            SensorUncertainty::exactly_known()
        );
        let least = SensorQuality::new(1e-30, 1e-30).expect("valid");
        assert_eq!(least, with_codes(1, 1));
        assert_eq!(least.error_variance::<f64>(), 1e-5);
        let most = SensorQuality::new(10.0, core::f64::consts::PI).expect("valid");
        assert_eq!(most, with_codes(255, 255));
        assert_eq!(most.error_variance::<f64>(), 10.0);
        assert_eq!(most.phase_error_rad::<f64>(), core::f64::consts::PI);
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        for bad in [-1e-9, 10.000_001, f64::NAN, f64::INFINITY] {
            let sensor = SensorQuality::new(bad, 0.0)
                .expect_err("refused")
                .to_string();
            let expected = std::format!("sensor_error_variance is {bad}, but must be a variance");
            assert!(sensor.starts_with(&expected), "{sensor}");
            let user = UserQuality::new(bad).expect_err("refused").to_string();
            assert!(user.starts_with("user_error_variance is "), "{user}");
        }
        for bad in [-1e-9, 3.15, f64::NAN] {
            let message = SensorQuality::new(0.1, bad)
                .expect_err("refused")
                .to_string();
            assert!(
                message.starts_with("sensor_phase_error_rad is "),
                "{message}"
            );
        }
    }

    /// A node that has joined since has the worst quality of the others, in each number.
    #[test]
    fn a_node_without_an_entry_is_known_no_better_than_the_others() {
        let mut quality = ChannelQuality::<4, 4> {
            slot: 1,
            users: [VarianceCode(3), VarianceCode(9), VarianceCode(4)]
                .map(UserQuality)
                .into_iter()
                .collect(),
            sensors: [with_codes(5, 1), with_codes(2, 8)].into_iter().collect(),
        };
        assert_eq!(quality.user(3), UserQuality(VarianceCode(9)));
        assert_eq!(quality.sensor(1), with_codes(2, 8));
        assert_eq!(quality.sensor(2), with_codes(5, 8));
        let statistics = quality.statistics::<f64>([0, 2].into_iter());
        let expected = [with_codes(5, 1), with_codes(5, 8)].map(|code| code.uncertainty());
        assert_eq!(statistics, expected);
        // All exact: the same as without entries.
        assert!(!quality.is_exact());
        let exact = ChannelQuality::uniform(
            &table_one::<f64>(),
            7,
            UserQuality::default(),
            SensorQuality::default(),
        );
        assert_eq!((exact.users.len(), exact.sensors.len()), (15, 36));
        let mut replaced = ChannelQuality {
            slot: 1,
            ..exact.clone()
        };
        replaced.replace(&exact);
        assert_eq!(
            (replaced.slot, replaced.users.len(), replaced.sensors.len()),
            (7, 0, 0)
        );
        assert!(replaced.is_exact());
        quality.users.clear();
        assert!(!quality.is_exact());
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            rng_seed: proptest::test_runner::RngSeed::Fixed(1),
            ..ProptestConfig::default()
        })]

        /// A quality is never better than it was stated to be, and worse by a step at most.
        #[test]
        fn rounding_is_to_the_worse(
            exponent in -5.0..1.0_f64,
            phase_error_rad in 0.0..=core::f64::consts::PI,
        ) {
            let variance = 10.0_f64.powf(exponent);
            let quality = SensorQuality::new(variance, phase_error_rad).expect("valid");
            let stated = quality.error_variance::<f64>();
            prop_assert!(stated >= variance && stated < 1.056 * variance, "{stated} {variance}");
            let step = core::f64::consts::PI / 255.0;
            let stated: f64 = quality.phase_error_rad();
            prop_assert!(stated >= phase_error_rad && stated < phase_error_rad + step + 1e-12);
            let user = UserQuality::new(variance).expect("valid");
            prop_assert_eq!(user.0, quality.error_variance);
        }
    }
}
