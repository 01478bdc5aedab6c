//! `trainer train`.

use std::{fs, path::PathBuf, time::Instant};

use anyhow::{Context, Error, anyhow, ensure};
use clap::Args;
use host_sim::scenario::ScenarioChoice;
use trainer::{
    ddpg::Ddpg,
    learner::Learner,
    run::{CHECKPOINT, POLICY, has_run},
    sac::Sac,
    settings::{Algorithm, Constraints, Preset, Settings},
    training::Training,
};

use super::{Failure, Outcome};

#[derive(Debug, Args)]
pub(crate) struct Train {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// What learns
    #[arg(long, value_enum, default_value = "sac")]
    algorithm: Algorithm,
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
    /// How forbidden actions are treated
    #[arg(long, value_enum)]
    constraints: Option<Constraints>,
    /// Where random numbers start: the same seed gives the same bytes
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Directory of the run [default: out/SCENARIO-ALGORITHM-SEED]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Go on from the checkpoint in the run's directory
    #[arg(long, conflicts_with_all = ["preset", "settings", "learning_rate", "discount", "constraints"])]
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
        match self.algorithm {
            Algorithm::Sac => self.train::<Sac>(),
            Algorithm::Ddpg => self.train::<Ddpg>(),
        }
    }

    fn train<L: Learner>(&self) -> Outcome {
        let (training, directory) = self.prepare::<L>().map_err(Failure::BadInput)?;
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

    fn prepare<L: Learner>(&self) -> anyhow::Result<(Training<L>, PathBuf)> {
        let scenario = self.mission.load().map_err(Error::msg)?;
        let directory = self.out.clone().unwrap_or_else(|| {
            let algorithm = self.algorithm.name();
            PathBuf::from("out").join(format!("{}-{algorithm}-{}", scenario.name, self.seed))
        });
        if self.resume {
            let training = Training::resume(scenario, directory.clone(), self.episodes)?;
            return Ok((training, directory));
        }
        ensure!(
            self.overwrite || !has_run(&directory),
            "{} holds a run already: --resume goes on, --overwrite starts anew, --out names \
             another directory",
            directory.display()
        );
        let training = Training::start(scenario, self.collect_settings()?, directory.clone())?;
        Ok((training, directory))
    }

    fn collect_settings(&self) -> anyhow::Result<Settings> {
        let mut settings = Settings::preset(self.preset, self.algorithm, self.seed);
        if let Some(path) = &self.settings {
            let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
            settings = overlay(&settings, &text).with_context(|| path.display().to_string())?;
        }
        if let Some(rate) = self.learning_rate {
            settings.policy_learning_rate = rate;
            settings.critic_learning_rate = rate;
            settings.temperature_learning_rate = rate;
        }
        settings.episodes = self.episodes.unwrap_or(settings.episodes);
        settings.discount = self.discount.unwrap_or(settings.discount);
        settings.constraints = self.constraints.unwrap_or(settings.constraints);
        settings.check()?;
        Ok(settings)
    }
}

/// The settings with those values replaced that a TOML text names.
fn overlay(settings: &Settings, text: &str) -> anyhow::Result<Settings> {
    let mut table = toml::Table::try_from(settings)?;
    for (key, value) in text.parse::<toml::Table>()? {
        table.insert(key, value);
    }
    Ok(table.try_into()?)
}
