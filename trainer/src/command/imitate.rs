//! `trainer train --missions random`: one policy for any mission.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use clap::Args;
use trainer::{
    imitation::{
        run::{Imitation, Threads},
        settings::ImitationSettings,
        trained::TrainedNetwork,
    },
    onnx,
    run::CHECKPOINT,
};

use super::outcome::{Failure, Outcome};

/// The options of `--missions random`, and of `--resume` for such a run.
#[derive(Debug, Args)]
pub(crate) struct ImitationOptions {
    /// With --missions random: train for so many minutes; the results then depend on the machine's
    /// speed
    #[arg(long, conflicts_with = "steps")]
    minutes: Option<f64>,
    /// With --missions random: number of gradient steps
    #[arg(long)]
    steps: Option<u64>,
    /// With --missions random: start from the best network of this checkpoint.bin, or from this .onnx
    /// file for any mission
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "resume",
        requires = "missions"
    )]
    from: Option<PathBuf>,
    /// With --missions random: threads that compute gradients; they change no result
    #[arg(long, default_value_t = 1)]
    gradient_threads: usize,
    /// With --missions random: threads that plan missions; they change no result
    #[arg(long, default_value_t = 1)]
    planning_threads: usize,
}

impl ImitationOptions {
    /// Returns whether the duration of an imitation is given.
    pub(super) fn has_duration(&self) -> bool {
        self.minutes.is_some() || self.steps.is_some()
    }

    fn threads(&self) -> Threads {
        Threads {
            gradient: self.gradient_threads,
            planning: self.planning_threads,
        }
    }

    /// Starts a run.
    pub(super) fn start(
        &self,
        mut settings: ImitationSettings,
        directory: &Path,
        show: bool,
    ) -> Outcome {
        if self.has_duration() {
            settings.minutes = self.minutes.unwrap_or(0.0);
            settings.steps = self.steps.unwrap_or(0);
        }
        let start = || -> anyhow::Result<_> {
            let from = match &self.from {
                Some(path) => {
                    let network = read_network(path)?;
                    ensure!(
                        network.architecture == settings.architecture,
                        "{}: the network has {:?}, but {:?} was asked for",
                        path.display(),
                        network.architecture,
                        settings.architecture
                    );
                    Some(network.parameters)
                }
                None => None,
            };
            let directory = directory.to_owned();
            Imitation::start(settings, from.as_deref(), directory, self.threads())
        };
        train(start().map_err(Failure::BadInput)?, directory, show)
    }

    /// Continues a run.
    pub(super) fn resume(&self, directory: &Path, show: bool) -> Outcome {
        let threads = self.threads();
        let run = Imitation::resume(directory.to_owned(), self.steps, self.minutes, threads);
        train(run.map_err(Failure::BadInput)?, directory, show)
    }
}

/// Reads the network that training starts from.
fn read_network(path: &Path) -> anyhow::Result<TrainedNetwork> {
    match path.extension().is_some_and(|kind| kind == "onnx") {
        true => Ok(onnx::sets::read(path)?.0),
        false => TrainedNetwork::read(path, false),
    }
}

fn train(mut run: Imitation, directory: &Path, show: bool) -> Outcome {
    let best = run.run(show).map_err(Failure::Failed)?;
    let best = best.map_or("none".into(), |mean| format!("{mean:.4}"));
    println!(
        "{} steps; best mean fraction of the planner's totals on held-out missions: {best}; {}",
        run.steps(),
        directory.join(CHECKPOINT).display()
    );
    Ok(())
}
