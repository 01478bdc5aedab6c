//! The replay memory `D` of Alg. 2 and the batches drawn from it.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::nn::padded;

/// Users that a state admits, one bit each.
pub type UserSet = u64;

/// One step of one environment.
#[derive(Clone, Copy, Debug)]
pub struct Transition<'a> {
    /// `s_n`, normalised.
    pub observation: &'a [f32],
    /// The raw action, in `[-1, 1]`, before the shield: what the shield makes of it is part of
    /// the environment.
    pub action: &'a [f32],
    /// The user that was served.
    pub user: u8,
    /// `r(s_n, a_n)`.
    pub reward: f32,
    /// `s_{n+1}`, normalised.
    pub next_observation: &'a [f32],
    /// Slot `N` is over: nothing follows.
    pub last: bool,
    /// Who could be served in `s_n`.
    pub admissible: UserSet,
    /// Who can be served in `s_{n+1}`.
    pub next_admissible: UserSet,
    /// Whether the displacement's entropy counts, in `s_n` and in `s_{n+1}`.
    pub choice: [bool; 2],
}

/// A ring of transitions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    observation_len: usize,
    action_len: usize,
    capacity: usize,
    /// Where the next one goes.
    next: usize,
    /// Row by row: observation, action, reward, next observation, 1 if something follows.
    numbers: Vec<f32>,
    users: Vec<u8>,
    admissible: Vec<[UserSet; 2]>,
    choice: Vec<[bool; 2]>,
}

impl Replay {
    /// Empty. Memory is reserved at once but used only as transitions come.
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
            choice: Vec::with_capacity(capacity),
        }
    }

    fn row_len(&self) -> usize {
        2 * self.observation_len + self.action_len + 2
    }

    /// Transitions held.
    pub fn len(&self) -> usize {
        self.users.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.users.is_empty()
    }

    /// Stores a transition, in place of the oldest once the ring is full.
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
            self.choice.push(t.choice);
        } else {
            let start = self.next * self.row_len();
            for (slot, value) in self.numbers[start..].iter_mut().zip(numbers) {
                *slot = value;
            }
            self.users[self.next] = t.user;
            self.admissible[self.next] = admissible;
            self.choice[self.next] = t.choice;
        }
        self.next = (self.next + 1) % self.capacity;
    }

    /// Draws a batch, with replacement.
    ///
    /// # Panics
    /// When nothing is stored.
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
            let [choice, next_choice] = self.choice[index].map(|is| f32::from(u8::from(is)));
            batch.choice[sample] = choice;
            batch.next_choice[sample] = next_choice;
        }
    }
}

/// Puts one sample's features into a matrix of features by samples.
pub fn scatter(features: &[f32], matrix: &mut [f32], width: usize, sample: usize) {
    for (row, &value) in matrix.chunks_exact_mut(width).zip(features) {
        row[sample] = value;
    }
}

/// Transitions drawn from the memory, feature by feature (see [`crate::nn`]).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Batch {
    /// How many.
    pub len: usize,
    /// `len`, filled up; what fills up stays zero and admits every user.
    pub width: usize,
    /// Features by samples.
    pub observation: Vec<f32>,
    /// Components by samples.
    pub action: Vec<f32>,
    /// Who was served.
    pub user: Vec<u8>,
    /// `r`.
    pub reward: Vec<f32>,
    /// Features by samples.
    pub next_observation: Vec<f32>,
    /// 0 after the last slot, else 1.
    pub follows: Vec<f32>,
    /// Who could be served.
    pub admissible: Vec<UserSet>,
    /// Who can be served next.
    pub next_admissible: Vec<UserSet>,
    /// 1 where the displacement's entropy counts, else 0.
    pub choice: Vec<f32>,
    /// The same for the next state.
    pub next_choice: Vec<f32>,
}

impl Batch {
    /// Room for `len` transitions.
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
            choice: vec![1.0; width],
            next_choice: vec![1.0; width],
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
            choice: [i.is_multiple_of(2), i.is_multiple_of(5)],
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
            assert_eq!(batch.choice[s] == 1.0, i.is_multiple_of(2));
            assert_eq!(batch.next_choice[s] == 1.0, i.is_multiple_of(5));
        }
    }
}
