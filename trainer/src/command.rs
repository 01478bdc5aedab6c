//! The command line: reads arguments, calls the library, prints.

use std::{
    fs,
    io::{BufWriter, Write, stdout},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, Error, anyhow, ensure};
use clap::Args;
use firmware_core::{
    USERS_MAX,
    policy::{
        Policy, StraightLine,
        mlp::{self, Mlp},
    },
};
use host_sim::scenario::{Scenario, ScenarioChoice};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::Serialize;
use trainer::{
    card::{self, References},
    checkpoint::{self, Progress, write_atomically},
    ddpg::Ddpg,
    evaluate::{Flight, fly},
    learner::Learner,
    metrics::EVALUATION,
    onnx,
    sac::Sac,
    settings::{Algorithm, Constraints, Preset, Settings},
    training::{CHECKPOINT, POLICY, Training, has_run},
};

/// Why a command did not succeed.
#[derive(Debug)]
pub(crate) enum Failure {
    /// What was asked for cannot be: exit code 2.
    BadInput(anyhow::Error),
    /// It was tried and failed: exit code 1.
    Failed(anyhow::Error),
}

impl Failure {
    /// Prints one line and gives the exit code.
    pub(crate) fn report(self) -> ExitCode {
        let (problem, code) = match self {
            Self::BadInput(problem) => (problem, 2),
            Self::Failed(problem) => (problem, 1),
        };
        eprintln!("error: {problem:#}");
        ExitCode::from(code)
    }
}

type Outcome = Result<(), Failure>;

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
        let progress = training.run(!self.quiet).map_err(Failure::Failed)?;
        let best = progress.best.ok_or_else(|| {
            Failure::Failed(anyhow!(
                "no policy kept every constraint when it was evaluated; the latest is in {}",
                directory.join(CHECKPOINT).display()
            ))
        })?;
        println!(
            "{} episodes; best policy (episode {}): {:.3} bit/s/Hz in {} slots; {}",
            progress.episode,
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

#[derive(Debug, Args)]
pub(crate) struct Export {
    /// A run's checkpoint.bin
    checkpoint: PathBuf,
    /// The file to write
    #[arg(long, value_name = "FILE")]
    onnx: PathBuf,
    /// The latest policy instead of the best
    #[arg(long)]
    latest: bool,
}

impl Export {
    pub(crate) fn execute(self) -> Outcome {
        let progress = checkpoint::read_progress(&self.checkpoint).map_err(Failure::BadInput)?;
        let best = progress.best.filter(|_| !self.latest);
        let actor = best.map_or(progress.latest, |best| best.actor);
        let written = write_atomically(&self.onnx, &onnx::write(&actor));
        let written = written.with_context(|| self.onnx.display().to_string());
        written.map_err(Failure::Failed)
    }
}

#[derive(Debug, Args)]
pub(crate) struct Convert {
    /// The policy to read
    onnx: PathBuf,
    /// The file to write
    policy: PathBuf,
}

impl Convert {
    pub(crate) fn execute(self) -> Outcome {
        let actor = onnx::read::read(&self.onnx).map_err(Failure::BadInput)?;
        let file = actor.to_policy_file().map_err(Failure::BadInput)?;
        // What will be refused on board is not written.
        Mlp::load(&file[..]).map_err(|error| Failure::BadInput(error.into()))?;
        let written = write_atomically(&self.policy, &file);
        let written = written.with_context(|| self.policy.display().to_string());
        written.map_err(Failure::Failed)
    }
}

#[derive(Debug, Args)]
pub(crate) struct Evaluate {
    /// A .onnx or .policy file, or `straight-line`
    policy: PathBuf,
    #[command(flatten)]
    mission: ScenarioChoice,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Evaluate {
    pub(crate) fn execute(self) -> Outcome {
        let (scenario, mut policy) = self.load().map_err(Failure::BadInput)?;
        let flight = fly(&scenario.mission, &mut *policy).map_err(Failure::Failed)?;
        self.print(&flight).map_err(Failure::Failed)
    }

    fn load(&self) -> anyhow::Result<(Scenario, Box<dyn Policy<f64, USERS_MAX>>)> {
        let scenario = self.mission.load().map_err(Error::msg)?;
        if self.policy == Path::new("straight-line") {
            let policy = Box::new(StraightLine::new(&scenario.mission));
            return Ok((scenario, policy));
        }
        let file = if self.policy.extension().is_some_and(|e| e == "onnx") {
            onnx::read::read(&self.policy)?.to_policy_file()?
        } else {
            fs::read(&self.policy).with_context(|| self.policy.display().to_string())?
        };
        let policy: Mlp<Vec<u8>> = Mlp::load(file)
            .map_err(|error: mlp::LoadError| anyhow!("{}: {error}", self.policy.display()))?;
        let fits = policy.provenance().check(&scenario.mission);
        fits.with_context(|| self.policy.display().to_string())?;
        Ok((scenario, Box::new(policy)))
    }

    fn print(&self, flight: &Flight) -> anyhow::Result<()> {
        if self.json {
            println!("{}", serde_json::to_string_pretty(flight)?);
            return Ok(());
        }
        println!(
            "sum rate {:.3} bit/s/Hz; arrived {} ({:.1} m left); fair {}; MSE violations {}; \
             shield interventions {}",
            flight.sum_rate,
            flight.arrived,
            flight.arrival_distance_m,
            flight.fair,
            flight.mse_violations,
            flight.shield_interventions
        );
        Ok(())
    }
}

#[derive(Debug, Args)]
pub(crate) struct Probe {
    /// A .onnx file
    onnx: PathBuf,
    /// How many observations
    #[arg(long, default_value_t = 10_000)]
    count: usize,
    /// Where random numbers start
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Serialize)]
struct ProbeLine<'a> {
    observation: &'a [f32],
    displacement: &'a [f32],
    user_scores: &'a [f32],
}

