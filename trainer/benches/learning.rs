//! Speed of learning on one thread: `cargo bench -p trainer --bench learning [-- WHAT [STEPS]]`.
//!
//! `sac` and `ddpg` are whole gradient steps (sampling, targets, critics, policy, temperatures,
//! target networks) at Table I's sizes. `environment` is slots of the shipped mission `separated` with
//! random actions. `sets` is the gradient of 256 states of the network for any mission, from planned
//! missions to the sum, and `sets-inputs` the part of it that computes the inputs. `sets-sac` is a gradient
//! step of 128 transitions of SAC for any mission (both critics, then the actor), and `sets-task` the
//! preparation of a mission for it. Prints one line `WHAT NUMBER` with the number per second for each. With WHAT it
//! measures only that one, in one round of STEPS, so that a script can alternate between programs.

use std::{hint::black_box, ops::Range, time::Instant};

use environment::{Action, Environment};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;
use trainer::{
    ddpg::Ddpg,
    imitation::{
        demonstration::Demonstration,
        encoder::{Encoder, FEATURES},
        loss,
        sample::{Labels, Sample},
        settings::ImitationSettings,
    },
    learner::Learner,
    nn::sets::{BatchGradient, SetBatch, SetNetwork},
    reinforcement::{
        self,
        episode::{Episode, Pilot},
        memory::Memory,
        networks::Networks,
        settings::ReinforcementSettings,
        task::Task,
    },
    replay::{Replay, Transition},
    sac::Sac,
    settings::{Algorithm, Preset, TrainingSettings},
};

fn environment(settings: &TrainingSettings) -> Environment<f64> {
    let scenario = Scenario::shipped("separated").expect("shipped");
    Environment::new(scenario.mission, &settings.environment_settings())
}

/// Returns a replay memory with 200 random episodes.
fn memory<L: Learner>(environment: &mut Environment<f64>, rng: &mut Pcg64Mcg) -> Replay {
    let sizes = environment.dimensions();
    let mut replay = Replay::new(12_000, sizes.observation, L::action_len(sizes.users));
    let mut action = Action::default();
    let (mut now, mut next) = (vec![0.0; sizes.observation], vec![0.0; sizes.observation]);
    for _ in 0..200 {
        environment.reset();
        environment.observe(&mut now);
        loop {
            let admissible = environment.admissible();
            L::randomize(sizes.users, admissible, rng, &mut action);
            let step = environment.step(&action);
            environment.observe(&mut next);
            replay.push(Transition {
                observation: &now,
                action: &action.components,
                user: action.user as u8,
                reward: step.reward.total as f32,
                next_observation: &next,
                last: step.last,
                admissible,
                next_admissible: environment.admissible(),
                entropy_mask: [true; 2],
            });
            std::mem::swap(&mut now, &mut next);
            if step.last {
                break;
            }
        }
    }
    replay
}

/// Measures steps per second over one round of `steps`, after a warm-up of a tenth of them.
fn rate(steps: u32, mut step: impl FnMut()) -> f64 {
    (0..steps / 10).for_each(|_| step());
    let start = Instant::now();
    (0..steps).for_each(|_| step());
    f64::from(steps) / start.elapsed().as_secs_f64()
}

/// Returns a gradient step to be measured.
fn learning<L: Learner + 'static>() -> Step {
    let settings = TrainingSettings::preset(Preset::Paper, L::ALGORITHM, 1);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut environment = environment(&settings);
    let replay = memory::<L>(&mut environment, &mut rng);
    let mut learner = L::new(&settings, environment.dimensions(), &mut rng);
    Box::new(move || learner.learn(black_box(&replay), &mut rng))
}

/// Returns a slot with a random action to be measured.
fn flying() -> Step {
    let settings = TrainingSettings::preset(Preset::Paper, Algorithm::Sac, 1);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut environment = environment(&settings);
    let users = environment.dimensions().users;
    let mut action = Action::default();
    Box::new(move || {
        Sac::randomize(users, environment.admissible(), &mut rng, &mut action);
        if environment.step(black_box(&action)).last {
            environment.reset();
        }
    })
}

/// Number of states of a gradient step of the network for any mission.
const STATES: usize = 256;

