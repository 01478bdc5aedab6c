//! What learning costs, one thread: `cargo bench -p trainer`.
//!
//! `sac/step` and `ddpg/step` are whole gradient steps (sampling, targets, critics, policy,
//! temperatures, target networks) at Table I's sizes: 19 states, 15 users, (128, 128), batch 64.
//! `environment/slot` is a slot at J = 36, M = 15 with a random choice.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use host_sim::scenario::Scenario;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
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
            });
            std::mem::swap(&mut now, &mut next);
            if step.last {
                break;
            }
        }
    }
    replay
}

fn step<L: Learner>(criterion: &mut Criterion, algorithm: Algorithm) {
    let settings = Settings::preset(Preset::Paper, algorithm, 1);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut environment = environment(&settings);
    let replay = memory::<L>(&mut environment, &mut rng);
    let mut learner = L::new(&settings, environment.dimensions(), &mut rng);
    let mut group = criterion.benchmark_group(algorithm.name());
    group.throughput(Throughput::Elements(1));
    group.bench_function("step", |bencher| {
        bencher.iter(|| learner.learn(black_box(&replay), &mut rng));
    });
}

fn slot(criterion: &mut Criterion) {
    let settings = Settings::preset(Preset::Paper, Algorithm::Sac, 1);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut environment = environment(&settings);
    let users = environment.dimensions().users;
    let mut choice = Choice::default();
    let mut group = criterion.benchmark_group("environment");
    group.throughput(Throughput::Elements(1));
    group.bench_function("slot", |bencher| {
        bencher.iter(|| {
            Sac::choose_at_random(users, environment.admissible(), &mut rng, &mut choice);
            if environment.step(black_box(&choice)).last {
                environment.reset();
            }
        });
    });
}

fn learning(criterion: &mut Criterion) {
    step::<Sac>(criterion, Algorithm::Sac);
    step::<Ddpg>(criterion, Algorithm::Ddpg);
    slot(criterion);
}

criterion_group!(benches, learning);
criterion_main!(benches);
