//! The settings of a run.

use std::ops::Range;

use anyhow::anyhow;
use firmware_core::{Mission, Watt};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::{DrawnMission, HostMission, Layout, Scenario};
use serde::{Deserialize, Serialize};

use crate::nn::sets::Architecture;

/// The noise of missions with high noise, dBm.
pub const HIGH_NOISE_DBM: Range<f64> = -88.0..-83.0;

/// Seeds of runs are below this number: their missions have seeds of their own, apart from those of
/// the benchmark (`demonstration::mission_seed`).
const SEED_LIMIT: u64 = u32::MAX as u64;

/// How a file of a network names the distribution of its training missions; the layouts that were
/// left out follow.
pub const RANDOM: &str = "random";

/// All settings of an imitation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImitationSettings {
    /// The seed of all random numbers. It also names the missions: no two seeds share one.
    pub seed: u64,
    /// Number of gradient steps, over which the learning rate falls; 0 if `minutes` decide.
    pub steps: u64,
    /// Duration of the training, minutes, over which the learning rate falls; 0 if `steps` decide.
    /// Results then depend on the speed of the machine.
    pub minutes: f64,
    /// Number of states of a gradient step.
    pub batch: usize,
    /// The highest learning rate of Adam.
    pub learning_rate: f32,
    /// Number of steps over which the learning rate rises.
    pub warmup_steps: u64,
    /// The lowest learning rate as a fraction of the highest.
    pub final_rate_fraction: f32,
    /// The largest norm of a gradient; longer ones are scaled to it.
    pub gradient_norm_max: f32,
    /// The number of planned missions before the first step.
    pub first_missions: usize,
    /// Number of gradient steps per new mission.
    pub steps_per_mission: u64,
    /// The operations of the planner for a mission.
    pub planning_operations: u64,
    /// The operations of the planner for a state beside its plan.
    pub correction_operations: u64,
    /// The step from which on missions are also flown by the network itself.
    pub own_flights_from: u64,
    /// The fraction of samples at positions beside the example's.
    pub disturbed_fraction: f64,
    /// The standard deviation of such a position in each coordinate, in units of the way of a slot.
    pub disturbance: f64,
    /// The sizes of the network.
    pub architecture: Architecture,
    /// The fraction of missions whose users and sensors are both drawn anywhere in the area. They are
    /// the hardest, and the distribution has one in 25. Without effect if that layout is left out.
    pub uniform_fraction: f64,
    /// The fraction of missions whose noise is drawn from [`HIGH_NOISE_DBM`]. With much noise, rates
    /// depend on the position more than anywhere else, and the distribution ends at -85 dBm.
    pub high_noise_fraction: f64,
    /// The only mission of a run that adapts a network to it, as a scenario file; without it, missions
    /// are drawn at random.
    #[serde(default)]
    pub scenario: Option<String>,
    /// Layouts that are not drawn, neither for users nor for sensors, so that the network can be
    /// evaluated on missions of a kind that it has not learned from. The missions of the run's own
    /// evaluations have none of them either, since the best network is chosen by these.
    #[serde(default)]
    pub left_out_layouts: Vec<Layout>,
    /// Number of missions of an evaluation.
    pub held_out_missions: usize,
    /// Number of steps between evaluations.
    pub evaluate_every: u64,
    /// Number of steps between rows of the metrics.
    pub report_every: u64,
}

/// How long a run is, and how often it reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// The number of gradient steps, or 0.
    pub steps: u64,
    /// The duration, minutes, without a number of steps.
    pub minutes: f64,
    /// Number of steps between rows of the metrics.
    pub report_every: u64,
    /// Number of steps between evaluations.
    pub evaluate_every: u64,
    /// Number of states of a gradient step.
    pub batch: usize,
}

impl Default for ImitationSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            steps: 0,
            minutes: 0.0,
            batch: 256,
            learning_rate: 1e-3,
            warmup_steps: 200,
            final_rate_fraction: 0.02,
            gradient_norm_max: 1.0,
            first_missions: 150,
            steps_per_mission: 3,
            planning_operations: 150_000_000,
            correction_operations: 5_000_000,
            own_flights_from: 1_000,
            disturbed_fraction: 0.6,
            disturbance: 0.35,
            architecture: Architecture::default(),
            uniform_fraction: 0.35,
            high_noise_fraction: 0.35,
            scenario: None,
            left_out_layouts: Vec::new(),
            held_out_missions: 60,
            evaluate_every: 1_000,
            report_every: 200,
        }
    }
}

