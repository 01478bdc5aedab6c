//! The checkpoint of a run: `UAVI`, and otherwise as [`crate::checkpoint`].

use std::path::Path;

use anyhow::Context;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::{
    checkpoint::{read_checked, write_checked},
    imitation::{demonstration::Example, settings::ImitationSettings, trained::TrainedNetwork},
    metrics::MetricsRow,
    nn::Adam,
    record::Best,
};

/// The first bytes of a checkpoint.
pub const MAGIC: [u8; 4] = *b"UAVI";
const VERSION: u16 = 4;

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

/// Reads the best network of a checkpoint, or the latest one if none has been evaluated or `latest`
/// asks for it.
///
/// # Errors
/// Fails if the file is no valid checkpoint of an imitation.
pub fn read_network(path: &Path, latest: bool) -> anyhow::Result<TrainedNetwork> {
    let saved = Saved::read(path)?;
    let best = saved.best.filter(|_| !latest);
    let missions = saved.demonstrations.len() as u64;
    let parameters = best.map_or(saved.parameters, |best| best.parameters);
    TrainedNetwork::of_run(&saved.settings, "imitation", missions, parameters)
}

/// Reads what a run did until it was saved.
///
/// # Errors
/// Fails if the file is no valid checkpoint of an imitation.
pub fn read_summary(path: &Path) -> anyhow::Result<Summary> {
    let saved = Saved::read(path)?;
    Ok(Summary {
        steps: saved.step,
        batch: saved.settings.batch,
        minutes: saved.seconds / 60.0,
        best_step: saved.best.map_or(0, |best| best.step),
        rows: saved.rows,
    })
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