/// Returns planned missions, the settings they were planned with, and samples of them.
fn demonstrations() -> (ImitationSettings, Vec<Demonstration>, Vec<Sample>) {
    let settings = ImitationSettings::default();
    let demonstrations: Vec<Demonstration> = (0..8)
        .map(|index| Demonstration::new(&settings, index, None, None).expect("a mission"))
        .collect();
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let samples = (0..STATES).map(|_| Sample::draw(&demonstrations, &mut rng));
    let samples = samples.collect();
    (settings, demonstrations, samples)
}

/// Returns the gradient of the network for any mission to be measured.
fn sets() -> Step {
    let (settings, demonstrations, samples) = demonstrations();
    let network = SetNetwork::new(settings.architecture, FEATURES, 1);
    let mut gradients = BatchGradient::new(&network, 1);
    Box::new(move || {
        let fill = |range: Range<usize>, batch: &mut SetBatch| {
            let (mut encoder, mut labels) = (Encoder::default(), Labels::default());
            for sample in &samples[range] {
                sample.push(&demonstrations, &settings, &mut encoder, batch, &mut labels);
            }
            labels
        };
        let arch = pulp::Arch::new();
        black_box(gradients.gradient(arch, &network, STATES, fill, loss::imitation));
    })
}

/// Returns the inputs of a batch to be measured.
fn sets_inputs() -> Step {
    let (settings, demonstrations, samples) = demonstrations();
    let mut batch = SetBatch::new(FEATURES);
    Box::new(move || {
        let (mut encoder, mut labels) = (Encoder::default(), Labels::default());
        batch.clear();
        for sample in &samples {
            sample.push(
                &demonstrations,
                &settings,
                &mut encoder,
                &mut batch,
                &mut labels,
            );
        }
        black_box(&labels);
    })
}

/// Returns the gradients of a step of SAC for any mission to be measured.
fn sets_sac() -> Step {
    let settings = ReinforcementSettings::improving();
    let networks = Networks::new(&settings);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut memory = Memory::new(8, Vec::new(), 0);
    let mut prepare = Task::preparation(&settings.imitation);
    let arch = pulp::Arch::new();
    for index in 0..8 {
        let task = prepare(index, None).expect("a mission");
        let episode = Episode::fly(&task, Pilot::Random, arch, &mut rng).expect("flies");
        memory.push(task.demonstration, episode);
    }
    let mut learner = reinforcement::learner::Learner::new(&networks, arch, 1);
    let count = settings.imitation.batch;
    let draw = |_| memory.draw(settings.alternative_fraction, &mut rng);
    let transitions: Vec<_> = (0..count).map(draw).collect();
    Box::new(move || {
        black_box(learner.critics(&settings, &networks, &memory, &transitions));
        black_box(learner.actor(&networks, count));
    })
}

/// Returns the preparation of missions for SAC to be measured.
fn sets_task() -> Step {
    let settings = ReinforcementSettings::improving();
    let mut prepare = Task::preparation(&settings.imitation);
    let mut index = 0;
    Box::new(move || {
        index += 1;
        black_box(prepare(index, None).expect("a mission"));
    })
}

/// One step of a measured program.
type Step = Box<dyn FnMut()>;

/// A name, the number of steps in a round, and the constructor of its step.
type Measured = (&'static str, u32, fn() -> Step);

/// Number of rounds, of which the median is printed.
const ROUNDS: usize = 7;

fn main() {
    // Cargo adds `--bench`.
    let mut arguments = std::env::args().skip(1).filter(|a| !a.starts_with('-'));
    let only = arguments.next();
    let steps: Option<u32> = arguments.next().map(|text| text.parse().expect("STEPS"));
    let measured: [Measured; 7] = [
        ("sac", 1_000, learning::<Sac>),
        ("ddpg", 1_000, learning::<Ddpg>),
        ("environment", 100_000, flying),
        ("sets", 20, sets),
        ("sets-inputs", 60, sets_inputs),
        ("sets-sac", 10, sets_sac),
        ("sets-task", 20, sets_task),
    ];
    for (name, usual, make) in measured {
        if only.as_deref().is_some_and(|only| only != name) {
            continue;
        }
        let mut step = make();
        let rounds = if only.is_some() { 1 } else { ROUNDS };
        let mut rates: Vec<f64> = (0..rounds)
            .map(|_| rate(steps.unwrap_or(usual), &mut step))
            .collect();
        rates.sort_by(f64::total_cmp);
        println!("{name} {:.1}", rates[rounds / 2]);
    }
}
