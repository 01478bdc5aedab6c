//! The wind around the body: a steady part from the west, and gusts.
//!
//! The body flies in moving air. Its autopilot leans against the steady part, for which it learns
//! the necessary angle. Only changes that are faster than this learning push the body off its path.
//! The largest speed applies to motion through the air, so the speed over ground is lower against
//! the wind.

use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// The standard deviation of gusts divided by the steady wind.
const TURBULENCE: f64 = 0.2;
/// The time constant of gusts, s.
const GUST_S: f64 = 3.0;
/// The time constant with which the autopilot's integrator learns the wind, s.
const LEARNED_S: f64 = 2.0;

/// The effect of the air on the body at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Air {
    /// The velocity of the wind over ground, m/s.
    pub(super) wind: Vector2<f64>,
    /// The part of the wind that the autopilot does not lean against yet, m/s.
    pub(super) surprise: Vector2<f64>,
}

/// The wind as a function of time. The same seed gives the same gusts.
#[derive(Clone, Debug)]
pub(super) struct Wind {
    mean: Vector2<f64>,
    gust: Vector2<f64>,
    learned: Vector2<f64>,
    random: Pcg64Mcg,
}

impl Wind {
    /// Creates wind from the west with this speed.
    pub(super) fn new(speed_mps: f64, seed: u64) -> Self {
        let mean = Vector2::new(speed_mps, 0.0);
        Self {
            mean,
            gust: Vector2::zeros(),
            learned: mean,
            random: Pcg64Mcg::seed_from_u64(seed),
        }
    }

    /// Advances the wind by `dt_s` seconds.
    pub(super) fn step(&mut self, dt_s: f64) -> Air {
        if self.mean == Vector2::zeros() {
            return Air::default();
        }
        let deviation = TURBULENCE * self.mean.norm() * (2.0 * dt_s / GUST_S).sqrt();
        // A uniform draw of unit variance serves as well as a normal one.
        let mut draw = || (self.random.random::<f64>() - 0.5) * 12f64.sqrt() * deviation;
        let push = Vector2::new(draw(), draw());
        self.gust += push - self.gust * (dt_s / GUST_S);
        let wind = self.mean + self.gust;
        let surprise = wind - self.learned;
        self.learned += surprise * (dt_s / LEARNED_S);
        Air { wind, surprise }
    }
}
