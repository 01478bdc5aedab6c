//! The missions that the figures fly, and the trainings that produce the policies. Each has a name
//! that is also the name of its file.

use std::fmt;

use serde::{Deserialize, Serialize};

use scenario::Scenario;

/// The arrangement of users and sensors: one of the shipped scenarios.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Topology {
    /// The paper's Topo.1: users and sensors far apart.
    Separated,
    /// The paper's Topo.2: users among sensors.
    Mixed,
}

impl Topology {
    /// Both topologies, in the paper's order.
    pub const ALL: [Self; 2] = [Self::Separated, Self::Mixed];

    /// Returns the name of the shipped scenario.
    pub fn name(self) -> &'static str {
        match self {
            Self::Separated => "separated",
            Self::Mixed => "mixed",
        }
    }

    /// Returns the name and the paper's number, for captions.
    pub fn title(self) -> &'static str {
        match self {
            Self::Separated => "separated (Topo.1)",
            Self::Mixed => "mixed (Topo.2)",
        }
    }
}

/// A mission of Sec. VI: a shipped scenario with at most three of its values changed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// The arrangement of users and sensors.
    pub topology: Topology,
    /// The number of slots `N`; the slots of the shipped scenarios last one second, so this is also
    /// `T` in seconds.
    pub slots: u32,
    /// `sigma^2`, dBm.
    pub noise_dbm: f64,
    /// `Gamma`.
    pub mse_threshold: f64,
}

/// Table I's `N`.
pub const SLOTS: u32 = 60;
/// Table I's noise power, dBm, the paper's case 1.
pub const NOISE_DBM: f64 = -95.0;
/// The paper's case 2, dBm.
pub const HIGH_NOISE_DBM: f64 = -85.0;
/// Table I's `Gamma`.
pub const MSE_THRESHOLD: f64 = 0.015;
/// The thresholds of the figures.
pub const MSE_THRESHOLDS: [f64; 4] = [0.010, 0.015, 0.020, 0.025];
/// The mission times of the figures, seconds, in the separated topology.
pub const MISSION_TIMES_S: [u32; 5] = [50, 60, 70, 80, 90];

impl Cell {
    /// Returns Table I's mission.
    pub fn table_one(topology: Topology) -> Self {
        Self {
            topology,
            slots: SLOTS,
            noise_dbm: NOISE_DBM,
            mse_threshold: MSE_THRESHOLD,
        }
    }

    /// Returns the mission with another threshold.
    pub fn at_threshold(self, mse_threshold: f64) -> Self {
        Self {
            mse_threshold,
            ..self
        }
    }

    /// Returns the mission with another noise power, dBm.
    pub fn at_noise(self, noise_dbm: f64) -> Self {
        Self { noise_dbm, ..self }
    }

    /// Returns the mission with another number of slots.
    pub fn lasting(self, slots: u32) -> Self {
        Self { slots, ..self }
    }

    /// Returns the scenario.
    ///
    /// # Errors
    /// Returns a message of one line if the values do not form a valid mission.
    pub fn scenario(&self) -> Result<Scenario, String> {
        let shipped = Scenario::shipped(self.topology.name());
        shipped
            .ok_or_else(|| format!("no scenario {} is shipped", self.topology.name()))?
            .with_slots(self.slots)?
            .with_noise_dbm(self.noise_dbm)?
            .with_mse_threshold(self.mse_threshold)
    }

    /// Returns every mission of the figures once, the most similar to Table I first.
    pub fn all() -> Vec<Self> {
        let mut cells = Vec::new();
        for noise_dbm in [NOISE_DBM, HIGH_NOISE_DBM] {
            for topology in Topology::ALL {
                let cell = Self::table_one(topology).at_noise(noise_dbm);
                cells.extend(MSE_THRESHOLDS.map(|threshold| cell.at_threshold(threshold)));
            }
        }
        let times = MISSION_TIMES_S.into_iter().filter(|&slots| slots != SLOTS);
        cells.extend(times.map(|slots| Self::table_one(Topology::Separated).lasting(slots)));
        cells
    }
}

impl fmt::Display for Cell {
    /// Writes `separated-t60-n95-g0.015`: topology, seconds, negated dBm, threshold.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            slots,
            noise_dbm,
            mse_threshold,
            ..
        } = self;
        let topology = self.topology.name();
        write!(f, "{topology}-t{slots}-n{}-g{mse_threshold:.3}", -noise_dbm)
    }
}

/// A preset of the trainer. Learners are compared within a preset only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Preset {
    /// The best settings that were found for SAC: the trainer's `tuned`.
    Tuned,
    /// The paper's settings: the trainer's `paper`.
    TableOne,
}

