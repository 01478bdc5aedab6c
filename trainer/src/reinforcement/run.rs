//! A run: start, resume, train, save. Evaluation and metrics are those of
//! [`record`](crate::record).
//!
//! The files are those of an imitation. In the metrics, `episode` is the number of missions flown and
//! `global_step` the number of gradient steps. With a number of steps, the same seed gives the same
//! bytes on any number of threads; with a duration, the learning rates depend on the clock.

pub mod saved;

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
    episode::{Episode, Pilot},
    learner::{Learner, MeanGradient, Sums},
    memory::Memory,
    networks::Networks,
    settings::ReinforcementSettings,
    task::Task,
};
use crate::{
    imitation::{
        demonstration::Demonstration,
        encoder::Encoder,
        held_out::HeldOut,
        loss,
        mission_queue::MissionQueue,
        sample::{Labels, Sample},
        settings::Schedule,
    },
    metrics::MetricsRow,
    nn::sets::{BatchGradient, SetNetwork},
    record::{self, Learning, Progress, Record, Threads, norm, save_settings},
    run::{self, CHECKPOINT},
};

/// The number of missions that are asked for ahead of their use.
const AHEAD: usize = 8;

/// A run in its directory.
#[derive(Debug)]
pub struct Reinforcement {
    settings: ReinforcementSettings,
    directory: PathBuf,
    arch: Arch,
    networks: Networks,
    learner: Learner,
    imitation: BatchGradient,
    rng: Pcg64Mcg,
    record: Record,
    memory: Memory,
    queue: MissionQueue<Task>,
    /// The fraction of the plan's total that the last mission was flown with.
    flown: f64,
}

impl Reinforcement {
    /// Starts a run, which replaces an earlier one in its directory, from the parameters of another
    /// network if given.
    ///
    /// # Errors
    /// Fails if a setting is out of its range, the parameters do not fit, or the directory cannot be
    /// written.
    pub fn start(
        settings: ReinforcementSettings,
        from: Option<&[f32]>,
        directory: PathBuf,
        threads: Threads,
    ) -> anyhow::Result<Self> {
        settings.check().map_err(Error::msg)?;
        let mut networks = Networks::new(&settings);
        if let Some(parameters) = from {
            let imported = networks.actor.network.import(parameters);
            imported.map_err(|expected| {
                let got = parameters.len();
                Error::msg(format!(
                    "the network has {got} parameters, but {expected} fit"
                ))
            })?;
        }
        std::fs::create_dir_all(&directory).with_context(|| directory.display().to_string())?;
        run::clear(&directory).with_context(|| directory.display().to_string())?;
        save_settings(&directory, &settings)?;
        let preparation = || Task::preparation(&settings.imitation);
        let arch = Arch::new();
        let mut run = Self {
            learner: Learner::new(&networks, arch, threads.gradient),
            imitation: BatchGradient::new(&networks.actor.network, threads.gradient),
            rng: Pcg64Mcg::seed_from_u64(settings.imitation.seed),
            record: Record::new(Progress::default()),
            memory: Memory::new(settings.memory_missions, Vec::new(), 0),
            queue: MissionQueue::new(preparation, threads.planning, 0, VecDeque::new()),
            flown: 0.0,
            arch,
            networks,
            settings,
            directory,
        };
        for _ in 0..run.settings.imitation.first_missions + AHEAD {
            run.ask()?;
        }
        for _ in 0..run.settings.imitation.first_missions {
            run.fly()?;
        }
        Ok(run)
    }

