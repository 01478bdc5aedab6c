//! What the two algorithms have in common, as seen by the training loop.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Serialize, de::DeserializeOwned};

use crate::{
    actor::Dense,
    replay::{Batch, Replay, UserSet},
    settings::{Algorithm, Settings},
};

/// Sizes of the learning problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, serde::Deserialize)]
pub struct Dimensions {
    /// `M`.
    pub users: usize,
    /// `M + 4`.
    pub observation: usize,
}

/// Several states at once, features by samples (see [`crate::nn`]).
#[derive(Clone, Debug)]
pub struct States {
    /// How many.
    pub len: usize,
    /// `len`, filled up.
    pub width: usize,
    /// Normalised observations.
    pub observation: Vec<f32>,
    /// Who may be served.
    pub admissible: Vec<UserSet>,
}

/// What an agent does in one state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choice {
    /// The raw action, each component in `[-1, 1]`; the displacement is its first two.
    pub action: Vec<f32>,
    /// The user to serve.
    pub user: usize,
}

/// What a gradient step reports, under CleanRL's names where it has them.
pub type Losses = [(&'static str, f32)];

/// A learning algorithm.
pub trait Learner: Sized {
    /// Which one.
    const ALGORITHM: Algorithm;
    /// All that its future depends on, except random numbers and the replay memory, which the
    /// training loop owns.
    type State: Serialize + DeserializeOwned;

    /// Fresh networks.
    fn new(settings: &Settings, dimensions: Dimensions, rng: &mut Pcg64Mcg) -> Self;

    /// Goes on from a state that [`state`](Self::state) gave.
    fn resume(settings: &Settings, dimensions: Dimensions, state: Self::State) -> Self;

    /// What a checkpoint keeps.
    fn state(&self) -> &Self::State;

    /// Length of [`Choice::action`] for `users` users.
    fn action_len(users: usize) -> usize;

    /// Acts with exploration, one choice per state.
    fn explore(&mut self, states: &States, rng: &mut Pcg64Mcg, choices: &mut [Choice]);

    /// A uniformly random choice, for the first slots.
    fn choose_at_random(
        users: usize,
        admissible: UserSet,
        rng: &mut Pcg64Mcg,
        choice: &mut Choice,
    ) {
        choice.action.resize(Self::action_len(users), 0.0);
        choice
            .action
            .iter_mut()
            .for_each(|a| *a = rng.random_range(-1.0..1.0));
        let count = (0..users).filter(|m| admissible >> m & 1 == 1).count();
        let nth = rng.random_range(0..count.max(1));
        let mut admitted = (0..users).filter(|m| admissible >> m & 1 == 1);
        choice.user = admitted.nth(nth).unwrap_or(0);
    }

    /// One gradient step of every network on a batch from memory.
    fn learn(&mut self, replay: &Replay, rng: &mut Pcg64Mcg);

    /// What the last [`learn`](Self::learn) came to.
    fn losses(&self) -> &Losses;

    /// The batch of the last [`learn`](Self::learn).
    fn batch(&self) -> &Batch;

    /// The deterministic policy: layers whose output is `[u_x, u_y, scores..]`, to be squashed
    /// by `tanh` where it is a displacement.
    fn deterministic(&self) -> Vec<Dense>;
}

/// Fills with standard normal numbers (Box and Muller), the same on every machine.
pub fn fill_normal(rng: &mut Pcg64Mcg, values: &mut [f32]) {
    for pair in values.chunks_mut(2) {
        // In (0, 1], so that the logarithm is finite.
        let radius = libm::sqrtf(-2.0 * libm::logf(1.0 - rng.random::<f32>()));
        let angle = core::f32::consts::TAU * rng.random::<f32>();
        pair[0] = radius * libm::cosf(angle);
        if let Some(second) = pair.get_mut(1) {
            *second = radius * libm::sinf(angle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn normal_numbers_have_the_moments() {
        let mut values = vec![0.0; 200_000];
        fill_normal(&mut Pcg64Mcg::seed_from_u64(1), &mut values);
        let moment = |k: i32| {
            let sum: f64 = values.iter().map(|&x| f64::from(x).powi(k)).sum();
            sum / values.len() as f64
        };
        assert!(moment(1).abs() < 0.01);
        assert!((moment(2) - 1.0).abs() < 0.02);
        assert!(moment(3).abs() < 0.05);
        assert!((moment(4) - 3.0).abs() < 0.1);
    }
}