impl Preset {
    /// Both presets.
    pub const ALL: [Self; 2] = [Self::Tuned, Self::TableOne];

    /// Returns the trainer's `--preset`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tuned => "tuned",
            Self::TableOne => "paper",
        }
    }

    /// Returns the name for captions.
    pub fn title(self) -> &'static str {
        match self {
            Self::Tuned => "tuned",
            Self::TableOne => "Table I",
        }
    }
}

/// The learning algorithm and the trainer's preset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Learner {
    /// SAC with a preset.
    Sac(Preset),
    /// DDPG with a preset.
    Ddpg(Preset),
}

impl Learner {
    /// All learners, in the order of the tables.
    pub const ALL: [Self; 4] = [
        Self::Sac(Preset::Tuned),
        Self::Sac(Preset::TableOne),
        Self::Ddpg(Preset::Tuned),
        Self::Ddpg(Preset::TableOne),
    ];

    /// Returns the trainer's `--algorithm` and `--preset`.
    pub fn arguments(self) -> [&'static str; 2] {
        match self {
            Self::Sac(preset) => ["sac", preset.name()],
            Self::Ddpg(preset) => ["ddpg", preset.name()],
        }
    }
}

/// One training: the arguments of `trainer train`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Training {
    /// The mission that is trained on.
    pub cell: Cell,
    /// The algorithm and preset.
    pub learner: Learner,
    /// The seed of the random numbers.
    pub seed: u64,
    /// The learning rate as it is written on the command line, if it is not the preset's.
    pub learning_rate: Option<&'static str>,
}

impl Training {
    /// Creates a training with the preset's learning rate.
    pub fn new(cell: Cell, learner: Learner, seed: u64) -> Self {
        Self {
            cell,
            learner,
            seed,
            learning_rate: None,
        }
    }

    /// Returns the trainer's arguments except for the directory; `scenario` is the value of
    /// `--scenario`.
    pub fn arguments(&self, scenario: &str) -> Vec<String> {
        let [algorithm, preset] = self.learner.arguments();
        let threshold = self.cell.mse_threshold.to_string();
        let seed = self.seed.to_string();
        let named = [
            ("--scenario", scenario),
            ("--mse-threshold", &threshold),
            ("--algorithm", algorithm),
            ("--preset", preset),
            ("--seed", &seed),
        ];
        let rate = self.learning_rate.map(|rate| ("--learning-rate", rate));
        let pairs = named.into_iter().chain(rate);
        let words = pairs.flat_map(|(name, value)| [name.to_owned(), value.to_owned()]);
        std::iter::once("train".to_owned()).chain(words).collect()
    }

    /// Returns the stem of the scenario file to train on, if no shipped scenario fits; the
    /// threshold is an argument.
    pub fn scenario_stem(&self) -> Option<String> {
        let Cell {
            topology,
            slots,
            noise_dbm,
            ..
        } = self.cell;
        let shipped = slots == SLOTS && noise_dbm == NOISE_DBM;
        (!shipped).then(|| format!("{}-t{slots}-n{}", topology.name(), -noise_dbm))
    }
}

impl fmt::Display for Training {
    /// Writes the cell's name, the algorithm, the preset, the seed, and the learning rate if it is
    /// not the preset's.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [algorithm, preset] = self.learner.arguments();
        write!(f, "{}-{algorithm}-{preset}-s{}", self.cell, self.seed)?;
        match self.learning_rate {
            Some(rate) => write!(f, "-lr{rate}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cell_is_a_mission_of_its_own() {
        let cells = Cell::all();
        let mut digests: Vec<String> = cells
            .iter()
            .map(|cell| cell.scenario().expect("valid").digest())
            .collect();
        digests.sort();
        digests.dedup();
        assert_eq!(digests.len(), cells.len());
    }

    #[test]
    fn a_training_is_named_by_its_arguments() {
        let cell = Cell::table_one(Topology::Mixed).at_noise(HIGH_NOISE_DBM);
        let training = Training {
            learning_rate: Some("1e-3"),
            ..Training::new(cell, Learner::Sac(Preset::TableOne), 2)
        };
        assert_eq!(
            training.to_string(),
            "mixed-t60-n85-g0.015-sac-paper-s2-lr1e-3"
        );
        assert_eq!(training.scenario_stem().as_deref(), Some("mixed-t60-n85"));
        assert_eq!(
            training.arguments("F.toml").join(" "),
            "train --scenario F.toml --mse-threshold 0.015 --algorithm sac --preset paper \
             --seed 2 --learning-rate 1e-3"
        );
    }
}
