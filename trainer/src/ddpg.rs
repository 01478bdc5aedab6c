//! Deep deterministic policy gradient, which the paper compares SAC with (Sec. VI).
//!
//! The actor returns the paper's (M + 2)-dimensional action, which is deterministic and
//! continuous: a displacement and one score per user, each squashed by `tanh`. The admissible user
//! with the highest score is served. Network sizes, environment, replay memory and batch are those
//! of [`crate::sac`]:
//!
//! ```text
//! a_n   = clip( mu(s_n) + noise, -1, 1 ),   noise ~ N(0, sigma^2)
//! J_Q   = mean 1/2 ( Q(s_n, a_n) - r - gamma Q'(s_{n+1}, mu'(s_{n+1})) )^2
//! J_mu  = mean -Q(s_n, mu(s_n))
//! theta' = tau theta + (1 - tau) theta'      for both networks
//! ```

use pulp::Arch;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use environment::{Action, Dimensions, UserSet};

use crate::{
    actor::Dense,
    learner::{Learner, Losses, States, fill_normal},
    nn::{Activations, Adam, Mlp, padded, tanh},
    replay::{Batch, Replay},
    settings::{Algorithm, TrainingSettings},
};

/// Everything that is learned: the two networks, their target networks and optimizers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    actor: Mlp,
    critic: Mlp,
    target_actor: Mlp,
    target_critic: Mlp,
    actor_adam: Adam,
    critic_adam: Adam,
}

