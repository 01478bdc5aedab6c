//! A gradient step: the critics, then the actor, on the same transitions.
//!
//! The transitions are divided into a fixed number of parts, whose gradients are added in order
//! ([`parts`](crate::nn::sets::parts)), so results do not depend on the number of threads.

use pulp::Arch;

use super::{
    chunk::{Chunk, States},
    distribution::{Displacement, UserDistribution},
    memory::{Memory, Transition},
    networks::{CRITIC_FEATURES, Networks},
    settings::ReinforcementSettings,
};
use crate::{
    imitation::encoder::Encoder,
    nn::{
        ln,
        sets::{
            Activations, SetBatch, SetNetwork,
            backward::Gradients,
            functions::add,
            heads::OutputGradients,
            parts::{CHUNK, PARTS, for_each_part, part_of},
        },
    },
};

/// The error up to which a critic's loss is its square, in units of the mean rate of a slot; beyond,
/// the loss is linear (Huber). Most regrets are a few hundredths, and a few are the rest of a mission.
const ERROR_SQUARED: f32 = 1.0;

/// Sums over the transitions of a part.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    /// `J_Q` of both critics.
    pub critic_losses: [f64; 2],
    /// `r + gamma v'(s_{n+1})`.
    pub target: f64,
    /// `J_pi` without the loss of imitation.
    pub actor_loss: f64,
    /// The entropy of the users.
    pub user_entropy: f64,
    /// The entropy of a uniform choice among the admissible users.
    pub uniform_entropy: f64,
    /// The gradient of the mean value with respect to `ln sigma`.
    pub value_by_log_sigma: f64,
}

/// The buffers of a pass through one network.
#[derive(Clone, Debug, Default)]
struct Pass {
    activations: Activations,
    gradients: Gradients,
    outputs: OutputGradients,
}

/// A part of the transitions, with the gradients of its sums.
#[derive(Debug)]
struct Part {
    chunks: Vec<Chunk>,
    encoder: Encoder,
    actor: Pass,
    critics: [Pass; 2],
    with_displacement: SetBatch,
    samples: Vec<Displacement>,
    users: UserDistribution,
    critic_gradients: [Vec<f32>; 2],
    actor_gradient: Vec<f32>,
    sums: Sums,
}

/// The buffers of gradient steps.
#[derive(Debug)]
pub struct Learner {
    parts: Vec<Part>,
    threads: usize,
    arch: Arch,
}

/// The mean gradients over the transitions of a step.
#[derive(Debug)]
pub struct MeanGradient<'a> {
    /// Of the parameters of each network, in order.
    pub networks: Vec<&'a mut [f32]>,
    /// Means of what was summed.
    pub means: Sums,
}

impl Pass {
    /// Makes the gradient of the outputs zero.
    fn clear(&mut self, states: usize, users: usize) {
        self.outputs.clear(states, users);
    }

    fn scores(&self) -> &[f32] {
        &self.activations.outputs().scores
    }
}

impl Part {
    /// Evaluates the actor in some states and samples a displacement for each, then evaluates two
    /// critics there.
    fn evaluate(
        &mut self,
        arch: Arch,
        actor: &SetNetwork,
        critics: [&SetNetwork; 2],
        sigma: f32,
        states: &States,
    ) {
        let Self {
            actor: pass,
            critics: passes,
            with_displacement,
            samples,
            ..
        } = self;
        pass.activations.forward(arch, actor, &states.batch);
        samples.clear();
        let means = pass.activations.outputs().displacements();
        let sample = |(v, epsilon): ([f32; 2], &[f32; 2])| Displacement::new(v, sigma, *epsilon);
        samples.extend(means.zip(&states.epsilon).map(sample));
        let displacements: Vec<[f32; 2]> = samples.iter().map(|sample| sample.value).collect();
        with_displacement.extend_missions(&states.batch, &displacements);
        for (network, pass) in critics.into_iter().zip(passes) {
            pass.activations.forward(arch, network, with_displacement);
        }
    }

