//! The rows of learning curves that the trainer writes, and the training that a row belongs to.

use serde::Deserialize;

use super::cell::Training;

/// Table I's learning rate, as the trainer takes it.
pub(super) const TABLE_ONE_RATE: &str = "1e-4";
/// Table I's discount factor.
const DISCOUNT: f64 = 0.90;

/// A row of the trainer's `learning_curves.csv`.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct LearningRow {
    pub(super) scenario_digest: String,
    pub(super) algorithm: String,
    pub(super) learning_rate: f64,
    pub(super) discount: f64,
    pub(super) seed: u64,
    pub(super) episode: u32,
    pub(super) episodic_return: f64,
}

/// Returns whether `rows` contains rows of a training.
pub(super) fn is_among(training: &Training, rows: &[LearningRow]) -> bool {
    let Ok(scenario) = training.cell.scenario() else {
        return false;
    };
    let digest = scenario.digest();
    let rate = rate_of(training.learning_rate.unwrap_or(TABLE_ONE_RATE));
    rows.iter()
        .any(|row| row.is_of(rate, &digest) && row.seed == training.seed)
}

impl LearningRow {
    /// Returns whether the row belongs to a training of SAC with this learning rate on this
    /// mission.
    pub(super) fn is_of(&self, rate: f64, digest: &str) -> bool {
        // The trainer's numbers have single precision.
        (self.learning_rate / rate - 1.0).abs() < 1e-6
            && (self.discount / DISCOUNT - 1.0).abs() < 1e-6
            && self.algorithm == "sac"
            && self.scenario_digest == digest
    }
}

/// Parses a learning rate.
pub(super) fn rate_of(text: &str) -> f64 {
    text.parse().unwrap_or(f64::NAN)
}
