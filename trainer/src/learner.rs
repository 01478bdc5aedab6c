//! The interface between the training loop and the learning algorithms.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Serialize, de::DeserializeOwned};

use environment::{Action, Dimensions, UserSet};

use crate::{
    actor::Dense,
    replay::{Batch, Replay},
    settings::{Algorithm, TrainingSettings},
};

/// A batch of states, with one row per feature (see [`crate::nn`]).
#[derive(Clone, Debug)]
pub struct States {
    /// Number of states.
    pub len: usize,
    /// Number of columns: `len` padded to a multiple of [`LANES`](crate::nn::LANES).
    pub width: usize,
    /// Normalized observations.
    pub observation: Vec<f32>,
    /// The users that may be served in each state.
    pub admissible: Vec<UserSet>,
}

/// Names and values that a gradient step reports. Names are CleanRL's where it has them.
pub type Losses = [(&'static str, f32)];

/// A learning algorithm.
pub trait Learner: Sized {
    /// Its name in settings and checkpoints.
    const ALGORITHM: Algorithm;
    /// Everything that further learning depends on, except the random number generator and the
    /// replay memory, which the training loop owns.
    type State: Serialize + DeserializeOwned;

    /// Creates a learner with randomly initialized networks.
    fn new(settings: &TrainingSettings, dimensions: Dimensions, rng: &mut Pcg64Mcg) -> Self;

    /// Creates a learner that continues from a state that [`state`](Self::state) returned.
    fn resume(settings: &TrainingSettings, dimensions: Dimensions, state: Self::State) -> Self;

    /// Returns the state that a checkpoint stores.
    fn state(&self) -> &Self::State;

    /// Returns the number of [`Action::components`] for `users` users.
    fn action_len(users: usize) -> usize;

    /// Selects one action per state, with exploration.
    fn explore(&mut self, states: &States, rng: &mut Pcg64Mcg, actions: &mut [Action]);

    /// Replaces `action` by a uniformly random one with an admissible user; used in the slots before
    /// learning starts.
    fn randomize(users: usize, admissible: UserSet, rng: &mut Pcg64Mcg, action: &mut Action) {
        action.randomize(Self::action_len(users), users, admissible, rng);
    }

    /// Performs one gradient step of every network on a batch sampled from the memory.
    fn learn(&mut self, replay: &Replay, rng: &mut Pcg64Mcg);

    /// Returns the losses of the last [`learn`](Self::learn).
    fn losses(&self) -> &Losses;

    /// Returns the batch of the last [`learn`](Self::learn).
    fn batch(&self) -> &Batch;

    /// Returns the deterministic policy: layers whose output is `[u_x, u_y, scores..]`. The
    /// displacement is `tanh` of the first two.
    fn deterministic(&self) -> Vec<Dense>;
}

/// Fills a slice with standard normal numbers (Box and Muller), the same on every machine.
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
