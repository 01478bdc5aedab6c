//! The table `seeds.csv`: the flown result of each training. The repository stores the policies of
//! seed 1; of the other seeds it stores their rows in this table.

use serde::{Deserialize, Serialize};

use super::cell::{Topology, Training};

/// The name of the table in the directory of shipped policies.
pub const SEEDS: &str = "seeds.csv";

/// The flight of one trained policy on its mission, with the ideal vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeedRow {
    /// The topology of the mission.
    pub topology: Topology,
    /// `T`, seconds.
    pub mission_time_s: u32,
    /// `sigma^2`, dBm.
    pub noise_dbm: f64,
    /// `Gamma`.
    pub mse_threshold: f64,
    /// The digest of the scenario that the policy was trained for.
    pub scenario_digest: String,
    /// The trainer's `--algorithm`.
    pub algorithm: String,
    /// The trainer's `--preset`.
    pub preset: String,
    /// The seed of the training.
    pub seed: u64,
    /// The episode after which the policy was kept.
    pub episodes: u32,
    /// The sum of the rates, bit/s/Hz.
    pub sum_rate: f64,
    /// The number of slots in which `Gamma` was not met.
    pub missed_slots: usize,
    /// Whether the vehicle arrived at the destination.
    pub arrived: bool,
    /// Whether every user had its slots.
    pub fair: bool,
    /// The number of violated limits.
    pub constraint_violations: usize,
    /// The SHA-256 of the policy's ONNX file, hexadecimal.
    pub policy_sha256: String,
}

impl SeedRow {
    /// Returns whether this is the row of a training; `digest` is that of its scenario.
    pub fn is_of(&self, training: &Training, digest: &str) -> bool {
        let [algorithm, preset] = training.learner.arguments();
        training.learning_rate.is_none()
            && self.scenario_digest == digest
            && self.algorithm == algorithm
            && self.preset == preset
            && self.seed == training.seed
    }
}
