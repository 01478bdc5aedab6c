//! `trainer train`: one run, or one run per seed.

use std::{
    path::{Path, PathBuf},
    str::FromStr,
    time::Instant,
};

use anyhow::{Context, Error, anyhow, ensure};
use clap::{Args, ValueEnum};
use environment::{Allocation, Constraints};
use files::input;
use scenario::{Scenario, ScenarioChoice};
use trainer::{
    any_mission,
    ddpg::Ddpg,
    imitation::settings::ImitationSettings,
    learner::Learner,
    overlay::overlay,
    reinforcement::settings::ReinforcementSettings,
    run::{CHECKPOINT, POLICY, Run, has_run},
    sac::Sac,
    settings::{Algorithm, Preset, TrainingSettings},
    training::Training,
};

use super::{
    imitate::ImitationOptions,
    outcome::{Failure, Outcome},
};

#[derive(Debug, Args)]
pub(crate) struct Train {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// Train one policy for any mission, on missions drawn at random, by imitation of the planner or,
    /// with --algorithm sac, by SAC
    #[arg(long, value_enum, conflicts_with_all = [
        "scenario", "mse_threshold", "noise_dbm", "slots", "preset", "episodes",
        "discount", "inner", "constraints", "seeds", "resume",
    ])]
    missions: Option<Missions>,
    #[command(flatten)]
    imitation: ImitationOptions,
    /// The learning algorithm [default: sac, or as in the settings file; with --missions random:
    /// imitation of the planner]
    #[arg(long, value_enum)]
    algorithm: Option<Algorithm>,
    /// The preset that the settings start from
    #[arg(long, value_enum, default_value = "paper")]
    preset: Preset,
    /// TOML file with settings that override the preset; it has the names of a run's settings.toml
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Number of episodes (paper: 4000)
    #[arg(long)]
    episodes: Option<u32>,
    /// Learning rate of policy, critics and temperatures (paper: 1e-4)
    #[arg(long)]
    learning_rate: Option<f32>,
    /// Discount factor (paper: 0.90)
    #[arg(long)]
    discount: Option<f32>,
    /// How the powers of a slot are chosen: exact, alternating, fixed-user-power[:WATTS] or
    /// fixed-sensor-power[:WATTS] (default: exact)
    #[arg(long)]
    inner: Option<Allocation>,
    /// How forbidden actions are treated
    #[arg(long, value_enum)]
    constraints: Option<Constraints>,
    /// Seed of all random numbers; the same seed gives the same bytes [default: 1, or as in the
    /// settings file]
    #[arg(long)]
    seed: Option<u64>,
    /// Train one run per seed, from the first to the last one inclusive, each in its own directory
    /// OUT/seed-K
    #[arg(long, value_name = "FIRST..LAST", conflicts_with = "seed")]
    seeds: Option<Seeds>,
    /// Directory of the run [default: out/SCENARIO-ALGORITHM-SEED; with --seeds
    /// out/SCENARIO-ALGORITHM]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Continue the run in --out, with its scenario and settings; only --episodes may differ
    #[arg(
        long,
        requires = "out",
        conflicts_with_all = [
            "scenario", "mse_threshold", "noise_dbm", "slots", "algorithm", "preset", "settings",
            "learning_rate", "discount", "inner", "constraints", "seed", "seeds",
        ]
    )]
    resume: bool,
    /// Replace a run that the directory already contains
    #[arg(long, conflicts_with = "resume")]
    overwrite: bool,
    /// Show no progress bar
    #[arg(long)]
    quiet: bool,
}

/// The missions of a policy for any mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Missions {
    /// Of the distribution of `host-sim scenario random`, each new
    Random,
}

/// An inclusive range of seeds, `FIRST..LAST` on the command line.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seeds {
    first: u64,
    last: u64,
}

impl Seeds {
    /// The largest number of runs that one command trains.
    const COUNT_MAX: u64 = 1_000;

    fn all(self) -> impl Iterator<Item = u64> {
        self.first..=self.last
    }
}

