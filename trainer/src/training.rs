//! Runs that can be trusted: the loop around a [`Learner`].
//!
//! What it leaves in its directory: [`crate::run`].

use std::{path::PathBuf, sync::Arc, time::Instant};

use anyhow::{Context, bail, ensure};
use firmware_core::policy::{Provenance, mlp::Mlp};
use indicatif::{ProgressBar, ProgressStyle};
use planning::bound;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;

use crate::{
    actor::Actor,
    checkpoint::{self, Checkpoint, Evaluated, Progress, write_atomically},
    env::{Environment, Normalizer, Outlook},
    evaluate::{Flight, fly},
    learner::{Choice, Dimensions, Learner, States},
    metrics::{self, LossMeans, Row},
    nn::padded,
    onnx,
    relaxation::ValueToGo,
    replay::{Replay, Transition, UserSet, scatter},
    run::{self, CHECKPOINT, DIVERGED, METRICS, POLICY, SCENARIO, SETTINGS},
    settings::Settings,
    tensorboard::EventWriter,
};

/// Episodes over which the progress bar averages.
const RECENT: usize = 100;

/// A run in its directory.
#[derive(Debug)]
pub struct Training<L: Learner> {
    progress: Progress,
    directory: PathBuf,
    scenario: Scenario,
    environments: Vec<Environment<f64>>,
    learner: L,
    replay: Replay,
    states: States,
    choices: Vec<Choice>,
    /// `s_n` and `s_{n+1}` of every environment.
    observations: [Vec<Vec<f32>>; 2],
}

impl<L: Learner> Training<L> {
    /// A fresh run.
    ///
    /// # Errors
    /// Settings that make no sense, a directory that cannot be written.
    pub fn start(
        scenario: Scenario,
        settings: Settings,
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
        let environment = Environment::new(scenario.mission.clone(), &settings);
        let dimensions = environment.dimensions();
        let learner = L::new(&settings, dimensions, &mut rng);
        let action_len = L::action_len(dimensions.users);
        let capacity = settings.buffer_capacity;
        let replay = Replay::new(capacity, dimensions.observation, action_len);
        let latest = actor_of(&learner, &scenario, &settings, 0);
        let prices = match settings.fairness_prices {
            true => bound::fairness_prices(&scenario.mission)
                .context("fairness_prices = true needs the bound's prices")?,
            false => Vec::new(),
        };
        let progress = Progress {
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
        write_atomically(&directory.join(SCENARIO), scenario.to_toml().as_bytes())?;
        let training = Self::assemble(progress, learner, replay, scenario, directory);
        training.save_settings()?;
        // From here on the directory holds a run, and can be gone on with.
        training.save()?;
        Ok(training)
    }

    /// Goes on from the directory's checkpoint, up to `episodes` if given.
    ///
    /// # Errors
    /// No sound checkpoint, or one of another scenario.
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
        let dimensions =
            Environment::new(scenario.mission.clone(), &progress.settings).dimensions();
        let learner = L::resume(&progress.settings, dimensions, saved.learner);
        let training = Self::assemble(progress, learner, saved.replay, scenario, directory);
        training.save_settings()?;
        Ok(training)
    }

    fn assemble(
        progress: Progress,
        learner: L,
        replay: Replay,
        scenario: Scenario,
        directory: PathBuf,
    ) -> Self {
        let settings = &progress.settings;
        let n = settings.environments;
        let mut environment = Environment::new(scenario.mission.clone(), settings);
        if settings.fairness_prices {
            environment = environment.with_prices(&progress.prices);
        }
        if settings.value_shaping {
            let values = ValueToGo::new(&environment);
            environment = environment.with_values(Arc::new(values));
        }
        let Dimensions { observation, .. } = environment.dimensions();
        let rows = || vec![vec![0.0; observation]; n];
        Self {
            environments: vec![environment; n],
            states: States {
                len: n,
                width: padded(n),
                observation: vec![0.0; observation * padded(n)],
                admissible: vec![u64::MAX; padded(n)],
            },
            choices: vec![Choice::default(); n],
            observations: [rows(), rows()],
            progress,
            learner,
            replay,
            scenario,
            directory,
        }
    }

