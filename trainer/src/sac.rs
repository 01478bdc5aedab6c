//! Soft actor-critic with a hybrid action, written so that it can be read side by side with the
//! paper's Alg. 2 (alg:2).
//!
//! The action is a displacement `a` (squashed Gaussian) and a user `m` (categorical), independent
//! given the state ([`crate::head`]). A critic takes `(s, a)` and returns **one value per user**,
//! `Q(s, a, 1..M)`. Wherever Alg. 2 takes an expectation over the policy, the expectation over the
//! user is therefore computed exactly, as a sum; only the displacement is sampled. The
//! temperatures are `alpha` here, as in Haarnoja et al. (2018); the paper calls them `beta`:
//!
//! ```text
//! v(s)     = sum_m pi(m|s) [ min_i Q_i(s, a, m) - alpha_u ln pi(m|s) ] - alpha_d ln pi(a|s),  a ~ pi
//! J_Q      = mean 1/2 ( Q_i(s_n, a_n, m_n) - r - gamma v'(s_{n+1}) )^2                   (eq:Q)
//! J_pi     = mean -v(s_n)                                                              (eq:pi)
//! J_alpha_d = mean -alpha_d ( ln pi(a|s) + H_d )                                     (eq:beta)
//! J_alpha_u = mean  alpha_u ( H(pi(.|s)) - H_u(s) )                                  (eq:beta)
//! theta'   = tau theta + (1 - tau) theta'                                          (eq:theta1)
//! ```
//!
//! Where the setting `entropy_when_forced` excludes a state, its `ln pi(a|s)` is multiplied by 0.
//! `H_d` is the target entropy of the displacement. `H_u(s)` is a fraction of the entropy of a
//! uniform choice among the users that `s` admits. Temperatures are learned through their
//! logarithm. Users that the fairness rule excludes have probability 0 in all these formulae.

use pulp::Arch;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use environment::{Action, Dimensions};

use crate::{
    actor::Dense,
    head::{self, DISPLACEMENT_ROWS, PolicySample, Temperatures},
    learner::{Learner, Losses, States, fill_normal},
    nn::{Activations, Adam, Mlp, padded},
    replay::{Batch, Replay},
    settings::{Algorithm, TrainingSettings},
    temperature::Temperature,
};

/// A network and the state of its optimizer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Trained {
    network: Mlp,
    adam: Adam,
}

impl Trained {
    fn new(sizes: &[usize], rng: &mut Pcg64Mcg) -> Self {
        let network = Mlp::new(sizes, rng);
        let adam = Adam::new(network.parameters().len());
        Self { network, adam }
    }

    fn descend(&mut self, arch: Arch, learning_rate: f32, gradient: &[f32]) {
        let parameters = self.network.parameters_mut();
        self.adam.step(arch, learning_rate, parameters, gradient);
    }
}

/// Everything that is learned: `phi`, `theta_1`, `theta_2`, `theta'_1`, `theta'_2` and the two
/// temperatures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    policy: Trained,
    critics: [Trained; 2],
    targets: [Mlp; 2],
    displacement_temperature: Temperature,
    user_temperature: Temperature,
}

/// The states of a batch: `s_n` or `s_{n+1}`.
#[derive(Clone, Copy, Debug)]
enum Step {
    Current,
    Next,
}

