// SPDX-License-Identifier: MIT OR Apache-2.0
//! Slot problems for tests and benchmarks: typical ones and the corners of the domain, from a
//! fixed seed.

// Every test binary compiles this for itself and uses a part.
#![allow(dead_code)]

use firmware_core::{
    PowerGain, Scalar, Watt,
    aircomp::Slot,
    inner::{SlotLimits, Solution},
};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A slot problem in double precision.
#[derive(Clone, Debug)]
pub(crate) struct Problem {
    pub(crate) limits: SlotLimits<f64>,
    pub(crate) sensor_gains: Vec<PowerGain<f64>>,
    pub(crate) user_gain: PowerGain<f64>,
}

pub(crate) fn generator(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

pub(crate) fn log_uniform(random: &mut impl Rng, low: f64, high: f64) -> f64 {
    (random.random_range(low.ln()..high.ln())).exp()
}

impl Problem {
    /// `J` from 1 to 64; gains as over a kilometre, spread over 12 orders, equal, in two
    /// groups, or partly zero; powers, noise and thresholds over several orders.
    pub(crate) fn draw(random: &mut impl Rng) -> Self {
        let sensors = random.random_range(1..=64);
        Self::draw_with(random, sensors)
    }

    pub(crate) fn draw_with(random: &mut impl Rng, sensors: usize) -> Self {
        let kind = random.random_range(0..6);
        let equal = log_uniform(random, 1e-13, 1e-8);
        let sensor_gains = (0..sensors)
            .map(|_| {
                PowerGain(match kind {
                    0 => equal,
                    1 => log_uniform(random, 1e-18, 1e-6),
                    2 if random.random_bool(0.3) => 0.0,
                    3 if random.random_bool(0.5) => equal * 1e-4,
                    3 => equal,
                    _ => log_uniform(random, 1e-12, 1e-9),
                })
            })
            .collect();
        let user_gain = match random.random_range(0..20) {
            0 => 0.0,
            1 => log_uniform(random, 1e-18, 1e-6),
            _ => log_uniform(random, 1e-12, 1e-9),
        };
        // J Gamma, close to both of its ends too.
        let fraction = match random.random_range(0..4) {
            0 => log_uniform(random, 1e-3, 1.0),
            1 => 1.0 - log_uniform(random, 1e-3, 1.0),
            _ => random.random_range(0.2..0.95),
        };
        Self {
            limits: SlotLimits {
                sensor_power_max: Watt(log_uniform(random, 1e-4, 1e1)),
                user_power_max: Watt(log_uniform(random, 1e-5, 1e1)),
                noise_power: Watt(log_uniform(random, 1e-15, 1e-11)),
                mse_threshold: fraction.clamp(1e-3, 0.999) / sensors as f64,
            },
            sensor_gains,
            user_gain: PowerGain(user_gain),
        }
    }

    pub(crate) fn sensors(&self) -> usize {
        self.sensor_gains.len()
    }

    /// Itself with other limits.
    pub(crate) fn with(&self, change: impl FnOnce(&mut SlotLimits<f64>)) -> Self {
        let mut changed = self.clone();
        change(&mut changed.limits);
        changed
    }

    /// The same numbers, rounded.
    pub(crate) fn limits_in<T: Scalar>(&self) -> SlotLimits<T> {
        SlotLimits {
            sensor_power_max: Watt(T::of(self.limits.sensor_power_max.0)),
            user_power_max: Watt(T::of(self.limits.user_power_max.0)),
            noise_power: Watt(T::of(self.limits.noise_power.0)),
            mse_threshold: T::of(self.limits.mse_threshold),
        }
    }

    pub(crate) fn gains_in<T: Scalar>(&self) -> Vec<PowerGain<T>> {
        let gains = self.sensor_gains.iter();
        gains.map(|gain| PowerGain(T::of(gain.0))).collect()
    }

    pub(crate) fn coefficients(&self, solution: &Solution<f64>) -> Vec<f64> {
        let gains = self.sensor_gains.iter();
        gains.map(|&gain| solution.coefficient(gain)).collect()
    }

    /// The receiver's view: MSE and rate as the paper prints them.
    pub(crate) fn slot<'a>(
        &'a self,
        coefficients: &'a [f64],
        user_power: Watt<f64>,
    ) -> Slot<'a, f64> {
        Slot {
            sensor_gains: &self.sensor_gains,
            sensor_coefficients: coefficients,
            user_gain: self.user_gain,
            user_power,
            noise_power: self.limits.noise_power,
        }
    }
}
