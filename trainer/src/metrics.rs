//! The metrics of a run, one row per episode.
//!
//! | column | meaning |
//! |---|---|
//! | `episode`, `global_step` | number of episodes and slots completed |
//! | `charts/episodic_return` | sum of rewards |
//! | `charts/rate_reward`, `charts/trajectory_reward` | the weighted parts of that sum |
//! | `charts/sum_rate` | sum of `R_n`, bit/s/Hz, with exploration |
//! | `charts/arrived`, `charts/fair` | 1 or 0 |
//! | `charts/mse_violations`, `charts/interventions` | number of slots |
//! | `charts/eval_sum_rate` | sum of `R_n` of the deterministic policy, in episodes after which it was evaluated |
//! | `losses/*` | means over the episode's gradient steps; names as CleanRL's where it has them |
//!
//! The CSV file contains nothing that depends on the clock, so the same seed gives the same bytes.
//! The TensorBoard files also contain `charts/SPS`, slots per second.

use std::{fmt::Write as _, io, path::Path};

use environment::Episode;
use files::output;
use serde::{Deserialize, Serialize};

use crate::learner::Losses;

/// Accumulates the mean losses of an episode.
#[derive(Clone, Debug, Default)]
pub struct LossMeans {
    names: Vec<&'static str>,
    sums: Vec<f64>,
    count: u32,
}

impl LossMeans {
    /// Adds the losses of a gradient step.
    pub fn add(&mut self, losses: &Losses) {
        if self.count == 0 {
            self.names = losses.iter().map(|(name, _)| *name).collect();
            self.sums = vec![0.0; losses.len()];
        }
        for (sum, (_, value)) in self.sums.iter_mut().zip(losses) {
            *sum += f64::from(*value);
        }
        self.count += 1;
    }

    /// Returns the names and means.
    fn means(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        let count = f64::from(self.count.max(1));
        let pairs = self.names.iter().zip(&self.sums);
        pairs.map(move |(name, sum)| (*name, sum / count))
    }
}

/// The metrics of one episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetricsRow {
    /// Number of episodes completed.
    pub episode: u32,
    /// Number of slots completed.
    pub global_step: u64,
    /// Names and values of the other columns.
    pub values: Vec<(String, f64)>,
}

impl MetricsRow {
    /// Builds the row of an episode from its outcome, its losses and its evaluation, if any.
    pub fn new(
        episode: u32,
        global_step: u64,
        outcome: &Episode,
        losses: &LossMeans,
        eval_sum_rate: Option<f64>,
    ) -> Self {
        let charts = [
            ("charts/episodic_return", outcome.reward),
            ("charts/rate_reward", outcome.rate_reward),
            ("charts/trajectory_reward", outcome.trajectory_reward),
            (SUM_RATE, outcome.sum_rate),
            ("charts/arrived", f64::from(u8::from(outcome.arrived))),
            ("charts/fair", f64::from(u8::from(outcome.fair))),
            ("charts/mse_violations", outcome.mse_violations.into()),
            ("charts/interventions", outcome.interventions.into()),
        ];
        let evaluation = eval_sum_rate.map(|rate| (EVALUATION, rate));
        let values = charts.into_iter().chain(evaluation).chain(losses.means());
        Self {
            episode,
            global_step,
            values: values
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
        }
    }

    /// Returns the value of a column.
    pub fn get(&self, column: &str) -> Option<f64> {
        let found = self.values.iter().find(|(name, _)| name == column);
        found.map(|(_, value)| *value)
    }
}

/// The column of the total rate with exploration, bit/s/Hz.
pub const SUM_RATE: &str = "charts/sum_rate";

/// The name of the column of deterministic evaluations.
pub const EVALUATION: &str = "charts/eval_sum_rate";
/// The columns of an evaluation on held-out missions: mean, 5 % quantile and worst.
pub const HELD_OUT: [&str; 3] = [
    "charts/held_out_mean",
    "charts/held_out_low",
    "charts/held_out_worst",
];

/// Writes all rows as one CSV file. Columns without a value in a row stay empty.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write_csv(path: &Path, rows: &[MetricsRow]) -> io::Result<()> {
    let mut columns: Vec<&str> = Vec::new();
    for (name, _) in rows.iter().flat_map(|row| &row.values) {
        if !columns.contains(&name.as_str()) {
            columns.push(name);
        }
    }
    let mut text = String::from("episode,global_step");
    for column in &columns {
        text.push(',');
        text.push_str(column);
    }
    text.push('\n');
    for row in rows {
        // Writing to a string cannot fail.
        let _ = write!(text, "{},{}", row.episode, row.global_step);
        for column in &columns {
            text.push(',');
            if let Some(value) = row.get(column) {
                let _ = write!(text, "{value}");
            }
        }
        text.push('\n');
    }
    output::write(path, text.as_bytes())
}