    /// Computes the gradients of the critics' losses on transitions.
    fn learn_values(
        &mut self,
        arch: Arch,
        settings: &ReinforcementSettings,
        networks: &Networks,
        chunk: &Chunk,
    ) {
        let targets = networks.targets.each_ref();
        let actor = &networks.actor.network;
        let sigma = networks.exploration.sigma();
        self.evaluate(arch, actor, targets, sigma, &chunk.next);
        let alpha = networks.user_temperature.alpha();
        let mut bellman = Vec::with_capacity(chunk.rewards.len());
        for (state, reward) in chunk.rewards.iter().enumerate() {
            let users = chunk.next.batch.users_of(state);
            let scores = &self.actor.scores()[users.clone()];
            let admissible = &chunk.next.admissible[users.clone()];
            self.users.evaluate(scores, admissible);
            let [first, second] = self
                .critics
                .each_ref()
                .map(|pass| &pass.scores()[users.clone()]);
            let least = |user: usize| first[user].min(second[user]);
            let value = self.users.soft_value(alpha, least);
            let target = reward + settings.discount * chunk.follows[state] * value;
            self.sums.target += f64::from(target);
            bellman.push(target);
        }
        let batch = &mut self.with_displacement;
        batch.extend_missions(&chunk.now.batch, &chunk.displacements);
        let critics = networks.critics.iter().zip(&mut self.critics);
        for (i, (critic, pass)) in critics.enumerate() {
            pass.activations.forward(arch, &critic.network, batch);
            pass.clear(batch.len(), batch.users());
            for (state, target) in bellman.iter().enumerate() {
                let at = batch.users_of(state).start + chunk.users[state];
                let error = pass.scores()[at] - target;
                let slope = error.clamp(-ERROR_SQUARED, ERROR_SQUARED);
                pass.outputs.scores[at] = slope;
                self.sums.critic_losses[i] += f64::from(slope * (error - 0.5 * slope));
            }
            pass.gradients.backward(
                arch,
                &critic.network,
                batch,
                &mut pass.activations,
                &pass.outputs,
                &mut self.critic_gradients[i],
            );
        }
    }

    /// Computes the gradient of the actor's loss in states.
    fn learn_policy(&mut self, arch: Arch, networks: &Networks, states: &States) {
        let critics = networks.critics.each_ref().map(|critic| &critic.network);
        let actor = &networks.actor.network;
        let sigma = networks.exploration.sigma();
        self.evaluate(arch, actor, critics, sigma, states);
        let batch = &states.batch;
        let alpha = networks.user_temperature.alpha();
        for pass in self.critics.iter_mut().chain([&mut self.actor]) {
            pass.clear(batch.len(), batch.users());
        }
        for state in 0..batch.len() {
            let users = batch.users_of(state);
            let admissible = &states.admissible[users.clone()];
            let scores = &self.actor.scores()[users.clone()];
            self.users.evaluate(scores, admissible);
            let d_scores = &mut self.actor.outputs.scores[users.clone()];
            let [first, second] = &mut self.critics;
            let values = |pass: &Pass| pass.scores()[users.clone()].to_vec();
            let values = [values(first), values(second)];
            let least = |user: usize| values[0][user].min(values[1][user]);
            self.users.gradient(alpha, least, d_scores);
            self.sums.actor_loss -= f64::from(self.users.soft_value(alpha, least));
            self.sums.user_entropy += f64::from(self.users.entropy());
            let count = admissible.iter().filter(|&&admits| admits).count();
            self.sums.uniform_entropy += f64::from(ln(count.max(1) as f32));
            // The gradient goes through the critic with the smaller value.
            for (index, user) in users.enumerate() {
                let lesser = if values[0][index] < values[1][index] {
                    &mut *first
                } else {
                    &mut *second
                };
                lesser.outputs.scores[user] = self.users.prob[index];
            }
        }
        let batch = &self.with_displacement;
        for (network, pass) in critics.into_iter().zip(&mut self.critics) {
            pass.gradients.backward_to_missions(
                arch,
                network,
                batch,
                &mut pass.activations,
                &pass.outputs,
            );
        }
        let layout = critics[0].layout();
        for (state, sample) in self.samples.iter().enumerate() {
            let mut slope = [0.0; 2];
            for pass in &self.critics {
                let features = pass.gradients.mission(layout, state);
                let displacement = &features[features.len() - 2..];
                slope[0] += displacement[0];
                slope[1] += displacement[1];
            }
            let d_u = sample.backward(slope);
            let epsilon = states.epsilon[state];
            let along = d_u[0] * epsilon[0] + d_u[1] * epsilon[1];
            self.sums.value_by_log_sigma += f64::from(sigma * along);
            let chosen = self.actor.activations.outputs().chosen[state];
            self.actor.outputs.candidates[state][chosen].displacement = d_u.map(|d_u| -d_u);
        }
        let Pass {
            activations,
            gradients,
            outputs,
        } = &mut self.actor;
        let gradient = &mut self.actor_gradient;
        gradients.backward(arch, actor, &states.batch, activations, outputs, gradient);
    }
}