impl Probe {
    pub(crate) fn execute(self) -> Outcome {
        let load = || -> anyhow::Result<_> {
            let actor = onnx::read::read(&self.onnx)?;
            let policy = Mlp::load(actor.to_policy_file()?)?;
            Ok((actor, policy))
        };
        let (actor, policy) = load().map_err(Failure::BadInput)?;
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed);
        let mut out = BufWriter::new(stdout().lock());
        for _ in 0..self.count {
            let observation = actor.random_observation(&mut rng);
            let outputs = policy.evaluate(&observation);
            let line = serde_json::to_string(&ProbeLine {
                observation: &observation,
                displacement: &outputs[..2],
                user_scores: &outputs[2..],
            });
            let line = line.map_err(|error| Failure::Failed(error.into()))?;
            writeln!(out, "{line}").map_err(|error| Failure::Failed(error.into()))?;
        }
        out.flush().map_err(|error| Failure::Failed(error.into()))
    }
}

#[derive(Debug, Args)]
pub(crate) struct Publish {
    /// A run's directory
    run: PathBuf,
    /// Stem of the files to write: STEM.onnx, STEM.md, STEM.svg
    #[arg(long)]
    stem: PathBuf,
    /// The command that made the run, for the card
    #[arg(long)]
    command: String,
    /// The search's total rate on this scenario, bit/s/Hz
    #[arg(long)]
    search: Option<f64>,
    /// Scenario file, or the name of a shipped one [default: the run's, if it is shipped]
    #[arg(long)]
    scenario: Option<PathBuf>,
}

impl Publish {
    pub(crate) fn execute(self) -> Outcome {
        let progress = checkpoint::read_progress(&self.run.join(CHECKPOINT));
        let progress = progress.map_err(Failure::BadInput)?;
        let files = self.files(&progress).map_err(Failure::BadInput)?;
        for (extension, bytes) in files {
            let path = self.stem.with_extension(extension);
            let written = write_atomically(&path, &bytes);
            let written = written.with_context(|| path.display().to_string());
            written.map_err(Failure::Failed)?;
        }
        Ok(())
    }

    fn files(&self, progress: &Progress) -> anyhow::Result<[(&'static str, Vec<u8>); 3]> {
        let best = progress
            .best
            .as_ref()
            .context("the run has no admissible policy")?;
        let named = self
            .scenario
            .clone()
            .unwrap_or_else(|| PathBuf::from(&progress.scenario));
        let scenario = Scenario::named(&named).map_err(Error::msg)?;
        ensure!(
            scenario.digest() == progress.scenario_digest,
            "{} is not the scenario of the run: their digests differ",
            named.display()
        );
        let references = References {
            straight_line: fly(&scenario.mission, StraightLine::new(&scenario.mission))?.sum_rate,
            search: self.search,
        };
        let name = self.stem.file_name().unwrap_or_default().to_string_lossy();
        let card = card::markdown(&name, &self.command, progress, best, references);
        let curve = card::learning_curve(&progress.rows, references);
        Ok([
            ("onnx", onnx::write(&best.actor)),
            ("md", card.into_bytes()),
            ("svg", curve.into_bytes()),
        ])
    }
}

#[derive(Debug, Args)]
pub(crate) struct Curves {
    /// Directories of runs
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// The CSV file to write
    #[arg(long)]
    out: PathBuf,
    /// Episodes that a row averages over
    #[arg(long, default_value_t = 40)]
    window: usize,
}

impl Curves {
    pub(crate) fn execute(self) -> Outcome {
        let text = self.text().map_err(Failure::BadInput)?;
        let written = write_atomically(&self.out, text.as_bytes());
        let written = written.with_context(|| self.out.display().to_string());
        written.map_err(Failure::Failed)
    }

    fn text(&self) -> anyhow::Result<String> {
        let mut text = String::from(
            "scenario,algorithm,learning_rate,seed,episode,episodic_return,sum_rate,eval_sum_rate\n",
        );
        for run in &self.runs {
            let progress = checkpoint::read_progress(&run.join(CHECKPOINT))?;
            let s = &progress.settings;
            for rows in progress.rows.chunks(self.window.max(1)) {
                let mean = |column: &str| {
                    let values: Vec<f64> = rows.iter().filter_map(|row| row.get(column)).collect();
                    values.iter().sum::<f64>() / values.len() as f64
                };
                text += &format!(
                    "{},{},{},{},{},{:.4},{:.4},{:.4}\n",
                    progress.scenario,
                    s.algorithm.name(),
                    s.policy_learning_rate,
                    s.seed,
                    rows[rows.len() - 1].episode,
                    mean("charts/episodic_return"),
                    mean("charts/sum_rate"),
                    mean(EVALUATION),
                );
            }
        }
        Ok(text)
    }
}
