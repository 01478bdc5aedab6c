//! The record that marks a run of a sweep as finished, and the state of a run as its files show it.
//!
//! A checkpoint contains the replay memory and thus has tens of megabytes. The record has what a
//! comparison needs, so that a sweep's state and results can be read without reading its checkpoints,
//! and after they have been deleted.

use std::{fs, io, path::Path};

use anyhow::Context;
use files::output;
use serde::{Deserialize, Serialize};

use crate::{
    checkpoint::TrainingProgress,
    run::{DIVERGED, has_run},
    settings::TrainingSettings,
};

use super::lock::RunLock;

/// The name of the record in the directory of a run.
pub const RECORD: &str = "finished.json";

/// The result of a finished run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// The scenario's name.
    pub scenario: String,
    /// The digest of its mission.
    pub scenario_digest: String,
    /// Number of episodes.
    pub episodes: u32,
    /// The best policy, or `None` if none was admissible when it was evaluated.
    pub best: Option<BestPolicy>,
    /// The settings.
    pub settings: TrainingSettings,
}

/// The evaluation of the best policy of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BestPolicy {
    /// The number of episodes after which it was evaluated.
    pub episode: u32,
    /// Total rate, bit/s/Hz.
    pub sum_rate: f64,
}

impl RunRecord {
    /// Builds the record of a finished run.
    pub fn of(progress: &TrainingProgress) -> Self {
        Self {
            scenario: progress.scenario.clone(),
            scenario_digest: progress.scenario_digest.clone(),
            episodes: progress.episode,
            best: progress.best.as_ref().map(|best| BestPolicy {
                episode: best.episode,
                sum_rate: best.flight.sum_rate,
            }),
            settings: progress.settings.clone(),
        }
    }

    /// Writes the record into the directory of its run.
    ///
    /// # Errors
    /// Returns the file system's error.
    pub fn write(&self, directory: &Path) -> anyhow::Result<()> {
        let path = directory.join(RECORD);
        let mut bytes = serde_json::to_vec_pretty(self)?;
        bytes.push(b'\n');
        output::write(&path, &bytes).with_context(|| path.display().to_string())
    }

    /// Reads the record of a run; returns `None` if the run is not finished.
    ///
    /// # Errors
    /// Fails if the file cannot be read or does not contain a record.
    pub fn read(directory: &Path) -> anyhow::Result<Option<Self>> {
        let path = directory.join(RECORD);
        match fs::read(&path) {
            Ok(bytes) => {
                let record = serde_json::from_slice(&bytes);
                record.with_context(|| path.display().to_string())
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error).with_context(|| path.display().to_string()),
        }
    }
}

/// The state of a run, as far as its files show it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// The run is finished.
    Finished,
    /// A loss diverged. The same would happen again, so the run is not tried again.
    Diverged,
    /// A process executes the run now.
    Running,
    /// The run was stopped; its checkpoint is there.
    Stopped,
    /// The run has not begun.
    NotBegun,
}

impl RunState {
    /// Returns the state of the run in this directory.
    pub fn of(directory: &Path) -> Self {
        if directory.join(RECORD).exists() {
            return Self::Finished;
        }
        // The lock comes first: a process that executes the run removes what an earlier one left.
        if RunLock::is_taken(directory) {
            return Self::Running;
        }
        if directory.join(DIVERGED).exists() {
            return Self::Diverged;
        }
        match has_run(directory) {
            true => Self::Stopped,
            false => Self::NotBegun,
        }
    }

    /// Returns its name for messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Finished => "finished",
            Self::Diverged => "diverged",
            Self::Running => "running",
            Self::Stopped => "stopped",
            Self::NotBegun => "not begun",
        }
    }
}