impl Learner {
    /// Creates buffers for networks; computes on up to `threads` threads.
    pub fn new(networks: &Networks, arch: Arch, threads: usize) -> Self {
        let critic = vec![0.0; networks.critics[0].network.layout().len];
        let part = |_| Part {
            chunks: Vec::new(),
            encoder: Encoder::default(),
            actor: Pass::default(),
            critics: [Pass::default(), Pass::default()],
            with_displacement: SetBatch::new(CRITIC_FEATURES),
            samples: Vec::new(),
            users: UserDistribution::default(),
            critic_gradients: [critic.clone(), critic.clone()],
            actor_gradient: vec![0.0; networks.actor.network.layout().len],
            sums: Sums::default(),
        };
        Self {
            parts: (0..PARTS).map(part).collect(),
            threads,
            arch,
        }
    }

    /// Computes the gradients of both critics' losses on transitions.
    pub fn critics(
        &mut self,
        settings: &ReinforcementSettings,
        networks: &Networks,
        memory: &Memory,
        transitions: &[Transition],
    ) -> MeanGradient<'_> {
        let arch = self.arch;
        for_each_part(&mut self.parts, self.threads, |index, part| {
            part.sums = Sums::default();
            part.critic_gradients.iter_mut().for_each(|g| g.fill(0.0));
            let mut chunks = std::mem::take(&mut part.chunks);
            let transitions = transitions[part_of(index, transitions.len())].chunks(CHUNK);
            chunks.resize_with(transitions.len(), Chunk::default);
            for (chunk, transitions) in chunks.iter_mut().zip(transitions) {
                chunk.fill(memory, transitions, &mut part.encoder);
                part.learn_values(arch, settings, networks, chunk);
            }
            part.chunks = chunks;
        });
        self.mean(transitions.len(), |part| {
            let [first, second] = &mut part.critic_gradients;
            vec![first, second]
        })
    }

    /// Computes the gradient of the actor's loss on the transitions of the last
    /// [`critics`](Self::critics), of which there were `count`.
    pub fn actor(&mut self, networks: &Networks, count: usize) -> MeanGradient<'_> {
        let arch = self.arch;
        for_each_part(&mut self.parts, self.threads, |_, part| {
            part.sums = Sums::default();
            part.actor_gradient.fill(0.0);
            let chunks = std::mem::take(&mut part.chunks);
            for chunk in &chunks {
                part.learn_policy(arch, networks, &chunk.now);
            }
            part.chunks = chunks;
        });
        self.mean(count, |part| vec![&mut part.actor_gradient])
    }

    /// Returns the means of the sums of all parts and of some of their gradients.
    fn mean(
        &mut self,
        count: usize,
        gradients: impl Fn(&mut Part) -> Vec<&mut Vec<f32>>,
    ) -> MeanGradient<'_> {
        let per_transition = 1.0 / count as f64;
        let mut means = Sums::default();
        for sums in self.parts.iter().map(|part| part.sums) {
            means.add(&sums, per_transition);
        }
        let (first, others) = self.parts.split_at_mut(1);
        let mut networks = gradients(&mut first[0]);
        for part in others {
            for (sum, gradient) in networks.iter_mut().zip(gradients(part)) {
                add(self.arch, sum, gradient);
            }
        }
        let scaled = networks.into_iter().map(|sum| {
            sum.iter_mut().for_each(|g| *g *= per_transition as f32);
            sum.as_mut_slice()
        });
        MeanGradient {
            networks: scaled.collect(),
            means,
        }
    }
}

impl Sums {
    fn add(&mut self, other: &Self, scale: f64) {
        for (sum, other) in self.critic_losses.iter_mut().zip(other.critic_losses) {
            *sum += scale * other;
        }
        self.target += scale * other.target;
        self.actor_loss += scale * other.actor_loss;
        self.user_entropy += scale * other.user_entropy;
        self.uniform_entropy += scale * other.uniform_entropy;
        self.value_by_log_sigma += scale * other.value_by_log_sigma;
    }
}
