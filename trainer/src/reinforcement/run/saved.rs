//! The checkpoint of a run: `UAVR`, and otherwise as [`crate::checkpoint`].

use std::path::Path;

use anyhow::Context;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::{
    checkpoint::{read_checked, write_checked},
    imitation::{demonstration::SavedDemonstration, run::Summary, trained::TrainedNetwork},
    record::Progress,
    reinforcement::{
        episode::Episode, networks::SavedNetworks, settings::ReinforcementSettings, task::SavedTask,
    },
};

/// The first bytes of a checkpoint.
pub const MAGIC: [u8; 4] = *b"UAVR";
const VERSION: u16 = 1;

/// Everything that the continuation depends on.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved {
    /// The settings.
    pub settings: ReinforcementSettings,
    /// What the run did so far.
    pub progress: Progress,
    /// What is learned.
    pub networks: SavedNetworks,
    /// The random number generator.
    pub rng: Pcg64Mcg,
    /// Demonstration and flight of each mission in the memory.
    pub missions: Vec<(SavedDemonstration, Episode)>,
    /// The number of missions flown.
    pub added: u64,
    /// The missions that have been prepared but not flown.
    pub ready: Vec<SavedTask>,
    /// The index of the next mission to be asked for.
    pub next: u64,
    /// The fraction of the plan's total that the last mission was flown with.
    pub flown: f64,
}

impl Saved {
    /// Writes the checkpoint.
    ///
    /// # Errors
    /// Returns the file system's error.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        write_checked(path, MAGIC, VERSION, self)
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// Fails if the file is no valid checkpoint of such a run.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let bytes = read_checked(path, MAGIC, VERSION)?;
        let saved = postcard::from_bytes(&bytes[10..]);
        saved.with_context(|| format!("{}: damaged", path.display()))
    }

    /// Returns the best network, or the latest one if none has been evaluated or `latest` asks for it.
    ///
    /// # Errors
    /// Fails if the run has flown more missions than a provenance can count.
    pub fn network(self, latest: bool) -> anyhow::Result<TrainedNetwork> {
        let best = self.progress.best.filter(|_| !latest);
        let parameters = best.map_or(self.networks.actor.0, |best| best.parameters);
        TrainedNetwork::of_run(&self.settings.imitation, "sac", self.added, parameters)
    }

    /// Returns what the run did.
    pub fn summary(self) -> Summary {
        let progress = self.progress;
        Summary {
            steps: progress.step,
            batch: self.settings.imitation.batch,
            minutes: progress.seconds / 60.0,
            best_step: progress.best.map_or(0, |best| best.step),
            rows: progress.rows,
        }
    }
}
