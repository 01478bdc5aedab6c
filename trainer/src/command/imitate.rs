//! `trainer train --missions random` and `--from`: one policy for any mission, by imitation or by SAC,
//! and a policy for any mission adapted to one.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use clap::Args;
use scenario::Layout;
use trainer::{
    any_mission::{self, Method},
    imitation::{run::Imitation, settings::ImitationSettings, trained::TrainedNetwork},
    onnx,
    record::Threads,
    reinforcement::{run::Reinforcement, settings::ReinforcementSettings},
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
    /// file of one, or from `new`, an untrained network. With --algorithm sac, SAC improves it. Without
    /// --missions, the network is adapted
    /// to the scenario, by imitation of the planner
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "resume", "preset", "episodes", "discount", "inner", "constraints", "seeds",
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

    /// Returns whether the run improves a trained network.
    pub(super) fn improves(&self) -> bool {
        self.start_file().is_some()
    }

    /// Returns the file of the network that the run starts from, if it is not an untrained one.
    fn start_file(&self) -> Option<&Path> {
        let path = self.from.as_deref();
        path.filter(|path| path.as_os_str() != "new")
    }

    /// Sets duration and left-out layouts, if they are given.
    fn set(&self, settings: &mut ImitationSettings) {
        if self.has_duration() {
            settings.minutes = self.minutes.unwrap_or(0.0);
            settings.steps = self.steps.unwrap_or(0);
        }
        if !self.leave_out.is_empty() {
            settings.left_out_layouts = self.leave_out.clone();
        }
    }

    /// Returns the parameters that the run starts from, if they are not random.
    fn parameters(&self, settings: &ImitationSettings) -> anyhow::Result<Option<Vec<f32>>> {
        let Some(path) = self.start_file() else {
            return Ok(None);
        };
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
        Ok(Some(network.parameters))
    }

    /// Starts a run of imitation.
    pub(super) fn start(
        &self,
        mut settings: ImitationSettings,
        directory: &Path,
        show: bool,
    ) -> Outcome {
        self.set(&mut settings);
        let start = || -> anyhow::Result<_> {
            let from = self.parameters(&settings)?;
            let directory = directory.to_owned();
            Imitation::start(settings, from.as_deref(), directory, self.threads())
        };
        imitate(start().map_err(Failure::BadInput)?, directory, show)
    }

    /// Starts a run of SAC.
    pub(super) fn start_reinforcement(
        &self,
        mut settings: ReinforcementSettings,
        directory: &Path,
        show: bool,
    ) -> Outcome {
        self.set(&mut settings.imitation);
        let start = || -> anyhow::Result<_> {
            let from = self.parameters(&settings.imitation)?;
            let directory = directory.to_owned();
            Reinforcement::start(settings, from.as_deref(), directory, self.threads())
        };
        reinforce(start().map_err(Failure::BadInput)?, directory, show)
    }

    /// Continues a run.
    pub(super) fn resume(&self, method: Method, directory: &Path, show: bool) -> Outcome {
        let (steps, minutes, threads) = (self.steps, self.minutes, self.threads());
        let run = directory.to_owned();
        match method {
            Method::Imitation => {
                let run = Imitation::resume(run, steps, minutes, threads);
                imitate(run.map_err(Failure::BadInput)?, directory, show)
            }
            Method::Reinforcement => {
                let run = Reinforcement::resume(run, steps, minutes, threads);
                reinforce(run.map_err(Failure::BadInput)?, directory, show)
            }
        }
    }
}

/// Reads the network that training starts from.
fn read_network(path: &Path) -> anyhow::Result<TrainedNetwork> {
    match path.extension().is_some_and(|kind| kind == "onnx") {
        true => Ok(onnx::sets::read(path)?.0),
        false => any_mission::read_network(path, false),
    }
}

fn imitate(mut run: Imitation, directory: &Path, show: bool) -> Outcome {
    let best = run.run(show).map_err(Failure::Failed)?;
    print_result(run.steps(), best, directory);
    Ok(())
}

fn reinforce(mut run: Reinforcement, directory: &Path, show: bool) -> Outcome {
    let best = run.run(show).map_err(Failure::Failed)?;
    print_result(run.steps(), best, directory);
    Ok(())
}

fn print_result(steps: u64, best: Option<f64>, directory: &Path) {
    let best = best.map_or("none".into(), |mean| format!("{mean:.4}"));
    println!(
        "{steps} steps; best mean fraction of the planner's totals on held-out missions: {best}; {}",
        directory.join(CHECKPOINT).display()
    );
}
