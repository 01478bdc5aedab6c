//! A flown mission.

use anyhow::ensure;
use environment::Action;
use firmware_core::{policy::Observation, shield::Agility};
use pulp::Arch;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use scenario::HostMission;
use serde::{Deserialize, Serialize};

use super::{
    distribution::{Displacement, UserDistribution},
    task::Task,
};
use crate::{
    imitation::encoder::{Encoder, FEATURES},
    learner::fill_normal,
    nn::sets::{Activations, SetBatch, SetNetwork},
};

/// The largest magnitude of a reward. Where the way to the destination takes all slots that are left,
/// the value function of the relaxed mission is interpolated between places that can still be reached in
/// time and others with a large loss, and its changes mean nothing; the shield decides there anyway.
pub const REWARD_MAX: f64 = 10.0;

/// A flown mission: all that its transitions are computed from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// The positions before the first slot and after each, metres.
    pub positions_m: Vec<[f64; 2]>,
    /// The displacement of each slot before the shield, in units of the way of a slot.
    pub displacements: Vec<[f32; 2]>,
    /// The user of each slot.
    pub users: Vec<u8>,
    /// For each slot and user, the reward of serving the user, in units of the mean rate of a slot of
    /// the plan, at most [`REWARD_MAX`] in magnitude; NaN if the user may not be served.
    pub rewards: Vec<f32>,
    /// The sum of the rates as a fraction of the plan's.
    pub fraction: f64,
}

/// How a mission is flown.
#[derive(Clone, Copy, Debug)]
pub enum Pilot<'a> {
    /// Uniformly random displacements and users.
    Random,
    /// The stochastic policy of a network with this `sigma`.
    Network(&'a SetNetwork, f32),
}

impl Episode {
    /// Flies a mission.
    ///
    /// # Errors
    /// Fails if a reward is not finite.
    pub fn fly(
        task: &Task,
        pilot: Pilot<'_>,
        arch: Arch,
        rng: &mut Pcg64Mcg,
    ) -> anyhow::Result<Self> {
        let mission = &task.demonstration.mission;
        let (users, slots) = (mission.user_count(), mission.slots() as usize);
        let mut environment = task.environment();
        let mut ignored = vec![0.0; environment.dimensions().observation];
        let mut network = Decision::default();
        let start = environment.position();
        let mut episode = Self {
            positions_m: vec![[start.x, start.y]],
            displacements: Vec::with_capacity(slots),
            users: Vec::with_capacity(slots),
            rewards: Vec::with_capacity(slots * users),
            fraction: 0.0,
        };
        for slot in 0..slots {
            let mut epsilon = [0.0; 2];
            fill_normal(rng, &mut epsilon);
            let (displacement, user) = match pilot {
                Pilot::Random => {
                    let mut action = Action::default();
                    action.randomize(2, users, environment.admissible(), rng);
                    let v = [action.components[0], action.components[1]];
                    (Displacement::new(v, 0.0, epsilon).value, action.user)
                }
                Pilot::Network(parameters, sigma) => {
                    let counts = episode.counts(users, slot);
                    let observation = Observation {
                        slot: slot as u32 + 1,
                        counts: &counts,
                        rate: 0.0,
                        mse: 0.0,
                        position: environment.position(),
                        agility: Agility::ideal(mission),
                    };
                    let v = network.evaluate(arch, parameters, mission, &observation);
                    let user = network.users.pick(rng.random());
                    (Displacement::new(v, sigma, epsilon).value, user)
                }
            };
            let admissible = environment.admissible();
            let unit = task.mean_rate();
            let mut action = Action {
                components: displacement.to_vec(),
                user,
            };
            for user in 0..users {
                let reward = if admissible >> user & 1 == 0 {
                    f64::NAN
                } else {
                    action.user = user;
                    let result = environment.peek_step(&action, &mut ignored);
                    let reward = result.step.reward.total / unit;
                    ensure!(reward.is_finite(), "a reward is {reward}");
                    reward.clamp(-REWARD_MAX, REWARD_MAX)
                };
                episode.rewards.push(reward as f32);
            }
            action.user = user;
            environment.step(&action);
            let position = environment.position();
            episode.displacements.push(displacement);
            episode.users.push(user as u8);
            episode.positions_m.push([position.x, position.y]);
        }
        let slots = slots as f64;
        episode.fraction = environment.episode().sum_rate / (task.mean_rate() * slots);
        Ok(episode)
    }

    /// Returns the number of slots.
    pub fn slots(&self) -> usize {
        self.users.len()
    }

    /// Returns how often each user was served before a slot (from 0).
    pub fn counts(&self, users: usize, slot: usize) -> Vec<u32> {
        let mut counts = vec![0; users];
        for &user in &self.users[..slot] {
            counts[usize::from(user)] += 1;
        }
        counts
    }

    /// Returns the reward of serving a user in a slot (from 0); NaN if it may not be served.
    pub fn reward(&self, slot: usize, user: usize) -> f32 {
        let users = self.rewards.len() / self.slots();
        self.rewards[slot * users + user]
    }

    /// Returns the users that may be served in a slot (from 0).
    pub fn admissible(&self, slot: usize) -> impl Iterator<Item = usize> + Clone + '_ {
        let users = self.rewards.len() / self.slots();
        (0..users).filter(move |&user| !self.reward(slot, user).is_nan())
    }
}

/// The network in one state, with its buffers.
#[derive(Debug)]
struct Decision {
    encoder: Encoder,
    batch: SetBatch,
    activations: Activations,
    users: UserDistribution,
}

impl Default for Decision {
    fn default() -> Self {
        Self {
            encoder: Encoder::default(),
            batch: SetBatch::new(FEATURES),
            activations: Activations::default(),
            users: UserDistribution::default(),
        }
    }
}

impl Decision {
    /// Returns `v(s)` and computes the distribution over the users.
    fn evaluate(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        mission: &HostMission,
        observation: &Observation<'_, f64>,
    ) -> [f32; 2] {
        self.encoder.encode(mission, observation);
        self.batch.clear();
        self.batch.push(&self.encoder.state());
        self.activations.forward(arch, network, &self.batch);
        let outputs = self.activations.outputs();
        let admissible = self.encoder.admissible();
        self.users.evaluate(&outputs.scores, admissible);
        outputs.displacement(0)
    }
}
