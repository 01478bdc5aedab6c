//! What learning costs, one thread: `cargo bench -p trainer --bench learning [-- WHAT [STEPS]]`.
//!
//! `sac` and `ddpg` are whole gradient steps (sampling, targets, critics, policy, temperatures,
//! target networks) at Table I's sizes: 19 states, 15 users, (128, 128), batch 64. `environment`
//! is slots at J = 36, M = 15 with a random choice. Prints how many a second, `WHAT NUMBER` a
//! line; with WHAT only that and from one round of STEPS, so that a script can take turns.

use std::{hint::black_box, time::Instant};

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;
use trainer::{
    ddpg::Ddpg,
    env::Environment,
    learner::{Choice, Learner},
    replay::{Replay, Transition},
    sac::Sac,
    settings::{Algorithm, Preset, Settings},
};

fn environment(settings: &Settings) -> Environment<f64> {
    let scenario = Scenario::shipped("separated").expect("shipped");
    Environment::new(scenario.mission, settings)
}

/// A memory of 200 episodes at random.
fn memory<L: Learner>(environment: &mut Environment<f64>, rng: &mut Pcg64Mcg) -> Replay {
    let sizes = environment.dimensions();
    let mut replay = Replay::new(12_000, sizes.observation, L::action_len(sizes.users));
    let mut choice = Choice::default();
    let (mut now, mut next) = (vec![0.0; sizes.observation], vec![0.0; sizes.observation]);
    for _ in 0..200 {
        environment.reset();
        environment.observe(&mut now);
        loop {
            let admissible = environment.admissible();
            L::choose_at_random(sizes.users, admissible, rng, &mut choice);
            let step = environment.step(&choice);
            environment.observe(&mut next);
            replay.push(Transition {
                observation: &now,
                action: &choice.action,
                user: choice.user as u8,
                reward: step.reward.total as f32,
                next_observation: &next,
                last: step.last,
                admissible,
                next_admissible: environment.admissible(),
                choice: [true; 2],
            });
            std::mem::swap(&mut now, &mut next);
            if step.last {
                break;
            }
        }
    }
    replay
}

/// So many a second, from a round of `steps` after a warm-up of a tenth.
fn rate(steps: u32, mut step: impl FnMut()) -> f64 {
    (0..steps / 10).for_each(|_| step());
    let start = Instant::now();
    (0..steps).for_each(|_| step());
    f64::from(steps) / start.elapsed().as_secs_f64()
}

/// Gradient steps.
fn learning<L: Learner + 'static>() -> Step {
    let settings = Settings::preset(Preset::Paper, L::ALGORITHM, 1);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut environment = environment(&settings);
    let replay = memory::<L>(&mut environment, &mut rng);
    let mut learner = L::new(&settings, environment.dimensions(), &mut rng);
    Box::new(move || learner.learn(black_box(&replay), &mut rng))
}

/// Slots of episodes at random.
fn flying() -> Step {
    let settings = Settings::preset(Preset::Paper, Algorithm::Sac, 1);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut environment = environment(&settings);
    let users = environment.dimensions().users;
    let mut choice = Choice::default();
    Box::new(move || {
        Sac::choose_at_random(users, environment.admissible(), &mut rng, &mut choice);
        if environment.step(black_box(&choice)).last {
            environment.reset();
        }
    })
}

/// One step of a contender, to be repeated.
type Step = Box<dyn FnMut()>;

/// A name, the steps of a round, and how it starts.
type Contender = (&'static str, u32, fn() -> Step);

/// Median of an odd number of rounds.
const ROUNDS: usize = 7;

fn main() {
    // Cargo adds `--bench`.
    let mut arguments = std::env::args().skip(1).filter(|a| !a.starts_with('-'));
    let only = arguments.next();
    let steps: Option<u32> = arguments.next().map(|text| text.parse().expect("STEPS"));
    let contenders: [Contender; 3] = [
        ("sac", 1_000, learning::<Sac>),
        ("ddpg", 1_000, learning::<Ddpg>),
        ("environment", 100_000, flying),
    ];
    for (name, usual, make) in contenders {
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