impl FromStr for Seeds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = |part: &str| {
            part.parse::<u64>().map_err(|_| {
                format!(
                    "{part:?} is not a seed, a whole number from 0 to {}",
                    u64::MAX
                )
            })
        };
        let (first, last) = text
            .split_once("..")
            .ok_or("a range of seeds has the form FIRST..LAST, for example 1..3")?;
        let (first, last) = (parse(first)?, parse(last)?);
        if first > last {
            return Err(format!(
                "the first seed, {first}, is above the last, {last}"
            ));
        }
        if last - first >= Self::COUNT_MAX {
            return Err(format!("more than {} seeds", Self::COUNT_MAX));
        }
        Ok(Self { first, last })
    }
}

impl Train {
    pub(crate) fn execute(self) -> Outcome {
        if self.missions == Some(Missions::Random) || self.imitation.adapts() {
            return match (self.missions, self.algorithm) {
                (_, None) => self.imitate(),
                (Some(Missions::Random), Some(Algorithm::Sac)) => self.reinforce(),
                (Some(Missions::Random), Some(Algorithm::Ddpg)) => Err(Failure::BadInput(anyhow!(
                    "--algorithm ddpg trains a policy for one mission: --missions random takes \
                     --algorithm sac, or none for imitation"
                ))),
                (None, Some(_)) => Err(Failure::BadInput(anyhow!(
                    "--from adapts a policy for any mission to one by imitation: --algorithm needs \
                     --missions random"
                ))),
            };
        }
        let method = |directory: &PathBuf| any_mission::method(&directory.join(CHECKPOINT));
        let continued = self.out.as_ref().filter(|_| self.resume).and_then(method);
        if self.imitation.has_duration() && continued.is_none() {
            return Err(Failure::BadInput(anyhow!(
                "--minutes and --steps are for --missions random and --from; otherwise --episodes says how long"
            )));
        }
        match (&self.out, continued) {
            (Some(directory), Some(method)) => {
                self.imitation.resume(method, directory, !self.quiet)
            }
            (Some(directory), None) if self.resume => {
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

    /// Starts an imitation.
    fn imitate(&self) -> Outcome {
        let prepare = || -> anyhow::Result<_> {
            let (mut settings, name) = match self.missions {
                Some(Missions::Random) => (ImitationSettings::default(), "any".to_owned()),
                None => {
                    let scenario = self.mission.load().map_err(Error::msg)?;
                    let name = format!("{}-adapted", scenario.name);
                    (ImitationSettings::adapting(&scenario), name)
                }
            };
            if let Some((path, table)) = self.settings_file()? {
                settings = overlay(&settings, table).with_context(|| path.display().to_string())?;
            }
            settings.seed = self.seed.unwrap_or(settings.seed);
            settings.learning_rate = self.learning_rate.unwrap_or(settings.learning_rate);
            let directory = self
                .out
                .clone()
                .unwrap_or_else(|| PathBuf::from("out").join(format!("{name}-{}", settings.seed)));
            self.check_directory(&directory)?;
            Ok((settings, directory))
        };
        let (settings, directory) = prepare().map_err(Failure::BadInput)?;
        self.imitation.start(settings, &directory, !self.quiet)
    }

    /// Starts a run of SAC for any mission.
    fn reinforce(&self) -> Outcome {
        let prepare = || -> anyhow::Result<_> {
            let mut settings = match self.imitation.improves() {
                true => ReinforcementSettings::improving(),
                false => ReinforcementSettings::from_new(),
            };
            if let Some((path, table)) = self.settings_file()? {
                settings = overlay(&settings, table).with_context(|| path.display().to_string())?;
            }
            let run = &mut settings.imitation;
            run.seed = self.seed.unwrap_or(run.seed);
            run.learning_rate = self.learning_rate.unwrap_or(run.learning_rate);
            let directory = self.out.clone();
            let directory = directory
                .unwrap_or_else(|| PathBuf::from("out").join(format!("any-sac-{}", run.seed)));
            self.check_directory(&directory)?;
            Ok((settings, directory))
        };
        let (settings, directory) = prepare().map_err(Failure::BadInput)?;
        self.imitation
            .start_reinforcement(settings, &directory, !self.quiet)
    }

    fn resume<L: Learner>(&self, scenario: Scenario, directory: &Path) -> Outcome {
        let training = Training::<L>::resume(scenario, directory.to_owned(), self.episodes);
        self.train(training.map_err(Failure::BadInput)?, directory)
    }

    /// Trains a new run, or one per seed. A run that fails does not keep the following seeds from
    /// being trained.
    fn start<L: Learner>(&self, settings: TrainingSettings) -> Outcome {
        let scenario = self.load_scenario(&settings).map_err(Failure::BadInput)?;
        let name = format!("{}-{}", scenario.name, settings.algorithm.name());
        let Some(seeds) = self.seeds else {
            let directory = self.out.clone().unwrap_or_else(|| {
                let seed = settings.seed;
                PathBuf::from("out").join(format!("{name}-{seed}"))
            });
            self.check_directory(&directory)
                .map_err(Failure::BadInput)?;
            return self.start_run::<L>(scenario, settings, &directory);
        };
        let parent = self.out.clone();
        let parent = parent.unwrap_or_else(|| PathBuf::from("out").join(name));
        let directory = |seed: u64| parent.join(format!("seed-{seed}"));
        for seed in seeds.all() {
            self.check_directory(&directory(seed))
                .map_err(Failure::BadInput)?;
        }
        let mut failed = Vec::new();
        for seed in seeds.all() {
            let settings = TrainingSettings {
                seed,
                ..settings.clone()
            };
            match self.start_run::<L>(scenario.clone(), settings, &directory(seed)) {
                Ok(()) => {}
                Err(Failure::Failed(error)) => failed.push(format!("seed {seed}: {error:#}")),
                Err(bad_input) => return Err(bad_input),
            }
        }
        match failed.is_empty() {
            true => Ok(()),
            false => Err(Failure::Failed(anyhow!(failed.join("; ")))),
        }
    }

    fn start_run<L: Learner>(
        &self,
        scenario: Scenario,
        settings: TrainingSettings,
        directory: &Path,
    ) -> Outcome {
        let training = Training::<L>::start(scenario, settings, directory.to_owned());
        self.train(training.map_err(Failure::BadInput)?, directory)
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

    /// Loads the scenario and checks that it permits the power allocation.
    fn load_scenario(&self, settings: &TrainingSettings) -> anyhow::Result<Scenario> {
        let scenario = self.mission.load().map_err(Error::msg)?;
        let allowed = settings.inner.check(&scenario.mission);
        allowed.map_err(Error::msg)?;
        Ok(scenario)
    }

    /// Checks that a directory does not contain a run, unless it may be replaced.
    fn check_directory(&self, directory: &Path) -> anyhow::Result<()> {
        ensure!(
            self.overwrite || !has_run(directory),
            "{} contains a run already: --resume continues it, --overwrite replaces it, --out selects \
             another directory",
            directory.display()
        );
        Ok(())
    }

    /// Reads the settings file, if one is given.
    fn settings_file(&self) -> anyhow::Result<Option<(&PathBuf, toml::Table)>> {
        let Some(path) = &self.settings else {
            return Ok(None);
        };
        let text = input::read_text(path).with_context(|| path.display().to_string())?;
        let table = text.parse::<toml::Table>();
        Ok(Some((
            path,
            table.with_context(|| path.display().to_string())?,
        )))
    }

    /// Returns the settings of the preset, overridden by those of the settings file, overridden by
    /// those of the command line.
    fn collect_settings(&self) -> anyhow::Result<TrainingSettings> {
        let file = self.settings_file()?;
        // Presets depend on the algorithm.
        let named = file.as_ref().and_then(|(_, table)| table.get("algorithm"));
        let named = named.and_then(|name| name.clone().try_into().ok());
        let algorithm = self.algorithm.or(named).unwrap_or(Algorithm::Sac);
        let mut settings = TrainingSettings::preset(self.preset, algorithm, 1);
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
