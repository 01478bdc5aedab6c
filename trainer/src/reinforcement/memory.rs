//! The missions that are learned from, and transitions drawn from them.
//!
//! The memory has flown missions, from which inputs are computed when they are drawn, so that a
//! transition takes some fifty bytes. What another admissible user would have earned is known as
//! well, and so is the state that it leads to: only the counts differ.

use std::collections::VecDeque;

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::episode::Episode;
use crate::imitation::demonstration::Demonstration;

/// The missions that are learned from, the oldest first.
#[derive(Clone, Debug)]
pub struct Memory {
    capacity: usize,
    demonstrations: VecDeque<Demonstration>,
    episodes: VecDeque<Episode>,
    /// The number of missions that have been added.
    added: u64,
}

/// A transition of the memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transition {
    /// The index of the mission.
    pub mission: usize,
    /// The slot, from 0.
    pub slot: usize,
    /// The user.
    pub user: usize,
    /// The seed of its reflection and of the policy's noise.
    pub seed: u64,
}

impl Memory {
    /// Creates a memory for `capacity` missions from those that it has, the oldest first.
    pub fn new(capacity: usize, missions: Vec<(Demonstration, Episode)>, added: u64) -> Self {
        let (demonstrations, episodes) = missions.into_iter().unzip();
        Self {
            capacity,
            demonstrations,
            episodes,
            added,
        }
    }

    /// Adds a flown mission; in a full memory it replaces the oldest one.
    pub fn push(&mut self, demonstration: Demonstration, episode: Episode) {
        if self.episodes.len() >= self.capacity {
            self.demonstrations.pop_front();
            self.episodes.pop_front();
        }
        self.demonstrations.push_back(demonstration);
        self.episodes.push_back(episode);
        self.added += 1;
    }

    /// Returns the number of missions that have been added, also of those that have been replaced.
    pub fn added(&self) -> u64 {
        self.added
    }

    /// Returns the missions, the oldest first.
    pub fn missions(&self) -> impl ExactSizeIterator<Item = (&Demonstration, &Episode)> {
        self.demonstrations.iter().zip(&self.episodes)
    }

    /// Returns the planned missions in one slice.
    pub fn demonstrations(&mut self) -> &[Demonstration] {
        self.demonstrations.make_contiguous()
    }

    /// Returns a mission.
    pub fn mission(&self, index: usize) -> (&Demonstration, &Episode) {
        (&self.demonstrations[index], &self.episodes[index])
    }

    /// Draws a transition. With probability `alternative_fraction` its user is a random admissible one,
    /// else the one that was served.
    ///
    /// # Panics
    /// If the memory is empty.
    pub fn draw(&self, alternative_fraction: f64, rng: &mut Pcg64Mcg) -> Transition {
        let mission = rng.random_range(0..self.episodes.len());
        let episode = &self.episodes[mission];
        let slot = rng.random_range(0..episode.slots());
        let mut user = usize::from(episode.users[slot]);
        if rng.random_bool(alternative_fraction) {
            let mut admissible = episode.admissible(slot);
            let count = admissible.clone().count();
            let other = admissible.nth(rng.random_range(0..count.max(1)));
            user = other.unwrap_or(user);
        }
        Transition {
            mission,
            slot,
            user,
            seed: rng.random(),
        }
    }
}