    /// Where it stands.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Trains to the end and returns the best policy.
    ///
    /// # Errors
    /// A diverged loss, a file that cannot be written.
    pub fn run(mut self, show_progress: bool) -> anyhow::Result<Progress> {
        let settings = self.progress.settings.clone();
        let mut events = EventWriter::create(&self.directory)?;
        let bar = progress_bar(&self.progress, show_progress);
        let (started, first_step) = (Instant::now(), self.progress.global_step);
        while self.progress.episode < settings.episodes {
            let losses = self.fly_episodes()?;
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
            for (index, environment) in self.environments.iter().enumerate() {
                let last = index + 1 == self.environments.len();
                let row = Row::new(
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
            bar.set_message(self.describe(speed));
            if due(settings.checkpoint_every) {
                self.save()?;
                events.flush()?;
            }
        }
        bar.finish();
        events.flush()?;
        Ok(self.progress)
    }

    /// Alg. 2's inner loop: one episode in every environment, a gradient step per slot.
    fn fly_episodes(&mut self) -> anyhow::Result<LossMeans> {
        let settings = self.progress.settings.clone();
        let users = self.scenario.mission.user_count();
        let mut losses = LossMeans::default();
        let [now, next] = &mut self.observations;
        for (environment, state) in self.environments.iter_mut().zip(now.iter_mut()) {
            environment.reset();
            environment.observe(state);
        }
        for _ in 0..self.scenario.mission.slots() {
            let rng = &mut self.progress.rng;
            let states = &mut self.states;
            for (s, environment) in self.environments.iter().enumerate() {
                scatter(&now[s], &mut states.observation, states.width, s);
                states.admissible[s] = environment.admissible();
            }
            if self.progress.global_step < settings.warmup_slots {
                for (s, choice) in self.choices.iter_mut().enumerate() {
                    L::choose_at_random(users, states.admissible[s], rng, choice);
                }
            } else {
                self.learner.explore(states, rng, &mut self.choices);
            }
            for (s, environment) in self.environments.iter_mut().enumerate() {
                let (admissible, has_choice) = (states.admissible[s], environment.has_choice());
                let replay = &mut self.replay;
                let mut remember = |choice: &Choice, next: &[f32], outlook: Outlook| {
                    replay.push(Transition {
                        observation: &now[s],
                        action: &choice.action,
                        user: choice.user as u8,
                        reward: outlook.step.reward.total as f32,
                        next_observation: next,
                        last: outlook.step.last,
                        admissible,
                        next_admissible: outlook.admissible,
                        choice: [has_choice, outlook.has_choice],
                    });
                };
                let choice = &self.choices[s];
                let mut others = admissible & !(1 << choice.user);
                for _ in 0..settings.alternative_users {
                    let Some(user) = take_one(&mut others, rng) else {
                        break;
                    };
                    let action = choice.action.clone();
                    let other = Choice { action, user };
                    let outlook = environment.foresee(&other, &mut next[s]);
                    remember(&other, &next[s], outlook);
                }
                let outlook = environment.advance(choice, &mut next[s]);
                remember(choice, &next[s], outlook);
                self.progress.global_step += 1;
            }
            std::mem::swap(now, next);
            if self.progress.global_step > settings.warmup_slots {
                let steps = settings.gradient_steps_per_slot as usize * settings.environments;
                for _ in 0..steps {
                    self.learner.learn(&self.replay, rng);
                    let report = self.learner.losses();
                    losses.add(report);
                    let limit = settings.loss_limit;
                    let fault = report.iter().find(|(_, x)| x.is_nan() || x.abs() > limit);
                    if let Some(&(name, value)) = fault {
                        return self.diverged(name, value);
                    }
                }
            }
        }
        Ok(losses)
    }

    fn diverged<T>(&self, name: &str, value: f32) -> anyhow::Result<T> {
        let path = self.directory.join(DIVERGED);
        let batch = serde_json::to_vec_pretty(self.learner.batch())?;
        write_atomically(&path, &batch)?;
        bail!(
            "episode {}: {name} is {value}, beyond loss_limit {}; the batch is in {}",
            self.progress.episode + 1,
            self.progress.settings.loss_limit,
            path.display()
        )
    }

    /// Flies the deterministic policy; keeps it if it is the best that keeps all constraints.
    fn evaluate(&mut self) -> anyhow::Result<Flight> {
        let progress = &mut self.progress;
        let (episode, settings) = (progress.episode, &progress.settings);
        let actor = actor_of(&self.learner, &self.scenario, settings, episode);
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
            write_atomically(&self.directory.join(POLICY), &onnx)?;
        }
        progress.latest = actor;
        Ok(flight)
    }

    fn save_settings(&self) -> anyhow::Result<()> {
        let settings = toml::to_string(&self.progress.settings)?;
        let path = self.directory.join(SETTINGS);
        write_atomically(&path, settings.as_bytes()).with_context(|| path.display().to_string())
    }

    fn save(&self) -> anyhow::Result<()> {
        metrics::write_csv(&self.directory.join(METRICS), &self.progress.rows)?;
        let path = self.directory.join(CHECKPOINT);
        checkpoint::write(&path, &self.progress, self.learner.state(), &self.replay)
    }

    fn describe(&self, slots_per_second: f64) -> String {
        let rows = &self.progress.rows;
        let recent = &rows[rows.len().saturating_sub(RECENT)..];
        let mean = |column: &str| {
            let sum: f64 = recent.iter().filter_map(|row| row.get(column)).sum();
            sum / recent.len() as f64
        };
        let best = self.progress.best.as_ref();
        let best = best.map_or("none".into(), |best| format!("{:.2}", best.flight.sum_rate));
        format!(
            "return {:.2}, rate {:.2}, arrived {:.0}%, best {best}, {slots_per_second:.0} slots/s",
            mean("charts/episodic_return"),
            mean("charts/sum_rate"),
            100.0 * mean("charts/arrived"),
        )
    }
}

/// Takes one of a set out of it, each as likely as any other.
fn take_one(set: &mut UserSet, rng: &mut Pcg64Mcg) -> Option<usize> {
    let count = set.count_ones();
    if count == 0 {
        return None;
    }
    let mut rest = *set;
    for _ in 0..rng.random_range(0..count) {
        rest &= rest - 1;
    }
    let user = rest.trailing_zeros() as usize;
    *set &= !(1 << user);
    Some(user)
}

/// A learner's deterministic policy with all that its files carry.
pub fn actor_of<L: Learner>(
    learner: &L,
    scenario: &Scenario,
    settings: &Settings,
    episode: u32,
) -> Actor {
    let mission = &scenario.mission;
    let p = mission.parameters();
    Actor {
        provenance: Provenance {
            users: mission.user_count() as u32,
            max_speed_mps: p.max_speed_mps as f32,
            slot_duration_s: p.slot_duration_s as f32,
            area_m: [p.area.east_m as f32, p.area.north_m as f32],
            algorithm: short(settings.algorithm.name()),
            scenario: short(&scenario.name),
            scenario_digest: short(&scenario.digest()),
            episodes: episode,
            seed: settings.seed,
        },
        normalizer: Normalizer::of_mission(mission),
        layers: learner.deterministic(),
        reach_m: mission.reach_m() as f32,
    }
}

/// As much of a text as fits.
fn short<const N: usize>(text: &str) -> heapless::String<N> {
    let mut short = heapless::String::new();
    for c in text.chars() {
        if short.push(c).is_err() {
            break;
        }
    }
    short
}

fn progress_bar(progress: &Progress, shown: bool) -> ProgressBar {
    if !shown {
        return ProgressBar::hidden();
    }
    let template = "{bar:30} episode {pos}/{len} [{elapsed}, {eta} left] {msg}";
    let style = ProgressStyle::with_template(template);
    let bar = ProgressBar::new(progress.settings.episodes.into());
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_position(progress.episode.into());
    bar
}