    /// Continues from the directory's checkpoint, up to another number of steps or duration if given.
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
            settings.imitation.steps = steps.unwrap_or(0);
            settings.imitation.minutes = minutes.unwrap_or(0.0);
        }
        settings.check().map_err(Error::msg)?;
        let networks = Networks::restored(&settings, saved.networks)?;
        let restore = |(saved, episode)| {
            let demonstration = Demonstration::restored(&settings.imitation, saved)?;
            anyhow::Ok((demonstration, episode))
        };
        let missions: anyhow::Result<Vec<_>> = saved.missions.into_iter().map(restore).collect();
        let ready = saved.ready.into_iter();
        let ready: anyhow::Result<VecDeque<_>> = ready
            .map(|task| Task::restored(&settings.imitation, task))
            .collect();
        let preparation = || Task::preparation(&settings.imitation);
        save_settings(&directory, &settings)?;
        let arch = Arch::new();
        Ok(Self {
            learner: Learner::new(&networks, arch, threads.gradient),
            imitation: BatchGradient::new(&networks.actor.network, threads.gradient),
            rng: saved.rng,
            record: Record::new(saved.progress),
            memory: Memory::new(settings.memory_missions, missions?, saved.added),
            queue: MissionQueue::new(preparation, threads.planning, saved.next, ready?),
            flown: saved.flown,
            arch,
            networks,
            settings,
            directory,
        })
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
        let settings = &self.settings.imitation;
        let held_out = match settings.scenario {
            Some(_) => HeldOut::of(settings.mission(0)?)?,
            None => HeldOut::new(settings.held_out_missions, &settings.left_out_layouts)?,
        };
        let arch = self.arch;
        record::run(self, &held_out, arch, show_progress)
    }

    /// Asks for a mission. Its demonstration is the actor's flight, corrected by the planner, if the
    /// loss of imitation is used.
    fn ask(&mut self) -> anyhow::Result<()> {
        let corrected = self.settings.imitation_weight > 0.0;
        let actor = &self.networks.actor.network;
        self.queue.ask(corrected.then(|| Arc::new(actor.clone())))
    }

    /// Takes a mission and flies it.
    fn fly(&mut self) -> anyhow::Result<()> {
        let task = self.queue.take()?;
        let pilot = match self.memory.added() < self.settings.random_missions {
            true => Pilot::Random,
            false => Pilot::Network(
                &self.networks.actor.network,
                self.networks.exploration.sigma(),
            ),
        };
        let episode = Episode::fly(&task, pilot, self.arch, &mut self.rng)?;
        self.flown = episode.fraction;
        self.memory.push(task.demonstration, episode);
        Ok(())
    }

    /// Adds the gradient of the loss of imitation to that of the actor, and returns its losses.
    fn imitate(&mut self, actor_gradient: &mut [f32]) -> Vec<f64> {
        let settings = &self.settings;
        let demonstrations = self.memory.demonstrations();
        let draw = |_| Sample::draw(demonstrations, &mut self.rng);
        let samples: Vec<Sample> = (0..settings.imitation_batch).map(draw).collect();
        let (gradient, losses) = self.imitation.gradient(
            self.arch,
            &self.networks.actor.network,
            samples.len(),
            |range, batch| {
                let mut encoder = Encoder::default();
                let mut labels = Labels::default();
                for sample in &samples[range] {
                    let settings = &settings.imitation;
                    sample.push(demonstrations, settings, &mut encoder, batch, &mut labels);
                }
                labels
            },
            loss::imitation,
        );
        for (sum, gradient) in actor_gradient.iter_mut().zip(gradient) {
            *sum += settings.imitation_weight * gradient;
        }
        losses
    }

    /// Takes a step of the critics, and returns the means of the transitions.
    fn learn_values(&mut self, rate: f32, count: usize) -> Sums {
        let fraction = self.settings.alternative_fraction;
        let draw = |_| self.memory.draw(fraction, &mut self.rng);
        let transitions: Vec<_> = (0..count).map(draw).collect();
        let (networks, memory) = (&self.networks, &self.memory);
        let MeanGradient {
            networks: gradients,
            means,
        } = self
            .learner
            .critics(&self.settings, networks, memory, &transitions);
        let longest = self.settings.critic_gradient_norm_max;
        for (critic, gradient) in self.networks.critics.iter_mut().zip(gradients) {
            critic.descend(self.arch, rate, longest, gradient);
        }
        means
    }

    /// Takes a step of the actor, sigma and the temperatures on the same transitions. Returns their
    /// means, the length of the actor's gradient, and the losses of imitation.
    fn learn_policy(&mut self, rate: f32, count: usize) -> (Sums, f32, Vec<f64>) {
        let MeanGradient {
            networks: mut gradients,
            means,
        } = self.learner.actor(&self.networks, count);
        let mut gradient = gradients.swap_remove(0).to_vec();
        let losses = match self.settings.imitation_weight > 0.0 {
            true => self.imitate(&mut gradient),
            false => vec![0.0; loss::NAMES.len()],
        };
        let (arch, settings) = (self.arch, &self.settings);
        let longest = settings.imitation.gradient_norm_max;
        let networks = &mut self.networks;
        let norm = match rate > 0.0 {
            true => networks.actor.descend(arch, rate, longest, &mut gradient),
            false => norm(&gradient),
        };
        let rate = settings.temperature_learning_rate;
        let alpha = networks.displacement_temperature.alpha();
        let by_log_sigma = -means.value_by_log_sigma as f32 - 2.0 * alpha;
        let surplus = networks.exploration.entropy() - settings.displacement_entropy;
        networks.exploration.descend(arch, rate, by_log_sigma);
        networks
            .displacement_temperature
            .descend(arch, rate, surplus);
        let target = f64::from(settings.user_entropy_fraction) * means.uniform_entropy;
        let surplus = (means.user_entropy - target) as f32;
        networks.user_temperature.descend(arch, rate, surplus);
        (means, norm, losses)
    }
}

