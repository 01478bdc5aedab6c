//! Training runs: start, resume, train, evaluate and save.
//!
//! [`crate::run`] describes the files that a run writes.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use anyhow::{Context, bail, ensure};
use environment::Environment;
use files::output;
use firmware_core::policy::mlp::Mlp;
use planning::bound;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;

use crate::{
    actor::Actor,
    checkpoint::{self, Checkpoint, Evaluated, TrainingProgress},
    evaluate::{Flight, fly},
    learner::Learner,
    metrics::{self, MetricsRow},
    onnx,
    progress_bar::{message, progress_bar},
    replay::Replay,
    rollout::{Divergence, Rollout},
    run::{self, CHECKPOINT, DIVERGED, METRICS, POLICY, SCENARIO, SETTINGS},
    settings::TrainingSettings,
    tensorboard::EventWriter,
};

/// A training run in its directory.
#[derive(Debug)]
pub struct Training<L: Learner> {
    progress: TrainingProgress,
    directory: PathBuf,
    scenario: Scenario,
    rollout: Rollout,
    learner: L,
    replay: Replay,
    stop: Option<Arc<AtomicBool>>,
}

impl<L: Learner> Training<L> {
    /// Starts a new run, which replaces the files of an earlier run in its directory.
    ///
    /// # Errors
    /// Fails if a setting is out of its range or if the directory cannot be written.
    pub fn start(
        scenario: Scenario,
        settings: TrainingSettings,
        directory: PathBuf,
    ) -> anyhow::Result<Self> {
        settings.check()?;
        ensure!(
            settings.algorithm == L::ALGORITHM,
            "algorithm is {}, but {} was asked for",
            settings.algorithm.name(),
            L::ALGORITHM.name()
        );
        let mut rng = Pcg64Mcg::seed_from_u64(settings.seed);
        let environment =
            Environment::new(scenario.mission.clone(), &settings.environment_settings());
        let dimensions = environment.dimensions();
        let learner = L::new(&settings, dimensions, &mut rng);
        let action_len = L::action_len(dimensions.users);
        let capacity = settings.buffer_capacity;
        let replay = Replay::new(capacity, dimensions.observation, action_len);
        let latest = Actor::new(learner.deterministic(), &scenario, &settings, 0);
        let prices = match settings.fairness_prices {
            true => bound::fairness_prices(&scenario.mission)
                .context("fairness_prices = true needs the bound's prices")?,
            false => Vec::new(),
        };
        let progress = TrainingProgress {
            prices,
            scenario: scenario.name.clone(),
            scenario_digest: scenario.digest(),
            episode: 0,
            global_step: 0,
            latest,
            best: None,
            rows: Vec::new(),
            rng,
            settings,
        };
        std::fs::create_dir_all(&directory).with_context(|| directory.display().to_string())?;
        run::clear(&directory).with_context(|| directory.display().to_string())?;
        output::write(&directory.join(SCENARIO), scenario.to_toml().as_bytes())?;
        let training = Self::assemble(progress, learner, replay, scenario, directory);
        training.save_settings()?;
        // From here on the directory contains a run that can be resumed.
        training.save()?;
        Ok(training)
    }

    /// Continues from the directory's checkpoint, up to `episodes` if given.
    ///
    /// # Errors
    /// Fails if there is no valid checkpoint or if it belongs to another scenario.
    pub fn resume(
        scenario: Scenario,
        directory: PathBuf,
        episodes: Option<u32>,
    ) -> anyhow::Result<Self> {
        let path = directory.join(CHECKPOINT);
        let saved = Checkpoint::<L::State>::read(&path, L::ALGORITHM)?;
        let mut progress = saved.progress;
        ensure!(
            progress.scenario_digest == scenario.digest(),
            "{}: the run is on scenario {} with digest {}, but {} has {}",
            path.display(),
            progress.scenario,
            progress.scenario_digest,
            scenario.name,
            scenario.digest()
        );
        progress.settings.episodes = episodes.unwrap_or(progress.settings.episodes);
        let environment_settings = progress.settings.environment_settings();
        let environment = Environment::new(scenario.mission.clone(), &environment_settings);
        let dimensions = environment.dimensions();
        let learner = L::resume(&progress.settings, dimensions, saved.learner);
        let training = Self::assemble(progress, learner, saved.replay, scenario, directory);
        training.save_settings()?;
        Ok(training)
    }

    fn assemble(
        progress: TrainingProgress,
        learner: L,
        replay: Replay,
        scenario: Scenario,
        directory: PathBuf,
    ) -> Self {
        let settings = &progress.settings;
        let mut environment =
            Environment::new(scenario.mission.clone(), &settings.environment_settings());
        if settings.fairness_prices {
            environment = environment.with_prices(&progress.prices);
        }
        if settings.value_shaping {
            let values = environment.value_to_go();
            environment = environment.with_values(Arc::new(values));
        }
        Self {
            rollout: Rollout::new(environment, settings.environments),
            progress,
            learner,
            replay,
            scenario,
            directory,
            stop: None,
        }
    }