impl ImitationSettings {
    /// Returns the settings of a run that adapts a network to the mission of a scenario.
    pub fn adapting(scenario: &Scenario) -> Self {
        Self {
            steps: 1_000,
            learning_rate: 3e-4,
            warmup_steps: 20,
            first_missions: 16,
            steps_per_mission: 10,
            own_flights_from: 100,
            evaluate_every: 25,
            report_every: 25,
            scenario: Some(scenario.to_toml()),
            ..Self::default()
        }
    }

    /// Returns the mission with a seed: that of the scenario, or one drawn at random. Draws with a
    /// layout that is left out are discarded, and the next one of the same seed is taken.
    ///
    /// # Errors
    /// Fails if the scenario is invalid, or if the seed gives no mission.
    pub fn mission(&self, seed: u64) -> anyhow::Result<HostMission> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let scenario = match &self.scenario {
            Some(text) => Scenario::parse("scenario", text),
            None => {
                let left_out = &self.left_out_layouts;
                let uniform =
                    rng.random_bool(self.uniform_fraction) && !left_out.contains(&Layout::Uniform);
                let layout = uniform.then_some(Layout::Uniform);
                DrawnMission::new(seed, layout, left_out).map(|drawn| drawn.scenario)
            }
        };
        let mission = scenario.map_err(|error| anyhow!(error))?.mission;
        if self.scenario.is_some() || !rng.random_bool(self.high_noise_fraction) {
            return Ok(mission);
        }
        let mut parameters = mission.parameters().clone();
        parameters.noise_power = Watt::from_dbm(rng.random_range(HIGH_NOISE_DBM));
        // Rates at this noise may be too low everywhere to be worth a mission.
        Ok(Mission::new(parameters).unwrap_or(mission))
    }

    /// Returns the distribution of the missions, for the provenance of the network.
    pub fn distribution(&self) -> String {
        if self.scenario.is_some() {
            return "one".into();
        }
        let left_out = Layout::ALL
            .into_iter()
            .filter(|layout| self.left_out_layouts.contains(layout));
        let names: Vec<&str> = left_out.map(Layout::name).collect();
        match names.is_empty() {
            true => RANDOM.into(),
            false => format!("{RANDOM} without {}", names.join(", ")),
        }
    }

    /// Returns the learning rate after `steps`, of which `fraction` (0 to 1) of the run consists: a
    /// linear rise, then half a cosine.
    pub fn learning_rate_after(&self, steps: u64, fraction: f64) -> f32 {
        let rise = ((steps + 1) as f32 / self.warmup_steps.max(1) as f32).min(1.0);
        let fall = 0.5 * (1.0 + libm::cos(std::f64::consts::PI * fraction.clamp(0.0, 1.0)));
        self.learning_rate * rise * self.final_rate_fraction.max(fall as f32)
    }

    /// Returns the length of the run, and how often it reports.
    pub fn schedule(&self) -> Schedule {
        Schedule {
            steps: self.steps,
            minutes: self.minutes,
            report_every: self.report_every,
            evaluate_every: self.evaluate_every,
            batch: self.batch,
        }
    }

    /// Checks that the settings make a run.
    ///
    /// # Errors
    /// Names the setting that is out of its range.
    pub fn check(&self) -> Result<(), String> {
        self.architecture.check()?;
        if (self.steps > 0) == (self.minutes > 0.0) {
            return Err(format!(
                "steps is {} and minutes is {}, but one of them must be above 0 and the other 0",
                self.steps, self.minutes
            ));
        }
        if self.seed >= SEED_LIMIT {
            return Err(format!(
                "seed is {}, but must be below {SEED_LIMIT}",
                self.seed
            ));
        }
        let checks = [
            (self.batch > 0, "batch must be above 0"),
            (
                self.learning_rate > 0.0 && self.learning_rate.is_finite(),
                "learning_rate must be above 0",
            ),
            (
                (0.0..=1.0).contains(&self.uniform_fraction),
                "uniform_fraction must be 0 to 1",
            ),
            (
                (0.0..=1.0).contains(&self.high_noise_fraction),
                "high_noise_fraction must be 0 to 1",
            ),
            (
                (Layout::ALL.iter()).any(|layout| !self.left_out_layouts.contains(layout)),
                "left_out_layouts must leave at least one layout",
            ),
            (
                self.left_out_layouts.is_empty() || self.scenario.is_none(),
                "left_out_layouts must be empty if there is a scenario",
            ),
            (self.first_missions > 0, "first_missions must be above 0"),
            (
                self.steps_per_mission > 0,
                "steps_per_mission must be above 0",
            ),
            (self.evaluate_every > 0, "evaluate_every must be above 0"),
            (self.report_every > 0, "report_every must be above 0"),
        ];
        let wrong = checks.into_iter().find(|(holds, _)| !holds);
        wrong.map_or(Ok(()), |(_, message)| Err(message.to_owned()))
    }
}
