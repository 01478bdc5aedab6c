//! The files that a run writes to its directory:
//!
//! | file | content |
//! |---|---|
//! | `policy.onnx` | the best policy so far, by deterministic evaluation |
//! | `metrics.csv`, `events.out.tfevents.*` | see [`crate::metrics`] |
//! | `checkpoint.bin` | see [`crate::checkpoint`]; `--resume` continues from it, bit for bit |
//! | `settings.toml`, `scenario.toml` | all settings, and the scenario |
//! | `diverged.json` | the batch on which a loss became NaN or exceeded its limit, if one did |

use std::{fs, io, path::Path};

use anyhow::{Context, Error, ensure};
use scenario::Scenario;

use crate::checkpoint::{self, TrainingProgress};

/// File name of the checkpoint.
pub const CHECKPOINT: &str = "checkpoint.bin";
/// File name of the best policy.
pub const POLICY: &str = "policy.onnx";
/// File name of the scenario.
pub const SCENARIO: &str = "scenario.toml";
/// File name of the metrics.
pub const METRICS: &str = "metrics.csv";
/// File name of the settings.
pub const SETTINGS: &str = "settings.toml";
/// File name of the batch on which the run diverged.
pub const DIVERGED: &str = "diverged.json";
/// Prefix of the names of TensorBoard event files.
const EVENTS: &str = "events.out.tfevents.";
/// All files of a run except the event files.
const FILES: [&str; 6] = [CHECKPOINT, POLICY, METRICS, SETTINGS, SCENARIO, DIVERGED];

/// Returns whether a directory contains a run.
pub fn has_run(directory: &Path) -> bool {
    directory.join(CHECKPOINT).exists()
}

/// Removes the files of an earlier run, so that they are not mistaken for those of a new one.
///
/// # Errors
/// Returns the file system's error.
pub fn clear(directory: &Path) -> io::Result<()> {
    for entry in fs::read_dir(directory)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let belongs_to_run = FILES.contains(&&*name) || name.starts_with(EVENTS);
        if belongs_to_run {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// A run as read from its directory.
#[derive(Debug)]
pub struct Run {
    /// Its progress.
    pub progress: TrainingProgress,
    /// Its scenario.
    pub scenario: Scenario,
}

impl Run {
    /// Reads checkpoint and scenario. Without a `scenario.toml`, the shipped scenario with the name
    /// in the checkpoint is used.
    ///
    /// # Errors
    /// Fails if there is no valid checkpoint, or if the scenario is not the one of the run.
    pub fn open(directory: &Path) -> anyhow::Result<Self> {
        let progress = checkpoint::read_progress(&directory.join(CHECKPOINT))?;
        let path = directory.join(SCENARIO);
        let scenario = match fs::read_to_string(&path) {
            Ok(text) => {
                Scenario::parse_in(&progress.scenario, &text, directory).map_err(Error::msg)
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                let shipped = Scenario::shipped(&progress.scenario);
                shipped.context("file not found, and no scenario of this name is shipped")
            }
            Err(error) => Err(error.into()),
        };
        let scenario = scenario.with_context(|| path.display().to_string())?;
        ensure!(
            scenario.digest() == progress.scenario_digest,
            "{}: scenario {} has digest {}, but the run was made on {}",
            path.display(),
            scenario.name,
            scenario.digest(),
            progress.scenario_digest
        );
        Ok(Self { progress, scenario })
    }
}