    /// Ends the run after the episode in which this flag is set, with a checkpoint.
    pub fn stopped_by(mut self, flag: Arc<AtomicBool>) -> Self {
        self.stop = Some(flag);
        self
    }

    /// Returns whether the run was asked to end.
    fn is_stopped(&self) -> bool {
        let stop = self.stop.as_ref();
        stop.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// Returns the progress of the run.
    pub fn progress(&self) -> &TrainingProgress {
        &self.progress
    }

    /// Trains until the run is complete, or until it is [stopped](Self::stopped_by), and returns its
    /// progress, which contains the best policy.
    ///
    /// # Errors
    /// Fails if a loss diverges or if a file cannot be written.
    pub fn run(mut self, show_progress: bool) -> anyhow::Result<TrainingProgress> {
        let settings = self.progress.settings.clone();
        let mut events = EventWriter::create(&self.directory)?;
        let bar = progress_bar(&self.progress, show_progress);
        let (started, first_step) = (Instant::now(), self.progress.global_step);
        while self.progress.episode < settings.episodes {
            let flown =
                self.rollout
                    .fly_episodes(&mut self.learner, &mut self.replay, &mut self.progress);
            let losses = match flown {
                Ok(losses) => losses,
                Err(divergence) => return self.diverged(divergence),
            };
            let before = self.progress.episode;
            self.progress.episode += settings.environments as u32;
            let after = self.progress.episode;
            let over = after >= settings.episodes;
            let due = |every: u32| before / every != after / every || over;
            let mut evaluation = None;
            if due(settings.evaluate_every) {
                evaluation = Some(self.evaluate()?.sum_rate);
            }
            let elapsed = started.elapsed().as_secs_f64();
            let speed = (self.progress.global_step - first_step) as f64 / elapsed;
            let environments = self.rollout.environments();
            for (index, environment) in environments.iter().enumerate() {
                let last = index + 1 == environments.len();
                let row = MetricsRow::new(
                    before + index as u32 + 1,
                    self.progress.global_step,
                    environment.episode(),
                    &losses,
                    evaluation.filter(|_| last),
                );
                let scalars = row
                    .values
                    .iter()
                    .map(|(name, x)| (name.as_str(), *x as f32));
                let speed = [("charts/SPS", speed as f32)];
                events.scalars(row.global_step, scalars.chain(speed))?;
                self.progress.rows.push(row);
            }
            bar.set_position(after.into());
            bar.set_message(message(&self.progress, speed));
            let stopped = self.is_stopped();
            if due(settings.checkpoint_every) || stopped {
                self.save()?;
                events.flush()?;
            }
            if stopped {
                break;
            }
        }
        bar.finish();
        events.flush()?;
        Ok(self.progress)
    }

    /// Saves the batch on which a loss diverged and returns the error.
    fn diverged<T>(&self, Divergence { name, value }: Divergence) -> anyhow::Result<T> {
        let path = self.directory.join(DIVERGED);
        let batch = serde_json::to_vec_pretty(self.learner.batch())?;
        output::write(&path, &batch)?;
        bail!(
            "episode {}: {name} is {value}, beyond loss_limit {}; the batch is in {}",
            self.progress.episode + 1,
            self.progress.settings.loss_limit,
            path.display()
        )
    }

    /// Flies the deterministic policy, and saves it if it satisfies all constraints and is the best so
    /// far.
    fn evaluate(&mut self) -> anyhow::Result<Flight> {
        let progress = &mut self.progress;
        let (episode, settings) = (progress.episode, &progress.settings);
        let actor = Actor::new(
            self.learner.deterministic(),
            &self.scenario,
            settings,
            episode,
        );
        let policy = Mlp::load(actor.to_policy_file()?)?;
        let inner = settings.inner;
        let flight = fly(&self.scenario.mission, policy, inner)?;
        let best = progress.best.as_ref();
        let better = best.is_none_or(|best| flight.sum_rate > best.flight.sum_rate);
        if better && flight.is_admissible_under(inner) {
            progress.best = Some(Evaluated {
                episode,
                actor: actor.clone(),
                flight: flight.clone(),
            });
            let onnx = onnx::write(&actor);
            output::write(&self.directory.join(POLICY), &onnx)?;
        }
        progress.latest = actor;
        Ok(flight)
    }

    fn save_settings(&self) -> anyhow::Result<()> {
        let settings = toml::to_string(&self.progress.settings)?;
        let path = self.directory.join(SETTINGS);
        output::write(&path, settings.as_bytes()).with_context(|| path.display().to_string())
    }

    fn save(&self) -> anyhow::Result<()> {
        metrics::write_csv(&self.directory.join(METRICS), &self.progress.rows)?;
        let path = self.directory.join(CHECKPOINT);
        checkpoint::write(&path, &self.progress, self.learner.state(), &self.replay)
    }
}