impl Learning for Reinforcement {
    const LOSSES: &'static [&'static str] = &[
        "losses/qf1_loss",
        "losses/qf2_loss",
        "losses/qf_target",
        "losses/actor_loss",
        "losses/gradient_norm",
        "losses/sigma",
        "losses/alpha_displacement",
        "losses/alpha_user",
        "losses/entropy_user",
        loss::NAMES[0],
        loss::NAMES[1],
        loss::NAMES[2],
        "charts/flown_fraction",
    ];

    fn schedule(&self) -> Schedule {
        self.settings.imitation.schedule()
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
        &self.networks.actor.network
    }

    fn missions(&self) -> u64 {
        self.memory.added()
    }

    fn learn(&mut self, fraction: f64) -> anyhow::Result<()> {
        let step = self.record.step();
        let schedule = &self.settings.imitation;
        let count = schedule.batch;
        if step.is_multiple_of(schedule.steps_per_mission) {
            self.fly()?;
            self.ask()?;
        }
        let [actor_rate, critic_rate] = self.settings.learning_rates_after(step, fraction);
        let values = self.learn_values(critic_rate, count);
        let (policy, norm, imitation) = match step >= self.settings.actor_frozen_steps {
            true => self.learn_policy(actor_rate, count),
            false => (Sums::default(), 0.0, vec![0.0; loss::NAMES.len()]),
        };
        self.networks.soft_update(self.settings.tau);
        let [first, second] = values.critic_losses;
        let networks = &self.networks;
        let losses = [
            first,
            second,
            values.target,
            policy.actor_loss,
            norm.into(),
            networks.exploration.sigma().into(),
            networks.displacement_temperature.alpha().into(),
            networks.user_temperature.alpha().into(),
            policy.user_entropy,
        ];
        let losses: Vec<f64> = losses
            .into_iter()
            .chain(imitation)
            .chain([self.flown])
            .collect();
        ensure!(
            losses.iter().all(|loss| loss.is_finite()),
            "step {step}: a loss is not finite: {losses:?}"
        );
        self.record.note(losses.into_iter());
        Ok(())
    }

    /// Waits for the missions that have been asked for, so that the run continues with the same ones.
    fn save(&mut self) -> anyhow::Result<()> {
        let (ready, next) = self.queue.settle()?;
        let missions = self
            .memory
            .missions()
            .map(|(demonstration, episode)| (demonstration.saved(), episode.clone()));
        let saved = Saved {
            settings: self.settings.clone(),
            progress: self.record.progress(),
            networks: self.networks.saved(),
            rng: self.rng.clone(),
            missions: missions.collect(),
            added: self.memory.added(),
            ready: ready.iter().map(Task::saved).collect(),
            next,
            flown: self.flown,
        };
        saved.write(&self.directory.join(CHECKPOINT))
    }
}
