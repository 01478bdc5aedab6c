//! Prints a digest of each of many random episodes, for comparisons with other programs that step
//! the same environment (`python/tests/test_same_numbers.py`).
//!
//! Episode `e` flies the mission that `scenario::random` draws with seed `e mod 50`. The action of
//! each slot are `2 + M` numbers in `[-1, 1)`, two of displacement and a score per user, from the
//! SplitMix64 generator whose state starts at `e`. A line has the SHA-256 of all observations (f32),
//! rewards, rates and MSEs (f64), little endian, in the order in which they occur.
//!
//!     cargo run --release -p environment --example trajectory -- EPISODES

use environment::{Action, Environment, EnvironmentSettings};
use sha2::{Digest, Sha256};

/// The number of missions.
const MISSIONS: u64 = 50;

/// SplitMix64 (Steele, Lea and Flood, 2014).
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a multiple of 2^-23 in `[-1, 1)`.
    fn number(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

fn main() {
    let episodes = std::env::args().nth(1);
    let episodes: u64 = episodes.map_or(1000, |text| text.parse().expect("a number of episodes"));
    let environments = (0..MISSIONS).map(|seed| {
        let scenario = scenario::random(seed, None).expect("a mission");
        Environment::new(scenario.mission, &EnvironmentSettings::default())
    });
    let mut environments: Vec<Environment<f64>> = environments.collect();
    for episode in 0..episodes {
        let environment = &mut environments[(episode % MISSIONS) as usize];
        println!("{}", digest(environment, SplitMix(episode)));
    }
}

fn digest(environment: &mut Environment<f64>, mut random: SplitMix) -> String {
    let sizes = environment.dimensions();
    let mut observation = vec![0.0_f32; sizes.observation];
    let mut hash = Sha256::new();
    environment.reset();
    environment.observe(&mut observation);
    update(&mut hash, &observation);
    loop {
        let components = vec![random.number(), random.number()];
        let scores: Vec<f32> = (0..sizes.users).map(|_| random.number()).collect();
        let (user, _) = environment.choose_user(&scores);
        let step = environment.step(&Action { components, user });
        environment.observe(&mut observation);
        update(&mut hash, &observation);
        for number in [step.reward.total, step.rate, step.mse] {
            hash.update(number.to_le_bytes());
        }
        if step.last {
            let bytes = hash.finalize();
            return bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        }
    }
}

fn update(hash: &mut Sha256, numbers: &[f32]) {
    for number in numbers {
        hash.update(number.to_le_bytes());
    }
}
