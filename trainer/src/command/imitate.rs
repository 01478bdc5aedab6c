//! `trainer train --missions random` and `--from`: one policy for any mission, and a policy for any
//! mission adapted to one.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use clap::Args;
use scenario::Layout;
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
    /// With --missions random or --from: train for so many minutes; the results then depend on the machine's
    /// speed
    #[arg(long, conflicts_with = "steps")]
    minutes: Option<f64>,
    /// With --missions random or --from: number of gradient steps [default with --from: 1000]
    #[arg(long)]
    steps: Option<u64>,
    /// Start from the best network of this checkpoint.bin of a policy for any mission, from this .onnx
    /// file of one, or from `new`, an untrained network. Without --missions, the network is adapted
    /// to the scenario, by imitation of the planner
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "resume", "algorithm", "preset", "episodes", "discount", "inner", "constraints", "seeds",
    ])]
    from: Option<PathBuf>,
    /// With --missions random: draw no missions whose users or sensors have this layout, so that the
    /// network can be evaluated on layouts that it has not learned from; may be given several times
    #[arg(long, value_enum, value_name = "LAYOUT", requires = "missions")]
    leave_out: Vec<Layout>,
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

    /// Returns whether the run starts from a network for any mission.
    pub(super) fn adapts(&self) -> bool {
        self.from.is_some()
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
        if !self.leave_out.is_empty() {
            settings.left_out_layouts = self.leave_out.clone();
        }
        let start = || -> anyhow::Result<_> {
            let from = match &self.from {
                Some(path) if path.as_os_str() != "new" => {
                    let network = read_network(path)?;
                    ensure!(
                        network.architecture == settings.architecture,
                        "{}: the network has {:?}, but {:?} was asked for",
                        path.display(),
                        network.architecture,
                        settings.architecture
                    );
                    let learned_from = &network.provenance.missions;
                    ensure!(
                        settings.left_out_layouts.is_empty()
                            || learned_from.as_str() == settings.distribution(),
                        "{}: the network has learned from missions \"{learned_from}\", but the run's are to be \
                         \"{}\"",
                        path.display(),
                        settings.distribution(),
                    );
                    Some(network.parameters)
                }
                _ => None,
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
