//! The checkpoint of a run: `UAVI`, and otherwise as [`crate::checkpoint`].

use std::path::Path;

use anyhow::Context;
use firmware_core::policy::sets::SetsProvenance;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::{
    checkpoint::{read_checked, write_checked},
    imitation::{demonstration::Example, settings::ImitationSettings, trained::TrainedNetwork},
    metrics::MetricsRow,
    nn::Adam,
};

const MAGIC: [u8; 4] = *b"UAVI";
const VERSION: u16 = 4;

/// The best network so far.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Best {
    /// Its mean fraction of the planner's totals.
    pub(super) mean: f64,
    /// The step after which it was evaluated.
    pub(super) step: u64,
    /// Its parameters, in the order of the file.
    pub(super) parameters: Vec<f32>,
}

/// Everything that the continuation depends on.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Saved {
    pub(super) settings: ImitationSettings,
    pub(super) parameters: Vec<f32>,
    pub(super) best: Option<Best>,
    pub(super) step: u64,
    pub(super) seconds: f64,
    pub(super) adam: Adam,
    pub(super) rng: Pcg64Mcg,
    /// Seeds, weights and examples of the missions.
    pub(super) demonstrations: Vec<(u64, f64, Vec<Example>)>,
    /// Those that have been made but not learned from.
    pub(super) ready: Vec<(u64, f64, Vec<Example>)>,
    pub(super) next: u64,
    pub(super) pilot: Option<Vec<f32>>,
    pub(super) rows: Vec<MetricsRow>,
    pub(super) losses: Vec<f64>,
    pub(super) losses_since: u64,
}

impl Saved {
    pub(super) fn write(&self, path: &Path) -> anyhow::Result<()> {
        write_checked(path, MAGIC, VERSION, self)
    }

    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let bytes = read_checked(path, MAGIC, VERSION)?;
        let saved = postcard::from_bytes(&bytes[10..]);
        saved.with_context(|| format!("{}: damaged", path.display()))
    }
}

/// Returns whether a file is the checkpoint of an imitation.
pub fn is_imitation(path: &Path) -> bool {
    std::fs::read(path).is_ok_and(|bytes| bytes.starts_with(&MAGIC))
}

impl TrainedNetwork {
    /// Reads the best network of a checkpoint, or the latest one if none has been evaluated or
    /// `latest` asks for it.
    ///
    /// # Errors
    /// Fails if the file is no valid checkpoint of an imitation.
    pub fn read(path: &Path, latest: bool) -> anyhow::Result<Self> {
        let saved = Saved::read(path)?;
        let best = saved.best.filter(|_| !latest);
        let text = "a provenance is bounded";
        let missions = saved.settings.distribution();
        Ok(Self {
            architecture: saved.settings.architecture,
            parameters: best.map_or(saved.parameters, |best| best.parameters),
            provenance: SetsProvenance {
                algorithm: "imitation".try_into().ok().context(text)?,
                missions: missions.as_str().try_into().ok().context(text)?,
                episodes: saved.demonstrations.len().try_into()?,
                seed: saved.settings.seed,
            },
        })
    }
}

/// What a run did until it was saved.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Number of gradient steps.
    pub steps: u64,
    /// Number of states of a gradient step.
    pub batch: usize,
    /// Duration, minutes.
    pub minutes: f64,
    /// The step after which the best network was evaluated, 0 without one.
    pub best_step: u64,
    /// The metrics.
    pub rows: Vec<MetricsRow>,
}

impl Summary {
    /// Reads the summary from a checkpoint.
    ///
    /// # Errors
    /// Fails if the file is no valid checkpoint of an imitation.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let saved = Saved::read(path)?;
        Ok(Self {
            steps: saved.step,
            batch: saved.settings.batch,
            minutes: saved.seconds / 60.0,
            best_step: saved.best.map_or(0, |best| best.step),
            rows: saved.rows,
        })
    }
}
