//! Test fixtures of both learners.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use environment::Dimensions;

use crate::{
    learner::Learner,
    nn::Mlp,
    replay::{Replay, Transition},
    settings::{Preset, TrainingSettings},
};

pub(crate) const DIMENSIONS: Dimensions = Dimensions {
    users: 4,
    observation: 8,
};

/// A batch size that is not a multiple of any vector length.
pub(crate) const BATCH: usize = 21;

/// Returns a small learner and a memory of 300 random transitions, of which some end an episode and
/// some exclude users.
pub(crate) fn filled<L: Learner>() -> (L, Replay, Pcg64Mcg) {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut settings = TrainingSettings::preset(Preset::Paper, L::ALGORITHM, 7);
    (settings.batch, settings.hidden) = (BATCH, 24);
    let learner = L::new(&settings, DIMENSIONS, &mut rng);
    let (state, action) = (DIMENSIONS.observation, L::action_len(DIMENSIONS.users));
    let mut replay = Replay::new(300, state, action);
    for i in 0..300 {
        let numbers: Vec<f32> = (0..2 * state + action)
            .map(|_| rng.random_range(-1.0..1.0))
            .collect();
        let (now, rest) = numbers.split_at(state);
        let (action, next) = rest.split_at(action);
        replay.push(Transition {
            observation: now,
            action,
            user: (i % DIMENSIONS.users) as u8,
            reward: now[0] + 2.0,
            next_observation: next,
            last: i % 9 == 0,
            admissible: 0b1111,
            next_admissible: if i % 2 == 0 { 0b0110 } else { 0b1101 },
            entropy_mask: [i % 3 > 0, i % 4 > 0],
        });
    }
    (learner, replay, rng)
}

/// Returns column `s` of a matrix with one row per feature.
pub(crate) fn column(matrix: &[f32], width: usize, s: usize) -> Vec<f64> {
    matrix.chunks(width).map(|row| row[s].into()).collect()
}

/// Returns a network's parameters in double precision.
pub(crate) fn double(network: &Mlp) -> Vec<f64> {
    network.parameters().iter().map(|&x| x.into()).collect()
}
