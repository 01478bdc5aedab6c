// SPDX-License-Identifier: MIT OR Apache-2.0
//! The limits of a slot.

use serde::{Deserialize, Serialize};

use super::error::SlotError;
use crate::{mission::Mission, scalar::Scalar, units::Watt};

/// The limits of a slot, which do not depend on the channel: the mission's powers, noise and
/// threshold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SlotLimits<T> {
    /// `p_b^max`.
    pub sensor_power_max: Watt<T>,
    /// `p^max`.
    pub user_power_max: Watt<T>,
    /// `sigma^2`, above 0.
    pub noise_power: Watt<T>,
    /// `Gamma`, above 0 and below `1/J`.
    pub mse_threshold: T,
}

impl<T: Scalar> SlotLimits<T> {
    /// Returns the limits of a mission.
    pub fn of_mission<const M: usize, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let p = mission.parameters();
        Self {
            sensor_power_max: p.sensor_power_max,
            user_power_max: p.user_power_max,
            noise_power: p.noise_power,
            mse_threshold: p.mse_threshold,
        }
    }

    /// Returns `kappa = J (1 - J Gamma)`: with the best `eta`, `MSE <= Gamma` is `A^2 >= kappa (q +
    /// E)`.
    pub fn kappa(&self, sensors: usize) -> T {
        let sensors = T::count(sensors);
        sensors * (T::one() - sensors * self.mse_threshold)
    }

    /// Returns the same limits with `Gamma` a few units in the last place lower, of 1 where `J Gamma`
    /// is small and `1 - J Gamma` has lost its last digits. Solutions aim at these, so that rounding
    /// does not take the MSE over `Gamma`. This costs less than 1e-5 of the rate in single
    /// precision.
    pub(super) fn aim(&self, sensors: usize) -> Self {
        let share = T::count(sensors) * self.mse_threshold;
        let margin = T::EPSILON * T::of(8.0) * (T::of(0.125) / share).max(T::one());
        Self {
            mse_threshold: self.mse_threshold * (T::one() - margin),
            ..*self
        }
    }

    /// Returns the largest coefficient `b` with `b^2 <= p_b^max`, exactly: the square of the
    /// rounded square root may exceed `p_b^max`.
    pub fn coefficient_max(&self) -> T {
        let root = self.sensor_power_max.0.sqrt();
        if has_larger_square(root, self.sensor_power_max.0) {
            root.next_below()
        } else {
            root
        }
    }

    pub(super) fn check(&self, sensors: usize) -> Result<(), SlotError<T>> {
        let not_negative = |field, value: T| {
            if value.finite() && value >= T::zero() {
                return Ok(());
            }
            let expected = "a finite power of at least 0 W";
            Err(SlotError::OutOfRange {
                field,
                value,
                expected,
            })
        };
        not_negative("sensor_power_max", self.sensor_power_max.0)?;
        not_negative("user_power_max", self.user_power_max.0)?;
        if !(self.noise_power.0.finite() && self.noise_power.0 > T::zero()) {
            return Err(SlotError::OutOfRange {
                field: "noise_power",
                value: self.noise_power.0,
                expected: "a finite power above 0 W",
            });
        }
        if sensors == 0 {
            return Err(SlotError::NoSensors);
        }
        let threshold = self.mse_threshold;
        if !(threshold.finite() && threshold > T::zero() && self.kappa(sensors) > T::zero()) {
            return Err(SlotError::OutOfRange {
                field: "mse_threshold",
                value: threshold,
                expected: "above 0 and below 1/J: from there on an all-zero estimate is accurate enough and no sensor would transmit",
            });
        }
        Ok(())
    }
}

/// Returns whether `root^2 > limit`, exactly where neither the square nor its rounding error underflows.
///
/// Rounding keeps order, so a rounded square that differs from the limit decides. If they are equal,
/// the sign of the rounding error does, which is exact by Dekker's product: the halves of a number
/// have half the digits, so that their products are not rounded. (A fused multiplication does the
/// same; in software it calculates in double precision.)
fn has_larger_square<T: Scalar>(root: T, limit: T) -> bool {
    let square = root * root;
    if square != limit {
        return square > limit;
    }
    let scaled = root * T::SPLITTER;
    let high = scaled - (scaled - root);
    let low = root - high;
    let twice = (high + high) * low;
    (high * high - square) + twice + low * low > T::zero()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits<T: Scalar>(sensor_power_max: f64) -> SlotLimits<T> {
        SlotLimits {
            sensor_power_max: Watt(T::of(sensor_power_max)),
            user_power_max: Watt(T::one()),
            noise_power: Watt(T::one()),
            mse_threshold: T::of(0.015),
        }
    }

    /// The threshold that solutions aim at is a few units in the last place below `Gamma`.
    fn aims_a_little_lower<T: Scalar>() {
        let limits = limits::<T>(0.05);
        let aim = limits.aim(36);
        let margin = (limits.mse_threshold - aim.mse_threshold) / limits.mse_threshold;
        assert!(margin >= T::EPSILON * T::of(4.0) && margin <= T::EPSILON * T::of(16.0));
        assert_eq!(aim.sensor_power_max, limits.sensor_power_max);
        // Where 1 - J Gamma loses digits, it is further below.
        let few = limits.aim(1);
        let margin = (limits.mse_threshold - few.mse_threshold) / limits.mse_threshold;
        assert!(margin >= T::EPSILON * T::of(60.0) && margin <= T::EPSILON * T::of(75.0));
    }

    #[test]
    fn the_aim_is_a_little_lower() {
        aims_a_little_lower::<f64>();
        aims_a_little_lower::<f32>();
    }

    /// The square of the largest coefficient is at most `p_b^max`, and that of the next number is
    /// more. In single precision the squares are exact in double.
    #[test]
    fn the_largest_coefficient_is_the_largest() {
        for n in 0..1000 {
            let power = 1e-3 * 1.013_f32.powi(n);
            let b = limits::<f32>(power.into()).coefficient_max();
            let square = |b: f32| f64::from(b) * f64::from(b);
            assert!(square(b) <= f64::from(power), "{b} {power}");
            assert!(square(b.next_up()) > f64::from(power), "{b} {power}");
        }
    }

    /// In double precision a fused multiplication, which rounds once, gives the exact sign.
    #[test]
    fn squares_are_compared_exactly() {
        for n in 0..10_000 {
            let power = 1e-3 * 1.0013_f64.powi(n);
            for root in [
                power.sqrt(),
                power.sqrt().next_up(),
                power.sqrt().next_down(),
            ] {
                let expected = root.mul_add(root, -power) > 0.0;
                assert_eq!(has_larger_square(root, power), expected, "{root} {power}");
            }
        }
    }
}
