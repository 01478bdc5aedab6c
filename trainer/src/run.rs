//! A run in its directory:
//!
//! | file | |
//! |---|---|
//! | `policy.onnx` | the best policy so far, by deterministic evaluation |
//! | `metrics.csv`, `events.out.tfevents.*` | see [`crate::metrics`] |
//! | `checkpoint.bin` | see [`crate::checkpoint`]; `--resume` goes on from it, bit for bit |
//! | `settings.toml`, `scenario.toml` | everything that was set, and what is flown |
//! | `diverged.json` | the batch on which a loss became NaN or exploded, if one did |

use std::{fs, io, path::Path};

use anyhow::{Context, Error, ensure};
use scenario::Scenario;

use crate::checkpoint::{self, Progress};

/// A run's checkpoint in its directory.
pub const CHECKPOINT: &str = "checkpoint.bin";
/// A run's best policy in its directory.
pub const POLICY: &str = "policy.onnx";
/// A run's scenario in its directory.
pub const SCENARIO: &str = "scenario.toml";

/// Its learning curve.
pub const METRICS: &str = "metrics.csv";
/// What was set.
pub const SETTINGS: &str = "settings.toml";
/// The batch on which it broke off, if it did.
pub const DIVERGED: &str = "diverged.json";
/// How the names of its event files begin.
const EVENTS: &str = "events.out.tfevents.";
/// What is a run's and no other's.
const LEFT: [&str; 6] = [CHECKPOINT, POLICY, METRICS, SETTINGS, SCENARIO, DIVERGED];

/// Whether a directory holds a run already.
pub fn has_run(directory: &Path) -> bool {
    directory.join(CHECKPOINT).exists()
}

/// Takes away what an earlier run left, so that nothing of it is taken for the new one's.
///
/// # Errors
/// Of the file system.
pub fn clear(directory: &Path) -> io::Result<()> {
    for entry in fs::read_dir(directory)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let left = LEFT.contains(&&*name) || name.starts_with(EVENTS);
        if left {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// What a directory says about its run.
#[derive(Debug)]
pub struct Run {
    /// Where it stands.
    pub progress: Progress,
    /// What is flown.
    pub scenario: Scenario,
}

impl Run {
    /// Reads checkpoint and scenario; without a `scenario.toml`, the shipped scenario of the
    /// run's name.
    ///
    /// # Errors
    /// No sound checkpoint, or a scenario that is not the one it was made on.
    pub fn open(directory: &Path) -> anyhow::Result<Self> {
        let progress = checkpoint::read_progress(&directory.join(CHECKPOINT))?;
        let path = directory.join(SCENARIO);
        let scenario = match fs::read_to_string(&path) {
            Ok(text) => Scenario::parse(&progress.scenario, &text).map_err(Error::msg),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                Scenario::shipped(&progress.scenario).context("is not there")
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
