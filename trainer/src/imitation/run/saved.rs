//! The checkpoint of a run: `UAVI`, and otherwise as [`crate::checkpoint`].

use std::path::Path;

use anyhow::{Context, ensure};
use firmware_core::policy::sets::SetsProvenance;
use rand_pcg::Pcg64Mcg;
use scenario::Layout;
use serde::{Deserialize, Serialize};

use crate::{
    checkpoint::{read_checked_within, write_checked},
    imitation::{demonstration::Example, settings::ImitationSettings, trained::TrainedNetwork},
    metrics::MetricsRow,
    nn::Adam,
};

const MAGIC: [u8; 4] = *b"UAVI";
const VERSION: u16 = 3;
/// The earliest version that can be read. It has no layouts that are left out.
const VERSION_MIN: u16 = 2;

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
    /// Seeds and examples of the missions.
    pub(super) demonstrations: Vec<(u64, Vec<Example>)>,
    /// Those that have been made but not learned from.
    pub(super) ready: Vec<(u64, Vec<Example>)>,
    pub(super) next: u64,
    pub(super) pilot: Option<Vec<f32>>,
    pub(super) rows: Vec<MetricsRow>,
    pub(super) losses: Vec<f64>,
    pub(super) losses_since: u64,
}

impl Saved {
    pub(super) fn write(&self, path: &Path) -> anyhow::Result<()> {
        let data = (self, &self.settings.left_out_layouts);
        write_checked(path, MAGIC, VERSION, &data)
    }

    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let (version, bytes) = read_checked_within(path, MAGIC, VERSION_MIN..=VERSION)?;
        let damaged = || format!("{}: damaged", path.display());
        let (mut saved, mut rest) =
            postcard::take_from_bytes::<Self>(&bytes[10..]).with_context(damaged)?;
        if version > VERSION_MIN {
            let left_out = postcard::take_from_bytes::<Vec<Layout>>(rest);
            (saved.settings.left_out_layouts, rest) = left_out.with_context(damaged)?;
        }
        ensure!(
            rest.is_empty(),
            "{}: {} bytes too many",
            damaged(),
            rest.len()
        );
        Ok(saved)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imitation::run::{Imitation, Threads};

    /// Checkpoints from before layouts could be left out say the same, and the setting is kept by
    /// those of today.
    #[test]
    fn a_checkpoint_of_the_version_before_is_read() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("checkpoint.bin");
        let settings = ImitationSettings {
            steps: 1,
            batch: 4,
            first_missions: 1,
            planning_operations: 1_000_000,
            held_out_missions: 1,
            left_out_layouts: vec![Layout::Ring, Layout::Line],
            ..ImitationSettings::default()
        };
        let threads = Threads::default();
        let mut run =
            Imitation::start(settings, None, directory.path().to_owned(), threads).expect("starts");
        run.run(false).expect("runs");
        let network = TrainedNetwork::read(&path, false).expect("saved");
        assert_eq!(network.provenance.missions, "random without ring, line");
        let saved = Saved::read(&path).expect("saved");
        let left_out = &saved.settings.left_out_layouts;
        assert_eq!(left_out, &[Layout::Ring, Layout::Line]);

        write_checked(&path, MAGIC, VERSION_MIN, &saved).expect("written");
        let earlier = Saved::read(&path).expect("readable");
        let plain = ImitationSettings {
            left_out_layouts: Vec::new(),
            ..saved.settings.clone()
        };
        assert_eq!(earlier.settings, plain);
        assert_eq!(earlier.parameters, saved.parameters);
        assert_eq!(earlier.demonstrations, saved.demonstrations);

        write_checked(&path, MAGIC, VERSION, &(&saved, left_out, 0_u8)).expect("written");
        let error = Saved::read(&path).expect_err("a byte too many");
        assert!(
            error.to_string().ends_with("damaged: 1 bytes too many"),
            "{error}"
        );
    }
}
