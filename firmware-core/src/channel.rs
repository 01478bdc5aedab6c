// SPDX-License-Identifier: MIT OR Apache-2.0
//! The channel from the ground to the vehicle: its mean power gain over the distance.
//!
//! The mission's [`RadioModel`](crate::mission::RadioModel) selects the formula. By default it is the paper's probabilistic
//! line-of-sight channel; [`aerial`] has the others, from 3GPP TR 36.777.
//!
//! The paper's eq:gain (path loss `G`, dB), eq:plos (probability of line of sight) and eq:gmn,
//! read as a **power** gain `|g|^2 = 10^(-G/10)`. With distance `d` and altitude `H`:
//!
//! ```text
//! G     = 20 log10(4 pi f_c d / c) + P_LoS mu_LoS + (1 - P_LoS) mu_NLoS
//! P_LoS = 1 / (1 + A exp(-B (180/pi asin(H/d) - A)))
//! ```
//!
//! The logarithm and the power of ten cancel in the first term, so a gain costs one `sqrt`, one
//! `asin` and two `exp`: `(c / (4 pi f_c d))^2 * exp(-ln10/10 * loss)`.
//!
//! At a given altitude the gain of every model decreases strictly with horizontal distance
//! (`docs/mathematics.md` has the proof); the certified bound relies on that.

pub mod aerial;
#[cfg(feature = "gain-map")]
pub mod gain_map;

use serde::{Deserialize, Serialize};

use crate::{
    mission::{Environment, ExcessLoss, MissionParameters},
    scalar::{Position, Scalar},
    units::PowerGain,
};
use aerial::AerialModel;

/// Speed of light, m/s.
pub const SPEED_OF_LIGHT_MPS: f64 = 299_792_458.0;

/// A node on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GroundNode {
    /// The user with this number.
    User(usize),
    /// The sensor with this number.
    Sensor(usize),
}

/// The constants of the channel, prepared for fast evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChannelModel<T> {
    altitude_m: T,
    environment: Environment<T>,
    excess_loss_db: ExcessLoss<T>,
    /// `(c / (4 pi f_c))^2`, square metres.
    free_space_m2: T,
    /// The model from TR 36.777, if the mission has one of them.
    aerial: Option<AerialModel<T>>,
}

impl<T: Scalar> ChannelModel<T> {
    /// Creates the channel model of a mission.
    pub fn new<const M: usize, const J: usize>(p: &MissionParameters<T, M, J>) -> Self {
        let wavelength_4pi =
            T::of(SPEED_OF_LIGHT_MPS / (4.0 * core::f64::consts::PI)) / p.carrier_hz;
        Self {
            altitude_m: p.altitude_m,
            environment: p.environment,
            excess_loss_db: p.excess_loss_db,
            free_space_m2: wavelength_4pi * wavelength_4pi,
            aerial: AerialModel::of(p),
        }
    }

    /// Returns the distance from a vehicle over `vehicle` to the ground at `ground`, metres.
    pub fn distance_m(&self, vehicle: &Position<T>, ground: &Position<T>) -> T {
        ((vehicle - ground).norm_squared() + self.altitude_m * self.altitude_m).sqrt()
    }

    /// Returns `P_LoS` (eq:plos, or table B-1 of TR 36.777) at distance `distance_m >= H`.
    pub fn line_of_sight_probability(&self, distance_m: T) -> T {
        if let Some(aerial) = &self.aerial {
            return aerial.line_of_sight_probability(self.horizontal_m(distance_m));
        }
        let Environment { a, b } = self.environment;
        let elevation_deg = (self.altitude_m / distance_m).min(T::one()).asin()
            * T::of(180.0 / core::f64::consts::PI);
        T::one() / (T::one() + a * (-b * (elevation_deg - a)).exp())
    }

