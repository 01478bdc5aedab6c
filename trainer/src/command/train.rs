//! `trainer train`.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Context, Error, anyhow, ensure};
use clap::Args;
use environment::Constraints;
use host_sim::{
    allocation::Allocation,
    input,
    scenario::{Scenario, ScenarioChoice},
};
use trainer::{
    ddpg::Ddpg,
    learner::Learner,
    run::{CHECKPOINT, POLICY, Run, has_run},
    sac::Sac,
    settings::{Algorithm, Preset, Settings},
    training::Training,
};

use super::{Failure, Outcome};

#[derive(Debug, Args)]
pub(crate) struct Train {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// What learns [default: sac, or what the settings file or the run to go on with says]
    #[arg(long, value_enum)]
    algorithm: Option<Algorithm>,
    /// Which values the settings start from
    #[arg(long, value_enum, default_value = "paper")]
    preset: Preset,
    /// TOML file with settings that replace the preset's; names as in a run's settings.toml
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Episodes to train (paper: 4000)
    #[arg(long)]
    episodes: Option<u32>,
    /// Learning rate of policy, critics and temperatures (paper: 1e-4)
    #[arg(long)]
    learning_rate: Option<f32>,
    /// Discount factor (paper: 0.90)
    #[arg(long)]
    discount: Option<f32>,
    /// How powers are chosen: exact, alternating, fixed-user-power[:WATTS] or
    /// fixed-sensor-power[:WATTS] (default: exact)
    #[arg(long)]
    inner: Option<Allocation>,
    /// How forbidden actions are treated
    #[arg(long, value_enum)]
    constraints: Option<Constraints>,
    /// Where random numbers start: the same seed gives the same bytes [default: 1, or what the
    /// settings file says]
    #[arg(long)]
    seed: Option<u64>,
    /// Directory of the run [default: out/SCENARIO-ALGORITHM-SEED]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Go on with the run in --out, on its scenario and with its settings; --episodes may differ
    #[arg(
        long,
        requires = "out",
        conflicts_with_all = [
            "scenario", "mse_threshold", "noise_dbm", "slots", "algorithm", "preset", "settings",
            "learning_rate", "discount", "inner", "constraints", "seed",
        ]
    )]
    resume: bool,
    /// Start anew where there is a run already
    #[arg(long, conflicts_with = "resume")]
    overwrite: bool,
    /// No progress bar
    #[arg(long)]
    quiet: bool,
}

impl Train {
    pub(crate) fn execute(self) -> Outcome {
        match &self.out {
            Some(directory) if self.resume => {
                let run = Run::open(directory).map_err(Failure::BadInput)?;
                match run.progress.settings.algorithm {
                    Algorithm::Sac => self.resume::<Sac>(run.scenario, directory),
                    Algorithm::Ddpg => self.resume::<Ddpg>(run.scenario, directory),
                }
            }
            _ => {
                let settings = self.collect_settings().map_err(Failure::BadInput)?;
                match settings.algorithm {
                    Algorithm::Sac => self.start::<Sac>(settings),
                    Algorithm::Ddpg => self.start::<Ddpg>(settings),
                }
            }
        }
    }

    fn resume<L: Learner>(&self, scenario: Scenario, directory: &Path) -> Outcome {
        let training = Training::<L>::resume(scenario, directory.to_owned(), self.episodes);
        self.train(training.map_err(Failure::BadInput)?, directory)
    }

    fn start<L: Learner>(&self, settings: Settings) -> Outcome {
        let (training, directory) = self.prepare::<L>(settings).map_err(Failure::BadInput)?;
        self.train(training, &directory)
    }

    fn train<L: Learner>(&self, training: Training<L>, directory: &Path) -> Outcome {
        let start = Instant::now();
        let progress = training.run(!self.quiet).map_err(Failure::Failed)?;
        let best = progress.best.ok_or_else(|| {
            Failure::Failed(anyhow!(
                "no policy kept every constraint when it was evaluated; the latest is in {}",
                directory.join(CHECKPOINT).display()
            ))
        })?;
        println!(
            "{} episodes, this time {:.0} s; best policy (episode {}): {:.3} bit/s/Hz in {} slots; {}",
            progress.episode,
            start.elapsed().as_secs_f64(),
            best.episode,
            best.flight.sum_rate,
            best.flight.served_users.len(),
            directory.join(POLICY).display()
        );
        Ok(())
    }

    fn prepare<L: Learner>(&self, settings: Settings) -> anyhow::Result<(Training<L>, PathBuf)> {
        let scenario = self.mission.load().map_err(Error::msg)?;
        settings
            .inner
            .check(&scenario.mission)
            .map_err(Error::msg)?;
        let directory = self.out.clone().unwrap_or_else(|| {
            let (algorithm, seed) = (settings.algorithm.name(), settings.seed);
            PathBuf::from("out").join(format!("{}-{algorithm}-{seed}", scenario.name))
        });
        ensure!(
            self.overwrite || !has_run(&directory),
            "{} holds a run already: --resume goes on, --overwrite starts anew, --out names \
             another directory",
            directory.display()
        );
        let training = Training::start(scenario, settings, directory.clone())?;
        Ok((training, directory))
    }

    /// The preset's, what the settings file replaces, what the command line replaces.
    fn collect_settings(&self) -> anyhow::Result<Settings> {
        let file = match &self.settings {
            Some(path) => {
                let text = input::read_text(path).with_context(|| path.display().to_string())?;
                let table = text.parse::<toml::Table>();
                Some((path, table.with_context(|| path.display().to_string())?))
            }
            None => None,
        };
        // Of the two presets of an algorithm.
        let named = file.as_ref().and_then(|(_, table)| table.get("algorithm"));
        let named = named.and_then(|name| name.clone().try_into().ok());
        let algorithm = self.algorithm.or(named).unwrap_or(Algorithm::Sac);
        let mut settings = Settings::preset(self.preset, algorithm, 1);
        if let Some((path, table)) = file {
            settings = overlay(&settings, table).with_context(|| path.display().to_string())?;
        }
        if let Some(rate) = self.learning_rate {
            settings.policy_learning_rate = rate;
            settings.critic_learning_rate = rate;
            settings.temperature_learning_rate = rate;
        }
        settings.algorithm = algorithm;
        settings.seed = self.seed.unwrap_or(settings.seed);
        settings.episodes = self.episodes.unwrap_or(settings.episodes);
        settings.discount = self.discount.unwrap_or(settings.discount);
        settings.inner = self.inner.unwrap_or(settings.inner);
        settings.constraints = self.constraints.unwrap_or(settings.constraints);
        let checked = settings.check();
        match &self.settings {
            Some(path) => checked.with_context(|| path.display().to_string())?,
            None => checked?,
        }
        Ok(settings)
    }
}

/// The settings with those values replaced that a table names.
fn overlay(settings: &Settings, changes: toml::Table) -> anyhow::Result<Settings> {
    let mut table = toml::Table::try_from(settings)?;
    table.extend(changes);
    Ok(table.try_into()?)
}
