//! A run: start, resume, train, evaluate, save.
//!
//! The files are `settings.toml`, `metrics.csv`, TensorBoard events and `checkpoint.bin`, as of the
//! other runs ([`crate::run`]). In the metrics, `episode` is the number of missions learned from and
//! `global_step` the number of gradient steps. With a number of steps, the same seed gives the same
//! bytes on any number of threads; with a duration, the learning rate depends on the clock.

mod saved;

use std::{collections::VecDeque, path::PathBuf, sync::Arc, time::Instant};

use anyhow::{Context, Error, ensure};
use files::output;
use pulp::Arch;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use self::saved::{Best, Saved};
use super::{
    demonstration::Demonstration,
    demonstrations::Demonstrations,
    encoder::{Encoder, FEATURES},
    held_out::{Evaluation, HeldOut},
    loss,
    sample::{Labels, Sample},
    settings::ImitationSettings,
};
use crate::{
    metrics::{self, HELD_OUT, MetricsRow},
    nn::{
        Adam,
        sets::{BatchGradient, SetNetwork},
    },
    run::{self, CHECKPOINT, METRICS, SETTINGS},
    tensorboard::EventWriter,
};

pub use self::saved::{Summary, is_imitation};

/// The number of demonstrations that are asked for ahead of their use.
const AHEAD: usize = 8;
/// The number of steps between two copies of the network that fly missions.
const STEPS_PER_PILOT: u64 = 250;
/// One mission of so many is flown by the network.
const OWN_FLIGHTS: u64 = 2;

/// Threads of a run. Its results do not depend on them.
#[derive(Clone, Copy, Debug)]
pub struct Threads {
    /// That compute gradients.
    pub gradient: usize,
    /// That plan missions.
    pub planning: usize,
}

impl Default for Threads {
    fn default() -> Self {
        Self {
            gradient: 1,
            planning: 1,
        }
    }
}

/// A run in its directory.
#[derive(Debug)]
pub struct Imitation {
    settings: ImitationSettings,
    directory: PathBuf,
    arch: Arch,
    network: SetNetwork,
    adam: Adam,
    gradients: BatchGradient,
    rng: Pcg64Mcg,
    step: u64,
    /// The duration of earlier parts of the run, seconds.
    earlier_seconds: f64,
    started: Instant,
    demonstrations: Vec<Demonstration>,
    queue: Demonstrations,
    /// The copy of the network that flies missions.
    pilot: Option<Arc<SetNetwork>>,
    rows: Vec<MetricsRow>,
    best: Option<Best>,
    losses: Vec<f64>,
    losses_since: u64,
}

impl Imitation {
    /// Starts a run, which replaces an earlier one in its directory, from the parameters of another
    /// network if given.
    ///
    /// # Errors
    /// Fails if a setting is out of its range, the parameters do not fit, or the directory cannot
    /// be written.
    pub fn start(
        settings: ImitationSettings,
        from: Option<&[f32]>,
        directory: PathBuf,
        threads: Threads,
    ) -> anyhow::Result<Self> {
        settings.check().map_err(Error::msg)?;
        let mut network = SetNetwork::new(settings.architecture, FEATURES, settings.seed);
        if let Some(parameters) = from {
            let imported = network.import(parameters);
            imported.map_err(|expected| {
                let got = parameters.len();
                Error::msg(format!(
                    "the network has {got} parameters, but {expected} fit"
                ))
            })?;
        }
        std::fs::create_dir_all(&directory).with_context(|| directory.display().to_string())?;
        run::clear(&directory).with_context(|| directory.display().to_string())?;
        let mut run = Self {
            adam: Adam::new(network.layout().len),
            gradients: BatchGradient::new(&network, threads.gradient),
            rng: Pcg64Mcg::seed_from_u64(settings.seed),
            queue: Demonstrations::new(&settings, threads.planning, 0, VecDeque::new()),
            arch: Arch::new(),
            network,
            step: 0,
            earlier_seconds: 0.0,
            started: Instant::now(),
            demonstrations: Vec::new(),
            pilot: None,
            rows: Vec::new(),
            best: None,
            losses: Vec::new(),
            losses_since: 0,
            settings,
            directory,
        };
        run.save_settings()?;
        for _ in 0..run.settings.first_missions + AHEAD {
            run.queue.ask(None)?;
        }
        for _ in 0..run.settings.first_missions {
            let demonstration = run.queue.take()?;
            run.demonstrations.push(demonstration);
        }
        Ok(run)
    }