    /// Returns `G` (eq:gain, or the mean of table B-2 of TR 36.777), decibels, at distance
    /// `distance_m >= H`.
    pub fn path_loss_db(&self, distance_m: T) -> T {
        if let Some(aerial) = &self.aerial {
            return aerial.path_loss_db(self.horizontal_m(distance_m), distance_m);
        }
        let decade = T::of(10.0);
        decade * (distance_m * distance_m / self.free_space_m2).log10()
            + self.excess_loss_db(distance_m)
    }

    /// Returns `|g|^2` (eq:gmn, read as a power gain) between a vehicle over `vehicle` and the
    /// ground at `ground`.
    pub fn power_gain(&self, vehicle: &Position<T>, ground: &Position<T>) -> PowerGain<T> {
        self.power_gain_at(self.distance_m(vehicle, ground))
    }

    /// Returns `|g|^2` across a horizontal distance.
    pub fn power_gain_across(&self, horizontal_m: T) -> PowerGain<T> {
        let square = horizontal_m * horizontal_m + self.altitude_m * self.altitude_m;
        self.power_gain_at(square.sqrt())
    }

    /// Returns `|g|^2` at distance `distance_m >= H`.
    pub fn power_gain_at(&self, distance_m: T) -> PowerGain<T> {
        let nepers_per_db = T::of(-core::f64::consts::LN_10 / 10.0);
        if self.aerial.is_some() {
            return PowerGain((self.path_loss_db(distance_m) * nepers_per_db).exp());
        }
        let nepers = self.excess_loss_db(distance_m) * nepers_per_db;
        PowerGain(self.free_space_m2 / (distance_m * distance_m) * nepers.exp())
    }

    /// Returns the horizontal part of a distance.
    fn horizontal_m(&self, distance_m: T) -> T {
        let square = distance_m * distance_m - self.altitude_m * self.altitude_m;
        square.max(T::zero()).sqrt()
    }

    /// Returns `P_LoS mu_LoS + P_NLoS mu_NLoS`, decibels.
    fn excess_loss_db(&self, distance_m: T) -> T {
        let ExcessLoss { los, nlos } = self.excess_loss_db;
        nlos + (los - nlos) * self.line_of_sight_probability(distance_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_missions::table_one;

    fn model() -> ChannelModel<f64> {
        *table_one::<f64>().channel()
    }

    /// By hand, straight below the vehicle at 100 m: elevation 90 degrees.
    #[test]
    fn overhead_gain_matches_the_printed_formula() {
        let (a, b) = (9.613_f64, 0.158_f64);
        let p_los = 1.0 / (1.0 + a * (-b * (90.0 - a)).exp());
        let loss_db = 20.0
            * (4.0 * core::f64::consts::PI * 2e9 / SPEED_OF_LIGHT_MPS * 100.0).log10()
            + p_los * 1.0
            + (1.0 - p_los) * 20.0;
        let expected = 10f64.powf(-loss_db / 10.0);
        let here = Position::new(500.0, 500.0);
        let got = model().power_gain(&here, &here).0;
        assert!((got / expected - 1.0).abs() < 1e-12, "{got} {expected}");
        assert!((model().path_loss_db(100.0) - loss_db).abs() < 1e-10);
    }

    #[test]
    fn gain_falls_with_distance() {
        let model = model();
        let mut last = f64::INFINITY;
        for step in 0..3000 {
            let gain = model.power_gain_at(100.0 + f64::from(step)).0;
            assert!(gain < last && gain > 0.0);
            last = gain;
        }
    }

    #[test]
    fn single_precision_follows_double() {
        let (double, single) = (model(), *table_one::<f32>().channel());
        for step in 0..1400 {
            let distance = 100.0 + f64::from(step);
            let (d, s) = (
                double.power_gain_at(distance).0,
                single.power_gain_at(distance as f32).0,
            );
            assert!((f64::from(s) / d - 1.0).abs() < 2e-5, "{distance} {s} {d}");
        }
    }
}