/// Deep deterministic policy gradient: the learned state and the work buffers.
#[derive(Debug)]
pub struct Ddpg {
    state: State,
    settings: TrainingSettings,
    dimensions: Dimensions,
    arch: Arch,
    batch: Batch,
    actor: Activations,
    critic: Activations,
    target: Vec<f32>,
    gradient: Vec<f32>,
    acting: Activations,
    noise: Vec<f32>,
    losses: [(&'static str, f32); 3],
}

impl Learner for Ddpg {
    const ALGORITHM: Algorithm = Algorithm::Ddpg;
    type State = State;

    fn new(settings: &TrainingSettings, dimensions: Dimensions, rng: &mut Pcg64Mcg) -> Self {
        let Dimensions { users, observation } = dimensions;
        let h = settings.hidden;
        let action = Self::action_len(users);
        let actor = Mlp::new(&[observation, h, h, action], rng);
        let critic = Mlp::new(&[observation + action, h, h, 1], rng);
        let state = State {
            target_actor: actor.clone(),
            target_critic: critic.clone(),
            actor_adam: Adam::new(actor.parameters().len()),
            critic_adam: Adam::new(critic.parameters().len()),
            actor,
            critic,
        };
        Self::resume(settings, dimensions, state)
    }

    fn resume(settings: &TrainingSettings, dimensions: Dimensions, state: State) -> Self {
        let n = settings.batch;
        let action = Self::action_len(dimensions.users);
        let parameters = [&state.actor, &state.critic].map(|network| network.parameters().len());
        Self {
            settings: settings.clone(),
            dimensions,
            arch: Arch::new(),
            batch: Batch::new(n, dimensions.observation, action),
            actor: state.actor.activations(n),
            critic: state.critic.activations(n),
            target: vec![0.0; padded(n)],
            gradient: vec![0.0; parameters[0].max(parameters[1])],
            acting: state.actor.activations(settings.environments),
            noise: vec![0.0; action * padded(settings.environments)],
            losses: [("", 0.0); 3],
            state,
        }
    }

    fn state(&self) -> &State {
        &self.state
    }

    fn action_len(users: usize) -> usize {
        2 + users
    }

    fn explore(&mut self, states: &States, rng: &mut Pcg64Mcg, actions: &mut [Action]) {
        self.acting.input_mut().copy_from_slice(&states.observation);
        self.state.actor.forward(self.arch, &mut self.acting);
        fill_normal(rng, &mut self.noise);
        for (s, action) in actions.iter_mut().enumerate() {
            let outputs = self.acting.output().iter().zip(&self.noise);
            let column = outputs.skip(s).step_by(states.width);
            let noisy = |(&u, &noise): (&f32, &f32)| {
                (tanh(u) + self.settings.exploration_noise * noise).clamp(-1.0, 1.0)
            };
            action.components.clear();
            action.components.extend(column.map(noisy));
            action.user = best_admissible(&action.components[2..], states.admissible[s]);
        }
    }

    fn randomize(users: usize, admissible: UserSet, rng: &mut Pcg64Mcg, action: &mut Action) {
        action.randomize_components(Self::action_len(users), rng);
        action.user = best_admissible(&action.components[2..], admissible);
    }

    fn learn(&mut self, replay: &Replay, rng: &mut Pcg64Mcg) {
        replay.sample(rng, &mut self.batch);
        self.evaluate_bellman_target();
        let critic_loss = self.update_critic();
        let actor_loss = self.update_actor();
        let (arch, tau) = (self.arch, self.settings.tau);
        let state = &mut self.state;
        state.target_actor.soft_update(arch, &state.actor, tau);
        state.target_critic.soft_update(arch, &state.critic, tau);
        let n = self.batch.len;
        let mean_target = self.target[..n].iter().sum::<f32>() / n as f32;
        self.losses = [
            ("losses/qf1_loss", critic_loss),
            ("losses/qf_target", mean_target),
            ("losses/actor_loss", actor_loss),
        ];
    }

    fn losses(&self) -> &Losses {
        &self.losses
    }

    fn batch(&self) -> &Batch {
        &self.batch
    }

    /// Scores are exported before `tanh`, which keeps their order and avoids ties by saturation.
    fn deterministic(&self) -> Vec<Dense> {
        Dense::of_network(
            &self.state.actor,
            0..Self::action_len(self.dimensions.users),
        )
    }
}

/// Returns the admissible user with the highest score, or 0 if none is admissible.
fn best_admissible(scores: &[f32], admissible: UserSet) -> usize {
    let mut best: Option<usize> = None;
    for (user, &score) in scores.iter().enumerate() {
        let admitted = admissible >> user & 1 == 1;
        if admitted && best.is_none_or(|best| score > scores[best]) {
            best = Some(user);
        }
    }
    best.unwrap_or(0)
}

impl Ddpg {
    /// Writes `s` into the critic's input, and `tanh` of the actor's output as the action.
    fn load_policy_action(critic: &mut Activations, observation: &[f32], actor: &Activations) {
        let (states, actions) = critic.input_mut().split_at_mut(observation.len());
        states.copy_from_slice(observation);
        for (a, &u) in actions.iter_mut().zip(actor.output()) {
            *a = tanh(u);
        }
    }

    /// Computes `r + gamma Q'(s', mu'(s'))`.
    fn evaluate_bellman_target(&mut self) {
        let observation = &self.batch.next_observation;
        self.actor.input_mut().copy_from_slice(observation);
        self.state.target_actor.forward(self.arch, &mut self.actor);
        Self::load_policy_action(&mut self.critic, observation, &self.actor);
        self.state
            .target_critic
            .forward(self.arch, &mut self.critic);
        let values = self.critic.output().iter().zip(&self.batch.follows);
        let known = self.batch.reward.iter().zip(values);
        for (target, (reward, (value, follows))) in self.target.iter_mut().zip(known) {
            *target = reward + self.settings.discount * follows * value;
        }
    }

    /// Minimizes `J_Q` and returns the loss.
    fn update_critic(&mut self) -> f32 {
        let split = self.batch.observation.len();
        let (states, actions) = self.critic.input_mut().split_at_mut(split);
        states.copy_from_slice(&self.batch.observation);
        actions.copy_from_slice(&self.batch.action);
        self.state.critic.forward(self.arch, &mut self.critic);
        let per_sample = 1.0 / self.batch.len as f32;
        let (value, gradient) = self.critic.loss();
        gradient.fill(0.0);
        let mut loss = 0.0;
        let errors = value
            .iter()
            .zip(&self.target)
            .map(|(value, target)| value - target);
        for (gradient, error) in gradient.iter_mut().zip(errors).take(self.batch.len) {
            loss += 0.5 * error * error * per_sample;
            *gradient = error * per_sample;
        }
        let critic = &mut self.state.critic;
        let gradient = &mut self.gradient[..critic.parameters().len()];
        critic.backward(self.arch, &mut self.critic, Some(gradient), 0..0);
        let rate = self.settings.critic_learning_rate;
        let adam = &mut self.state.critic_adam;
        adam.step(self.arch, rate, critic.parameters_mut(), gradient);
        loss
    }

    /// Minimizes `J_mu` and returns the loss.
    fn update_actor(&mut self) -> f32 {
        let observation = &self.batch.observation;
        self.actor.input_mut().copy_from_slice(observation);
        self.state.actor.forward(self.arch, &mut self.actor);
        Self::load_policy_action(&mut self.critic, observation, &self.actor);
        self.state.critic.forward(self.arch, &mut self.critic);
        let len = self.batch.len;
        let per_sample = 1.0 / len as f32;
        let (value, gradient) = self.critic.loss();
        let loss = -value[..len].iter().sum::<f32>() * per_sample;
        gradient.fill(0.0);
        gradient[..len].fill(-per_sample);
        let start = self.dimensions.observation;
        let end = start + Self::action_len(self.dimensions.users);
        self.state
            .critic
            .backward(self.arch, &mut self.critic, None, start..end);
        let (output, gradient) = self.actor.loss();
        let slopes = output.iter().zip(self.critic.input_gradient());
        for (gradient, (&u, slope)) in gradient.iter_mut().zip(slopes) {
            let a = tanh(u);
            *gradient = slope * (1.0 - a * a);
        }
        let actor = &mut self.state.actor;
        let gradient = &mut self.gradient[..actor.parameters().len()];
        actor.backward(self.arch, &mut self.actor, Some(gradient), 0..0);
        let rate = self.settings.policy_learning_rate;
        let adam = &mut self.state.actor_adam;
        adam.step(self.arch, rate, actor.parameters_mut(), gradient);
        loss
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        fixture::{BATCH, column, double, filled},
        nn::{
            arch::every_arch,
            reference::{check_gradient, forward},
        },
    };

    fn value(critic: &Mlp, parameters: &[f64], state: &[f64], action: Vec<f64>) -> f64 {
        let input: Vec<f64> = state.iter().copied().chain(action).collect();
        forward(critic, parameters, &input)[0]
    }

    #[test]
    fn the_critic_loss_and_its_gradient_match_finite_differences() {
        let (mut ddpg, replay, mut rng) = filled::<Ddpg>();
        replay.sample(&mut rng, &mut ddpg.batch);
        ddpg.evaluate_bellman_target();
        let width = ddpg.batch.width;
        let (mu, q) = (&ddpg.state.target_actor, &ddpg.state.target_critic);
        let targets: Vec<f64> = (0..BATCH)
            .map(|s| {
                let next = column(&ddpg.batch.next_observation, width, s);
                let action = forward(mu, &double(mu), &next)
                    .iter()
                    .map(|u| u.tanh())
                    .collect();
                f64::from(ddpg.batch.reward[s])
                    + 0.9 * f64::from(ddpg.batch.follows[s]) * value(q, &double(q), &next, action)
            })
            .collect();
        let critic = ddpg.state.critic.clone();
        let loss = ddpg.update_critic();
        let batch = &ddpg.batch;
        let reference = |parameters: &[f64]| {
            let error = |s: usize| {
                let state = column(&batch.observation, width, s);
                value(&critic, parameters, &state, column(&batch.action, width, s)) - targets[s]
            };
            (0..BATCH).map(|s| 0.5 * error(s).powi(2)).sum::<f64>() / BATCH as f64
        };
        assert!((f64::from(loss) - reference(&double(&critic))).abs() < 1e-5);
        let gradient = &ddpg.gradient[..critic.parameters().len()];
        check_gradient(critic.parameters(), gradient, 300, reference);
    }

    #[test]
    fn the_actor_loss_and_its_gradient_match_finite_differences() {
        let (mut ddpg, replay, mut rng) = filled::<Ddpg>();
        replay.sample(&mut rng, &mut ddpg.batch);
        let (width, actor) = (ddpg.batch.width, ddpg.state.actor.clone());
        let loss = ddpg.update_actor();
        let critic = &ddpg.state.critic;
        let fixed = double(critic);
        let reference = |parameters: &[f64]| {
            let cost = |s: usize| {
                let state = column(&ddpg.batch.observation, width, s);
                let action = forward(&actor, parameters, &state);
                let action = action.iter().map(|u| u.tanh()).collect();
                -value(critic, &fixed, &state, action)
            };
            (0..BATCH).map(cost).sum::<f64>() / BATCH as f64
        };
        assert!((f64::from(loss) - reference(&double(&actor))).abs() < 1e-5);
        let gradient = &ddpg.gradient[..actor.parameters().len()];
        check_gradient(actor.parameters(), gradient, 300, reference);
    }

    /// Results are the same bits with every set of vector instructions.
    #[test]
    fn same_seed_same_bytes_with_any_vector_instructions() {
        let run = |arch: Arch| {
            let (mut ddpg, replay, mut rng) = filled::<Ddpg>();
            ddpg.arch = arch;
            for _ in 0..60 {
                ddpg.learn(&replay, &mut rng);
            }
            (ddpg.state.clone(), ddpg.losses)
        };
        let plain = run(Arch::Scalar);
        for arch in every_arch() {
            assert_eq!(run(arch), plain, "{arch:?}");
        }
    }

    #[test]
    fn the_served_user_is_the_admissible_one_with_the_highest_score() {
        assert_eq!(best_admissible(&[0.1, 0.9, 0.5], 0b111), 1);
        assert_eq!(best_admissible(&[0.1, 0.9, 0.5], 0b101), 2);
    }
}