    /// Continues from the directory's checkpoint, up to another number of steps or duration if
    /// given.
    ///
    /// # Errors
    /// Fails if there is no valid checkpoint.
    pub fn resume(
        directory: PathBuf,
        steps: Option<u64>,
        minutes: Option<f64>,
        threads: Threads,
    ) -> anyhow::Result<Self> {
        let saved = Saved::read(&directory.join(CHECKPOINT))?;
        let mut settings = saved.settings;
        if steps.is_some() || minutes.is_some() {
            settings.steps = steps.unwrap_or(0);
            settings.minutes = minutes.unwrap_or(0.0);
        }
        settings.check().map_err(Error::msg)?;
        let load = |parameters: &[f32]| -> anyhow::Result<SetNetwork> {
            let mut network = SetNetwork::new(settings.architecture, FEATURES, settings.seed);
            let imported = network.import(parameters).ok();
            imported.context("the checkpoint's network has another size")?;
            Ok(network)
        };
        let network = load(&saved.parameters)?;
        let pilot = saved.pilot.as_deref().map(load).transpose()?;
        let restore = |saved| Demonstration::restored(&settings, saved);
        let demonstrations: anyhow::Result<Vec<_>> =
            saved.demonstrations.into_iter().map(restore).collect();
        let ready: anyhow::Result<VecDeque<_>> = saved.ready.into_iter().map(restore).collect();
        let run = Self {
            gradients: BatchGradient::new(&network, threads.gradient),
            queue: Demonstrations::new(&settings, threads.planning, saved.next, ready?),
            arch: Arch::new(),
            adam: saved.adam,
            rng: saved.rng,
            step: saved.step,
            earlier_seconds: saved.seconds,
            started: Instant::now(),
            demonstrations: demonstrations?,
            pilot: pilot.map(Arc::new),
            rows: saved.rows,
            best: saved.best,
            losses: saved.losses,
            losses_since: saved.losses_since,
            network,
            settings,
            directory,
        };
        run.save_settings()?;
        Ok(run)
    }

    /// Returns the network.
    pub fn network(&self) -> &SetNetwork {
        &self.network
    }

    /// Returns the number of gradient steps so far.
    pub fn steps(&self) -> u64 {
        self.step
    }

    /// Returns the rows of the metrics so far.
    pub fn rows(&self) -> &[MetricsRow] {
        &self.rows
    }

    /// Returns the duration of the run so far, seconds.
    fn seconds(&self) -> f64 {
        self.earlier_seconds + self.started.elapsed().as_secs_f64()
    }

    /// Returns how much of the run is done, 0 to 1.
    fn fraction(&self) -> f64 {
        match self.settings.steps {
            0 => self.seconds() / (60.0 * self.settings.minutes),
            steps => self.step as f64 / steps as f64,
        }
    }

    /// Trains until the run is complete, and returns the best evaluation's mean fraction.
    ///
    /// # Errors
    /// Fails if a loss is not finite or a file cannot be written.
    pub fn run(&mut self, show_progress: bool) -> anyhow::Result<Option<f64>> {
        let mut events = EventWriter::create(&self.directory)?;
        let held_out = match self.settings.scenario {
            Some(_) => HeldOut::of(self.settings.mission(0)?)?,
            None => HeldOut::new(
                self.settings.held_out_missions,
                &self.settings.left_out_layouts,
            )?,
        };
        let (first_step, started) = (self.step, Instant::now());
        loop {
            let fraction = self.fraction();
            if fraction < 1.0 {
                self.learn(fraction)?;
            }
            // The last step is always evaluated and saved, also if it is only due for a report.
            let over = self.fraction() >= 1.0;
            let due = |every: u64| over || self.step.is_multiple_of(every);
            if due(self.settings.report_every) && self.losses_since > 0 {
                let evaluate = due(self.settings.evaluate_every);
                let evaluation = match evaluate {
                    true => Some(held_out.evaluate(self.arch, &self.network)?),
                    false => None,
                };
                let steps = (self.step - first_step) as f64;
                let states = steps * self.settings.batch as f64;
                let speed = states / started.elapsed().as_secs_f64();
                self.report(evaluation, speed, show_progress, &mut events)?;
                if evaluate {
                    self.save()?;
                    events.flush()?;
                }
            }
            if over {
                return Ok(self.best.as_ref().map(|best| best.mean));
            }
        }
    }

