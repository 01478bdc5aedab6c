//! The replay memory `D` of Alg. 2, and batches sampled from it.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use environment::UserSet;

use crate::nn::padded;

/// One step of one environment.
#[derive(Clone, Copy, Debug)]
pub struct Transition<'a> {
    /// `s_n`, normalized.
    pub observation: &'a [f32],
    /// The components of the action, in `[-1, 1]`, before the shield, which is part of the
    /// environment.
    pub action: &'a [f32],
    /// The user that was served.
    pub user: u8,
    /// `r(s_n, a_n)`.
    pub reward: f32,
    /// `s_{n+1}`, normalized.
    pub next_observation: &'a [f32],
    /// Whether this was slot `N`, after which the episode ends.
    pub last: bool,
    /// The users that could be served in `s_n`.
    pub admissible: UserSet,
    /// The users that can be served in `s_{n+1}`.
    pub next_admissible: UserSet,
    /// Whether the displacement's entropy counts, in `s_n` and in `s_{n+1}`.
    pub entropy_mask: [bool; 2],
}

/// A ring buffer of transitions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    observation_len: usize,
    action_len: usize,
    capacity: usize,
    /// The index at which the next transition is stored.
    next: usize,
    /// One row per transition: observation, action, reward, next observation, and 1 or, after the
    /// last slot, 0.
    numbers: Vec<f32>,
    users: Vec<u8>,
    admissible: Vec<[UserSet; 2]>,
    entropy_mask: Vec<[bool; 2]>,
}

impl Replay {
    /// Returns an empty memory. Its address space is reserved at once; pages are used only as
    /// transitions are stored.
    pub fn new(capacity: usize, observation_len: usize, action_len: usize) -> Self {
        let row = 2 * observation_len + action_len + 2;
        Self {
            observation_len,
            action_len,
            capacity,
            next: 0,
            numbers: Vec::with_capacity(capacity * row),
            users: Vec::with_capacity(capacity),
            admissible: Vec::with_capacity(capacity),
            entropy_mask: Vec::with_capacity(capacity),
        }
    }

    fn row_len(&self) -> usize {
        2 * self.observation_len + self.action_len + 2
    }

    /// Returns the number of transitions stored.
    pub fn len(&self) -> usize {
        self.users.len()
    }

    /// Returns whether no transition is stored.
    pub fn is_empty(&self) -> bool {
        self.users.is_empty()
    }

    /// Stores a transition; a full memory replaces its oldest one.
    pub fn push(&mut self, t: Transition<'_>) {
        debug_assert_eq!(t.observation.len(), self.observation_len);
        debug_assert_eq!(t.action.len(), self.action_len);
        let numbers = t
            .observation
            .iter()
            .chain(t.action)
            .chain([&t.reward])
            .chain(t.next_observation)
            .copied()
            .chain([if t.last { 0.0 } else { 1.0 }]);
        let admissible = [t.admissible, t.next_admissible];
        if self.len() < self.capacity {
            self.numbers.extend(numbers);
            self.users.push(t.user);
            self.admissible.push(admissible);
            self.entropy_mask.push(t.entropy_mask);
        } else {
            let start = self.next * self.row_len();
            for (slot, value) in self.numbers[start..].iter_mut().zip(numbers) {
                *slot = value;
            }
            self.users[self.next] = t.user;
            self.admissible[self.next] = admissible;
            self.entropy_mask[self.next] = t.entropy_mask;
        }
        self.next = (self.next + 1) % self.capacity;
    }

    /// Samples a batch uniformly, with replacement.
    ///
    /// # Panics
    /// If the memory is empty.
    pub fn sample(&self, rng: &mut Pcg64Mcg, batch: &mut Batch) {
        let (n, a, width) = (self.observation_len, self.action_len, batch.width);
        for sample in 0..batch.len {
            let index = rng.random_range(0..self.len());
            let row = &self.numbers[index * self.row_len()..][..self.row_len()];
            let (observation, rest) = row.split_at(n);
            let (action, rest) = rest.split_at(a);
            let (reward, rest) = rest.split_at(1);
            let (next_observation, follows) = rest.split_at(n);
            scatter(observation, &mut batch.observation, width, sample);
            scatter(action, &mut batch.action, width, sample);
            scatter(next_observation, &mut batch.next_observation, width, sample);
            batch.reward[sample] = reward[0];
            batch.follows[sample] = follows[0];
            batch.user[sample] = self.users[index];
            batch.admissible[sample] = self.admissible[index][0];
            batch.next_admissible[sample] = self.admissible[index][1];
            let [entropy_mask, next_entropy_mask] =
                self.entropy_mask[index].map(|is| f32::from(u8::from(is)));
            batch.entropy_mask[sample] = entropy_mask;
            batch.next_entropy_mask[sample] = next_entropy_mask;
        }
    }
}

