//! Transitions as inputs of the networks.

use firmware_core::{Position, policy::Observation, shield::Agility};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::memory::{Memory, Transition};
use crate::{
    imitation::{
        encoder::{Encoder, FEATURES},
        symmetry::Symmetry,
    },
    learner::fill_normal,
    nn::sets::SetBatch,
};

/// The states of some transitions: `s_n` or `s_{n+1}`.
#[derive(Clone, Debug)]
pub struct States {
    /// The inputs of the actor.
    pub batch: SetBatch,
    /// Whether each user of all states may be served.
    pub admissible: Vec<bool>,
    /// The noise of the policy in each state.
    pub epsilon: Vec<[f32; 2]>,
}

impl Default for States {
    fn default() -> Self {
        Self {
            batch: SetBatch::new(FEATURES),
            admissible: Vec::new(),
            epsilon: Vec::new(),
        }
    }
}

/// Some transitions, computed together.
#[derive(Clone, Debug, Default)]
pub struct Chunk {
    /// `s_n`.
    pub now: States,
    /// `s_{n+1}`; after the last slot `s_n`, which then does not count.
    pub next: States,
    /// `a_n`, before the shield.
    pub displacements: Vec<[f32; 2]>,
    /// `m_n`.
    pub users: Vec<usize>,
    /// `r`.
    pub rewards: Vec<f32>,
    /// 0 after the last slot, else 1.
    pub follows: Vec<f32>,
}

impl States {
    fn clear(&mut self) {
        self.batch.clear();
        self.admissible.clear();
        self.epsilon.clear();
    }

    fn push(&mut self, encoder: &Encoder, rng: &mut Pcg64Mcg) {
        self.batch.push(&encoder.state());
        self.admissible.extend_from_slice(encoder.admissible());
        let mut epsilon = [0.0; 2];
        fill_normal(rng, &mut epsilon);
        self.epsilon.push(epsilon);
    }
}

impl Chunk {
    /// Replaces the content by transitions, each reflected at random.
    pub fn fill(&mut self, memory: &Memory, transitions: &[Transition], encoder: &mut Encoder) {
        self.now.clear();
        self.next.clear();
        self.displacements.clear();
        self.users.clear();
        self.rewards.clear();
        self.follows.clear();
        for transition in transitions {
            self.push(memory, transition, encoder);
        }
    }

    fn push(&mut self, memory: &Memory, transition: &Transition, encoder: &mut Encoder) {
        let &Transition {
            mission,
            slot,
            user,
            seed,
        } = transition;
        let (demonstration, episode) = memory.mission(mission);
        let area = demonstration.mission.parameters().area;
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let symmetry = Symmetry::random(&mut rng);
        let mission = symmetry.mission(&demonstration.mission);
        let mut counts = episode.counts(mission.user_count(), slot);
        let encode = |slot: usize, counts: &[u32], encoder: &mut Encoder| {
            let [east_m, north_m] = episode.positions_m[slot];
            let observation = Observation {
                slot: slot as u32 + 1,
                counts,
                rate: 0.0,
                mse: 0.0,
                position: symmetry.place(&area, &Position::new(east_m, north_m)),
                agility: Agility::ideal(&mission),
            };
            encoder.encode(&mission, &observation);
        };
        encode(slot, &counts, encoder);
        self.now.push(encoder, &mut rng);
        let follows = slot + 1 < episode.slots();
        if follows {
            counts[user] += 1;
            encode(slot + 1, &counts, encoder);
        }
        self.next.push(encoder, &mut rng);
        self.follows.push(f32::from(u8::from(follows)));
        self.rewards.push(episode.reward(slot, user));
        self.users.push(user);
        self.displacements
            .push(symmetry.displacement(episode.displacements[slot]));
    }
}
