//! Prints how many slots per second one thread flies with random actions in the default mission: one
//! episode after the other, and many in turns, as in a vector environment.
//!
//!     cargo run --release -p environment --features simd --example throughput

use std::time::{Duration, Instant};

use environment::{Action, Environment, EnvironmentSettings, EpisodeState};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;

/// How long a row is measured.
const DURATION: Duration = Duration::from_secs(1);
/// The numbers of episodes.
const BATCHES: [usize; 6] = [1, 16, 64, 256, 1024, 4096];
/// The number of different actions of an episode.
const ACTIONS: usize = 8;

fn main() {
    println!("| episodes in turns | slots/s |\n|--:|--:|");
    for batch in BATCHES {
        println!("| {batch} | {:.0} |", slots_per_second(batch));
    }
}

fn slots_per_second(batch: usize) -> f64 {
    let scenario = Scenario::shipped("separated").expect("a shipped scenario");
    let mut environment =
        Environment::new(scenario.mission.clone(), &EnvironmentSettings::default());
    let users = environment.dimensions().users;
    let mut observation = vec![0.0; environment.dimensions().observation];
    let mut states = vec![EpisodeState::start(&scenario.mission); batch];
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut actions = vec![Action::default(); ACTIONS];
    for action in &mut actions {
        action.randomize(2, users, environment.admissible(), &mut rng);
    }
    let (begun, mut slots) = (Instant::now(), 0);
    while begun.elapsed() < DURATION {
        for (index, state) in states.iter_mut().enumerate() {
            environment.swap_state(state);
            // As in a vector environment that is reset in the same step.
            if environment.step(&actions[(slots + index) % ACTIONS]).last {
                environment.reset();
            }
            environment.observe(&mut observation);
            environment.swap_state(state);
        }
        slots += batch;
    }
    slots as f64 / begun.elapsed().as_secs_f64()
}