    /// Takes new demonstrations and performs one gradient step.
    fn learn(&mut self, fraction: f64) -> anyhow::Result<()> {
        let settings = &self.settings;
        if self.step.is_multiple_of(settings.steps_per_mission) {
            let demonstration = self.queue.take()?;
            self.demonstrations.push(demonstration);
            let index = self.demonstrations.len() as u64;
            let own = index.is_multiple_of(OWN_FLIGHTS);
            self.queue.ask(self.pilot.clone().filter(|_| own))?;
        }
        let draw = |_| Sample::draw(&self.demonstrations, &mut self.rng);
        let samples: Vec<Sample> = (0..settings.batch).map(draw).collect();
        let demonstrations = &self.demonstrations;
        let (gradient, losses) = self.gradients.gradient(
            self.arch,
            &self.network,
            samples.len(),
            |range, batch| {
                let mut encoder = Encoder::default();
                let mut labels = Labels::default();
                for sample in &samples[range] {
                    sample.push(demonstrations, settings, &mut encoder, batch, &mut labels);
                }
                labels
            },
            loss::imitation,
        );
        let rate = settings.learning_rate_after(self.step, fraction);
        let norm = norm(gradient);
        ensure!(
            norm.is_finite() && losses.iter().all(|loss| loss.is_finite()),
            "step {}: the loss is not finite: {losses:?}",
            self.step
        );
        let scale = (settings.gradient_norm_max / norm).min(1.0);
        let scaled: Vec<f32> = gradient.iter().map(|g| g * scale).collect();
        self.network.update(|parameters| {
            self.adam.step(self.arch, rate, parameters, &scaled);
        });
        self.losses.resize(losses.len() + 1, 0.0);
        let reported = losses.into_iter().chain([f64::from(norm)]);
        for (sum, loss) in self.losses.iter_mut().zip(reported) {
            *sum += loss;
        }
        self.losses_since += 1;
        self.step += 1;
        if self.step >= settings.own_flights_from && self.step.is_multiple_of(STEPS_PER_PILOT) {
            self.pilot = Some(Arc::new(self.network.clone()));
        }
        Ok(())
    }

    /// Adds a row to the metrics, and keeps the network if it is the best so far.
    fn report(
        &mut self,
        evaluation: Option<Evaluation>,
        states_per_second: f64,
        show: bool,
        events: &mut EventWriter,
    ) -> anyhow::Result<()> {
        let names = loss::NAMES.into_iter().chain(["losses/gradient_norm"]);
        let count = self.losses_since as f64;
        let means = names.zip(self.losses.iter().map(|sum| sum / count));
        let mut values: Vec<(String, f64)> = means.map(|(n, x)| (n.to_owned(), x)).collect();
        if let Some(e) = evaluation {
            let [mean, low, worst] = HELD_OUT;
            let evaluated = [
                (mean, e.mean),
                (low, e.low),
                (worst, e.worst),
                ("charts/held_out_violated", e.violated as f64),
            ];
            values.extend(evaluated.map(|(name, x)| (name.to_owned(), x)));
            if e.violated == 0 && self.best.as_ref().is_none_or(|best| e.mean > best.mean) {
                self.best = Some(Best {
                    mean: e.mean,
                    step: self.step,
                    parameters: self.network.export(),
                });
            }
        }
        if show {
            let shown: Vec<String> = (values.iter())
                .map(|(name, x)| format!("{} {x:.4}", name.rsplit('/').next().unwrap_or(name)))
                .collect();
            eprintln!(
                "{:.1} min, step {}, {} missions, {states_per_second:.0} states/s: {}",
                self.seconds() / 60.0,
                self.step,
                self.demonstrations.len(),
                shown.join(", ")
            );
        }
        let scalars = values.iter().map(|(name, x)| (name.as_str(), *x as f32));
        let speed = [("charts/SPS", states_per_second as f32)];
        events.scalars(self.step, scalars.chain(speed))?;
        self.rows.push(MetricsRow {
            episode: self.demonstrations.len() as u32,
            global_step: self.step,
            values,
        });
        self.losses.fill(0.0);
        self.losses_since = 0;
        Ok(())
    }

    fn save_settings(&self) -> anyhow::Result<()> {
        let settings = toml::to_string(&self.settings)?;
        let path = self.directory.join(SETTINGS);
        output::write(&path, settings.as_bytes()).with_context(|| path.display().to_string())
    }

    /// Saves metrics and checkpoint. Waits for the demonstrations that have been asked for, so that the
    /// run continues with the same ones.
    fn save(&mut self) -> anyhow::Result<()> {
        metrics::write_csv(&self.directory.join(METRICS), &self.rows)?;
        let seconds = self.seconds();
        let (ready, next) = self.queue.settle()?;
        let state = |demonstration: &Demonstration| {
            let Demonstration { seed, weight, .. } = *demonstration;
            (seed, weight, demonstration.examples.clone())
        };
        let saved = Saved {
            settings: self.settings.clone(),
            step: self.step,
            seconds,
            parameters: self.network.export(),
            adam: self.adam.clone(),
            rng: self.rng.clone(),
            demonstrations: self.demonstrations.iter().map(state).collect(),
            ready: ready.iter().map(state).collect(),
            next,
            pilot: self.pilot.as_ref().map(|pilot| pilot.export()),
            rows: self.rows.clone(),
            best: self.best.clone(),
            losses: self.losses.clone(),
            losses_since: self.losses_since,
        };
        saved.write(&self.directory.join(CHECKPOINT))
    }
}

/// Returns the Euclidean norm, with a sum in double precision.
fn norm(gradient: &[f32]) -> f32 {
    let squares = gradient.iter().map(|&g| f64::from(g) * f64::from(g));
    squares.sum::<f64>().sqrt() as f32
}