/// Soft actor-critic: the learned state and the work buffers.
#[derive(Debug)]
pub struct Sac {
    state: State,
    settings: TrainingSettings,
    dimensions: Dimensions,
    arch: Arch,
    batch: Batch,
    policy: Activations,
    critics: [Activations; 2],
    sample: PolicySample,
    gradient: Vec<f32>,
    /// `min_i Q_i`, users by samples.
    least: Vec<f32>,
    /// 1 where the smaller value is `Q_1`, 0 where it is `Q_2`.
    first_is_least: Vec<f32>,
    /// `r + gamma v(s')`.
    target: Vec<f32>,
    acting: ActingBuffers,
    losses: [(&'static str, f32); 8],
}

/// Work buffers for acting, sized for the environments that are stepped together.
#[derive(Debug)]
struct ActingBuffers {
    policy: Activations,
    sample: PolicySample,
}

impl Learner for Sac {
    const ALGORITHM: Algorithm = Algorithm::Sac;
    type State = State;

    /// Initializes the networks (Alg. 2, line 1).
    fn new(settings: &TrainingSettings, dimensions: Dimensions, rng: &mut Pcg64Mcg) -> Self {
        let Dimensions { users, observation } = dimensions;
        let h = settings.hidden;
        let policy = Trained::new(&[observation, h, h, head::output_len(users)], rng);
        let critics = [(); 2].map(|()| Trained::new(&[observation + 2, h, h, users], rng));
        let targets = [0, 1].map(|i: usize| critics[i].network.clone());
        let state = State {
            policy,
            critics,
            targets,
            displacement_temperature: Temperature::new(settings.initial_temperature),
            user_temperature: Temperature::new(settings.initial_temperature),
        };
        Self::resume(settings, dimensions, state)
    }

    fn resume(settings: &TrainingSettings, dimensions: Dimensions, state: State) -> Self {
        let n = settings.batch;
        let users = dimensions.users;
        let policy = &state.policy.network;
        let critic = &state.critics[0].network;
        Self {
            settings: settings.clone(),
            dimensions,
            arch: Arch::new(),
            batch: Batch::new(n, dimensions.observation, Self::action_len(users)),
            policy: policy.activations(n),
            critics: [critic.activations(n), critic.activations(n)],
            sample: PolicySample::new(users, n),
            gradient: vec![0.0; policy.parameters().len().max(critic.parameters().len())],
            least: vec![0.0; users * padded(n)],
            first_is_least: vec![0.0; users * padded(n)],
            target: vec![0.0; padded(n)],
            acting: ActingBuffers {
                policy: policy.activations(settings.environments),
                sample: PolicySample::new(users, settings.environments),
            },
            losses: [("", 0.0); 8],
            state,
        }
    }

    fn state(&self) -> &State {
        &self.state
    }

    fn action_len(_users: usize) -> usize {
        2
    }

    /// Samples actions from the policy, `a_n ~ pi(.|s_n)`.
    fn explore(&mut self, states: &States, rng: &mut Pcg64Mcg, actions: &mut [Action]) {
        let ActingBuffers { policy, sample } = &mut self.acting;
        policy.input_mut().copy_from_slice(&states.observation);
        self.state.policy.network.forward(self.arch, policy);
        fill_normal(rng, &mut sample.noise);
        sample.evaluate(policy.output(), &states.admissible);
        for (s, action) in actions.iter_mut().enumerate() {
            let component = |i: usize| sample.displacement[i * states.width + s];
            action.components.clear();
            action.components.extend([component(0), component(1)]);
            action.user = sample.pick_user(s, rng.random());
        }
    }

    /// Performs one gradient step (Alg. 2, "Outer Learning").
    fn learn(&mut self, replay: &Replay, rng: &mut Pcg64Mcg) {
        replay.sample(rng, &mut self.batch);
        self.evaluate_bellman_target(rng);
        let critic_losses = [0, 1].map(|i| self.update_critic(i));
        let policy_loss = self.update_policy(rng);
        self.update_temperatures();
        for (target, critic) in self.state.targets.iter_mut().zip(&self.state.critics) {
            target.soft_update(self.arch, &critic.network, self.settings.tau);
        }
        self.report(critic_losses, policy_loss);
    }

    fn losses(&self) -> &Losses {
        &self.losses
    }

    fn batch(&self) -> &Batch {
        &self.batch
    }

    fn deterministic(&self) -> Vec<Dense> {
        let users = self.dimensions.users;
        let scores = DISPLACEMENT_ROWS..DISPLACEMENT_ROWS + users;
        Dense::of_network(&self.state.policy.network, (0..2).chain(scores))
    }
}

impl Sac {
    fn temperatures(&self) -> Temperatures {
        Temperatures {
            displacement: self.state.displacement_temperature.alpha(),
            user: self.state.user_temperature.alpha(),
        }
    }

    /// Writes `(s, a)` into the input of a critic.
    fn load(activations: &mut Activations, observation: &[f32], action: &[f32]) {
        let (states, actions) = activations.input_mut().split_at_mut(observation.len());
        states.copy_from_slice(observation);
        actions.copy_from_slice(action);
    }

    /// Computes `min_i Q_i` from the outputs of both critics.
    fn take_least(&mut self) {
        let [first, second] = &self.critics;
        let results = self.least.iter_mut().zip(&mut self.first_is_least);
        let values = first.output().iter().zip(second.output());
        for ((least, first_is_least), (&a, &b)) in results.zip(values) {
            (*least, *first_is_least) = if a < b { (a, 1.0) } else { (b, 0.0) };
        }
    }

    /// Samples a displacement per state of the batch from the policy, and evaluates it: by the
    /// critics in the current states, and by the target networks in the next ones.
    fn evaluate_policy(&mut self, step: Step, rng: &mut Pcg64Mcg) {
        let (batch, state) = (&self.batch, &self.state);
        let (observation, admissible, entropy_mask, networks) = match step {
            Step::Current => (
                &batch.observation,
                &batch.admissible,
                &batch.entropy_mask,
                state.critics.each_ref().map(|critic| &critic.network),
            ),
            Step::Next => (
                &batch.next_observation,
                &batch.next_admissible,
                &batch.next_entropy_mask,
                state.targets.each_ref(),
            ),
        };
        self.policy.input_mut().copy_from_slice(observation);
        state.policy.network.forward(self.arch, &mut self.policy);
        fill_normal(rng, &mut self.sample.noise);
        self.sample.evaluate(self.policy.output(), admissible);
        self.sample.entropy_mask.copy_from_slice(entropy_mask);
        for (network, activations) in networks.into_iter().zip(&mut self.critics) {
            Self::load(activations, observation, &self.sample.displacement);
            network.forward(self.arch, activations);
        }
        self.take_least();
    }

    /// Computes `r + gamma v(s_{n+1})`, the target in eq:Q.
    fn evaluate_bellman_target(&mut self, rng: &mut Pcg64Mcg) {
        self.evaluate_policy(Step::Next, rng);
        let alpha = self.temperatures();
        for s in 0..self.batch.len {
            let value = -self.sample.soft_cost(&self.least, alpha, s);
            self.target[s] =
                self.batch.reward[s] + self.settings.discount * self.batch.follows[s] * value;
        }
    }

    /// Minimizes eq:Q for critic `i` and returns the loss.
    fn update_critic(&mut self, i: usize) -> f32 {
        let (critic, activations) = (&mut self.state.critics[i], &mut self.critics[i]);
        Self::load(activations, &self.batch.observation, &self.batch.action);
        critic.network.forward(self.arch, activations);
        let width = self.batch.width;
        let per_sample = 1.0 / self.batch.len as f32;
        let (values, gradient) = activations.loss();
        gradient.fill(0.0);
        let mut loss = 0.0;
        for s in 0..self.batch.len {
            let at = usize::from(self.batch.user[s]) * width + s;
            let error = values[at] - self.target[s];
            loss += 0.5 * error * error * per_sample;
            gradient[at] = error * per_sample;
        }
        let gradient = &mut self.gradient[..critic.network.parameters().len()];
        critic
            .network
            .backward(self.arch, activations, Some(gradient), 0..0);
        critic.descend(self.arch, self.settings.critic_learning_rate, gradient);
        loss
    }

    /// Minimizes eq:pi and returns the loss. The gradient of the displacement is back-propagated
    /// through the critic that has the smaller value.
    fn update_policy(&mut self, rng: &mut Pcg64Mcg) -> f32 {
        self.evaluate_policy(Step::Current, rng);
        let alpha = self.temperatures();
        let (len, width) = (self.batch.len, self.batch.width);
        let per_sample = 1.0 / len as f32;
        let loss = (0..len)
            .map(|s| self.sample.soft_cost(&self.least, alpha, s) * per_sample)
            .sum();

        // d/da sum_m pi(m|s) min_i Q_i(s, a, m): the rows of a follow those of s in the input.
        let start = self.dimensions.observation;
        let [first, second] = &mut self.critics;
        let gradients = first
            .output_gradient_mut()
            .iter_mut()
            .zip(second.output_gradient_mut());
        let user_prob = self.sample.user_prob.iter().zip(&self.first_is_least);
        for ((first, second), (user_prob, first_is_least)) in gradients.zip(user_prob) {
            *first = user_prob * per_sample * first_is_least;
            *second = user_prob * per_sample * (1.0 - first_is_least);
        }
        for (critic, activations) in self.state.critics.iter().zip(&mut self.critics) {
            critic
                .network
                .backward(self.arch, activations, None, start..start + 2);
        }
        let [first, second] = &mut self.critics;
        let slope = first.input_gradient_mut();
        for (sum, more) in slope[..2 * width].iter_mut().zip(second.input_gradient()) {
            *sum += more;
        }

        let output = self.policy.output_gradient_mut();
        self.sample.gradient(&self.least, slope, alpha, len, output);
        let policy = &mut self.state.policy;
        let gradient = &mut self.gradient[..policy.network.parameters().len()];
        policy
            .network
            .backward(self.arch, &mut self.policy, Some(gradient), 0..0);
        policy.descend(self.arch, self.settings.policy_learning_rate, gradient);
        loss
    }

    /// Minimizes eq:beta on the states and displacements of the policy update.
    fn update_temperatures(&mut self) {
        let per_sample = 1.0 / self.batch.len as f32;
        let (mut displacement, mut user) = (0.0, 0.0);
        for s in 0..self.batch.len {
            let surplus = -(self.sample.log_prob[s] + self.settings.displacement_entropy);
            displacement += self.sample.entropy_mask[s] * surplus;
            user += self.sample.user_entropy[s]
                - self.settings.user_entropy_fraction * self.sample.uniform_entropy[s];
        }
        let rate = self.settings.temperature_learning_rate;
        let state = &mut self.state;
        state
            .displacement_temperature
            .descend(self.arch, rate, displacement * per_sample);
        state
            .user_temperature
            .descend(self.arch, rate, user * per_sample);
    }

    fn report(&mut self, critic_losses: [f32; 2], policy_loss: f32) {
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let n = self.batch.len;
        let alpha = self.temperatures();
        self.losses = [
            ("losses/qf1_loss", critic_losses[0]),
            ("losses/qf2_loss", critic_losses[1]),
            ("losses/qf_target", mean(&self.target[..n])),
            ("losses/actor_loss", policy_loss),
            ("losses/alpha_displacement", alpha.displacement),
            ("losses/alpha_user", alpha.user),
            (
                "losses/entropy_displacement",
                -mean(&self.sample.log_prob[..n]),
            ),
            ("losses/entropy_user", mean(&self.sample.user_entropy[..n])),
        ];
    }
}

#[cfg(test)]
mod tests;
