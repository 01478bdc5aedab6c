//! A run: start, resume, train, evaluate, save.
//!
//! The files are `settings.toml`, `metrics.csv`, TensorBoard events and `checkpoint.bin`, as of the
//! other runs ([`crate::run`]). In the metrics, `episode` is the number of missions learned from and
//! `global_step` the number of gradient steps. With a number of steps, the same seed gives the same
//! bytes on any number of threads; with a duration, the learning rate depends on the clock.

mod saved;

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, Error, ensure};
use pulp::Arch;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use self::saved::Saved;
use super::{
    demonstration::Demonstration,
    encoder::{Encoder, FEATURES},
    held_out::HeldOut,
    loss,
    mission_queue::MissionQueue,
    sample::{Labels, Sample},
    settings::{ImitationSettings, Schedule},
};
use crate::{
    metrics::MetricsRow,
    nn::{
        Adam,
        sets::{BatchGradient, SetNetwork},
    },
    record::{self, Learning, Progress, Record, Threads, norm, save_settings},
    run::{self, CHECKPOINT},
};

pub use self::saved::{MAGIC, Summary, read_network, read_summary};

/// The number of demonstrations that are asked for ahead of their use.
const AHEAD: usize = 8;
/// The number of steps between two copies of the network that fly missions.
const STEPS_PER_PILOT: u64 = 250;
/// One mission of so many is flown by the network.
const OWN_FLIGHTS: u64 = 2;

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
    record: Record,
    demonstrations: Vec<Demonstration>,
    queue: MissionQueue<Demonstration>,
    /// The copy of the network that flies missions.
    pilot: Option<Arc<SetNetwork>>,
}

/// Starts a queue of demonstrations.
fn queue(
    settings: &ImitationSettings,
    threads: usize,
    next: u64,
    ready: VecDeque<Demonstration>,
) -> MissionQueue<Demonstration> {
    let preparation = || {
        let mut prepare = Demonstration::preparation(settings);
        move |index: u64, network: Option<&SetNetwork>| {
            prepare(index, network).map(|(demonstration, _)| demonstration)
        }
    };
    MissionQueue::new(preparation, threads, next, ready)
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
            queue: queue(&settings, threads.planning, 0, VecDeque::new()),
            arch: Arch::new(),
            network,
            record: Record::new(Progress::default()),
            demonstrations: Vec::new(),
            pilot: None,
            settings,
            directory,
        };
        save_settings(&run.directory, &run.settings)?;
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
            queue: queue(&settings, threads.planning, saved.next, ready?),
            arch: Arch::new(),
            adam: saved.adam,
            rng: saved.rng,
            record: Record::new(Progress {
                step: saved.step,
                seconds: saved.seconds,
                rows: saved.rows,
                best: saved.best,
                losses: saved.losses,
                losses_since: saved.losses_since,
            }),
            demonstrations: demonstrations?,
            pilot: pilot.map(Arc::new),
            network,
            settings,
            directory,
        };
        save_settings(&run.directory, &run.settings)?;
        Ok(run)
    }

    /// Returns the network.
    pub fn network(&self) -> &SetNetwork {
        &self.network
    }

    /// Returns the number of gradient steps so far.
    pub fn steps(&self) -> u64 {
        self.record.step()
    }

    /// Returns the rows of the metrics so far.
    pub fn rows(&self) -> &[MetricsRow] {
        self.record.rows()
    }

    /// Trains until the run is complete, and returns the best evaluation's mean fraction.
    ///
    /// # Errors
    /// Fails if a loss is not finite or a file cannot be written.
    pub fn run(&mut self, show_progress: bool) -> anyhow::Result<Option<f64>> {
        let held_out = match self.settings.scenario {
            Some(_) => HeldOut::of(self.settings.mission(0)?)?,
            None => HeldOut::new(
                self.settings.held_out_missions,
                &self.settings.left_out_layouts,
            )?,
        };
        let arch = self.arch;
        record::run(self, &held_out, arch, show_progress)
    }
}

impl Learning for Imitation {
    const LOSSES: &'static [&'static str] = &[
        loss::NAMES[0],
        loss::NAMES[1],
        loss::NAMES[2],
        loss::NAMES[3],
        "losses/gradient_norm",
    ];

    fn schedule(&self) -> Schedule {
        self.settings.schedule()
    }

    fn directory(&self) -> &Path {
        &self.directory
    }

    fn record(&self) -> &Record {
        &self.record
    }

    fn record_mut(&mut self) -> &mut Record {
        &mut self.record
    }

    fn network(&self) -> &SetNetwork {
        &self.network
    }

    fn missions(&self) -> u64 {
        self.demonstrations.len() as u64
    }

    /// Takes new demonstrations and performs one gradient step.
    fn learn(&mut self, fraction: f64) -> anyhow::Result<()> {
        let settings = &self.settings;
        let step = self.record.step();
        if step.is_multiple_of(settings.steps_per_mission) {
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
        let rate = settings.learning_rate_after(step, fraction);
        let norm = norm(gradient);
        ensure!(
            norm.is_finite() && losses.iter().all(|loss| loss.is_finite()),
            "step {step}: the loss is not finite: {losses:?}"
        );
        let scale = (settings.gradient_norm_max / norm).min(1.0);
        let scaled: Vec<f32> = gradient.iter().map(|g| g * scale).collect();
        self.network.update(|parameters| {
            self.adam.step(self.arch, rate, parameters, &scaled);
        });
        let reported: Vec<f64> = losses.into_iter().chain([f64::from(norm)]).collect();
        self.record.note(reported.into_iter());
        let step = step + 1;
        if step >= settings.own_flights_from && step.is_multiple_of(STEPS_PER_PILOT) {
            self.pilot = Some(Arc::new(self.network.clone()));
        }
        Ok(())
    }

    /// Waits for the demonstrations that have been asked for, so that the
    /// run continues with the same ones.
    fn save(&mut self) -> anyhow::Result<()> {
        let progress = self.record.progress();
        let (ready, next) = self.queue.settle()?;
        let saved = Saved {
            settings: self.settings.clone(),
            step: progress.step,
            seconds: progress.seconds,
            parameters: self.network.export(),
            adam: self.adam.clone(),
            rng: self.rng.clone(),
            demonstrations: self
                .demonstrations
                .iter()
                .map(Demonstration::saved)
                .collect(),
            ready: ready.iter().map(Demonstration::saved).collect(),
            next,
            pilot: self.pilot.as_ref().map(|pilot| pilot.export()),
            rows: progress.rows,
            best: progress.best,
            losses: progress.losses,
            losses_since: progress.losses_since,
        };
        saved.write(&self.directory.join(CHECKPOINT))
    }
}