/// Writes one sample's features into its column of a matrix with one row per feature.
pub fn scatter(features: &[f32], matrix: &mut [f32], width: usize, sample: usize) {
    for (row, &value) in matrix.chunks_exact_mut(width).zip(features) {
        row[sample] = value;
    }
}

/// Transitions sampled from the memory, stored feature by feature (see [`crate::nn`]).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Batch {
    /// Number of transitions.
    pub len: usize,
    /// Number of columns: `len` padded to a multiple of [`LANES`](crate::nn::LANES). Padding stays
    /// zero and admits every user.
    pub width: usize,
    /// `s_n`, one row per feature.
    pub observation: Vec<f32>,
    /// The actions, one row per component.
    pub action: Vec<f32>,
    /// The users that were served.
    pub user: Vec<u8>,
    /// The rewards `r`.
    pub reward: Vec<f32>,
    /// `s_{n+1}`, one row per feature.
    pub next_observation: Vec<f32>,
    /// 0 after the last slot, else 1.
    pub follows: Vec<f32>,
    /// The users that could be served in `s_n`.
    pub admissible: Vec<UserSet>,
    /// The users that can be served in `s_{n+1}`.
    pub next_admissible: Vec<UserSet>,
    /// 1 where the displacement's entropy counts in `s_n`, else 0. Files call it `choice`.
    #[serde(rename = "choice")]
    pub entropy_mask: Vec<f32>,
    /// The same for `s_{n+1}`. Files call it `next_choice`.
    #[serde(rename = "next_choice")]
    pub next_entropy_mask: Vec<f32>,
}

impl Batch {
    /// Allocates a batch of `len` transitions.
    pub fn new(len: usize, observation_len: usize, action_len: usize) -> Self {
        let width = padded(len);
        Self {
            len,
            width,
            observation: vec![0.0; observation_len * width],
            action: vec![0.0; action_len * width],
            user: vec![0; width],
            reward: vec![0.0; width],
            next_observation: vec![0.0; observation_len * width],
            follows: vec![0.0; width],
            admissible: vec![UserSet::MAX; width],
            next_admissible: vec![UserSet::MAX; width],
            entropy_mask: vec![1.0; width],
            next_entropy_mask: vec![1.0; width],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn push(replay: &mut Replay, i: u8) {
        let x = f32::from(i);
        replay.push(Transition {
            observation: &[x, -x],
            action: &[x / 100.0],
            user: i % 3,
            reward: 10.0 * x,
            next_observation: &[x + 1.0, -x - 1.0],
            last: i % 4 == 3,
            admissible: u64::from(i),
            next_admissible: u64::from(i) + 1,
            entropy_mask: [i.is_multiple_of(2), i.is_multiple_of(5)],
        });
    }

    #[test]
    fn a_batch_holds_whole_transitions_of_the_newest() {
        let mut replay = Replay::new(10, 2, 1);
        for i in 0..25 {
            push(&mut replay, i);
        }
        assert_eq!(replay.len(), 10);
        let mut batch = Batch::new(64, 2, 1);
        replay.sample(&mut Pcg64Mcg::seed_from_u64(1), &mut batch);
        for s in 0..64 {
            let x = batch.observation[s];
            assert!((15.0..25.0).contains(&x), "{x} is not among the newest ten");
            let i = x as u8;
            assert_eq!(batch.observation[64 + s], -x);
            assert_eq!(batch.action[s], x / 100.0);
            assert_eq!(batch.user[s], i % 3);
            assert_eq!(batch.reward[s], 10.0 * x);
            assert_eq!(batch.next_observation[s], x + 1.0);
            assert_eq!(batch.follows[s], if i % 4 == 3 { 0.0 } else { 1.0 });
            assert_eq!(batch.admissible[s], u64::from(i));
            assert_eq!(batch.next_admissible[s], u64::from(i) + 1);
            assert_eq!(batch.entropy_mask[s] == 1.0, i.is_multiple_of(2));
            assert_eq!(batch.next_entropy_mask[s] == 1.0, i.is_multiple_of(5));
        }
    }
}
