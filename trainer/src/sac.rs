//! Soft actor-critic with a hybrid action: Alg. 2 of the paper, to be read beside it.
//!
//! The action is a displacement `a` (squashed Gaussian) and a user `m` (categorical), independent
//! given the state ([`crate::head`]). A critic takes `(s, a)` and answers with **one value per
//! user**, `Q(s, a, 1..M)`. So wherever Alg. 2 takes an expectation over the policy, that over
//! the user is a sum and exact; only the displacement is sampled:
//!
//! ```text
//! v(s)     = sum_m pi(m|s) [ min_i Q_i(s, a, m) - beta_u ln pi(m|s) ] - beta_d ln pi(a|s),  a ~ pi
//! J_Q      = mean 1/2 ( Q_i(s_n, a_n, m_n) - r - gamma v'(s_{n+1}) )^2                   (eq:Q)
//! J_pi     = mean -v(s_n)                                                              (eq:pi)
//! J_beta_d = mean -beta_d ( ln pi(a|s) + H_d )                                       (eq:beta)
//! J_beta_u = mean  beta_u ( H(pi(.|s)) - H_u(s) )                                    (eq:beta)
//! theta'   = tau theta + (1 - tau) theta'                                          (eq:theta1)
//! ```
//!
//! The `ln pi(a|s)` count only where the settings count them (`entropy_when_forced`). `H_d` is
//! the displacement's target entropy and `H_u(s)` a fraction of that of an even choice
//! among the users that `s` admits. Temperatures are learned through their logarithm. Users that
//! the fairness rule excludes have probability 0 in every one of these lines.

use pulp::Arch;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::{
    actor::Dense,
    head::{self, DISPLACEMENT_ROWS, Draw, Temperatures},
    learner::{Choice, Dimensions, Learner, Losses, States, fill_normal},
    nn::{Adam, Mlp, Trace, exp, padded},
    replay::{Batch, Replay},
    settings::{Algorithm, Settings},
};

/// A network and the state of its optimiser.
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

/// `beta`, learned through its logarithm so that it stays positive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Temperature {
    log: f32,
    adam: Adam,
}

impl Temperature {
    fn new(initial: f32) -> Self {
        Self {
            log: crate::nn::ln(initial),
            adam: Adam::new(1),
        }
    }

    /// `surplus`: entropy above its target, which makes `beta` fall.
    fn descend(&mut self, arch: Arch, learning_rate: f32, surplus: f32) {
        let gradient = exp(self.log) * surplus;
        let log = std::slice::from_mut(&mut self.log);
        self.adam.step(arch, learning_rate, log, &[gradient]);
    }
}

/// `phi`, `theta_1`, `theta_2`, `theta'_1`, `theta'_2` and the two `beta`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    policy: Trained,
    critics: [Trained; 2],
    targets: [Mlp; 2],
    displacement_temperature: Temperature,
    user_temperature: Temperature,
}

/// Soft actor-critic: the networks, and room to work in.
#[derive(Debug)]
pub struct Sac {
    state: State,
    settings: Settings,
    dimensions: Dimensions,
    arch: Arch,
    batch: Batch,
    policy: Trace,
    critics: [Trace; 2],
    draw: Draw,
    gradient: Vec<f32>,
    /// `min_i Q_i`, users by samples.
    least: Vec<f32>,
    /// 1 where that is `Q_1`, 0 where it is `Q_2`.
    first_is_least: Vec<f32>,
    /// `r + gamma v(s')`.
    target: Vec<f32>,
    acting: Acting,
    losses: [(&'static str, f32); 8],
}

/// Room to act in a few states at a time.
#[derive(Debug)]
struct Acting {
    policy: Trace,
    draw: Draw,
}

impl Learner for Sac {
    const ALGORITHM: Algorithm = Algorithm::Sac;
    type State = State;

    /// Alg. 2, line 1.
    fn new(settings: &Settings, dimensions: Dimensions, rng: &mut Pcg64Mcg) -> Self {
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

    fn resume(settings: &Settings, dimensions: Dimensions, state: State) -> Self {
        let n = settings.batch;
        let users = dimensions.users;
        let policy = &state.policy.network;
        let critic = &state.critics[0].network;
        Self {
            settings: settings.clone(),
            dimensions,
            arch: Arch::new(),
            batch: Batch::new(n, dimensions.observation, Self::action_len(users)),
            policy: Trace::new(policy, n),
            critics: [Trace::new(critic, n), Trace::new(critic, n)],
            draw: Draw::new(users, n),
            gradient: vec![0.0; policy.parameters().len().max(critic.parameters().len())],
            least: vec![0.0; users * padded(n)],
            first_is_least: vec![0.0; users * padded(n)],
            target: vec![0.0; padded(n)],
            acting: Acting {
                policy: Trace::new(policy, settings.environments),
                draw: Draw::new(users, settings.environments),
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

    /// Sample action from policy, `a_n ~ pi(.|s_n)`.
    fn explore(&mut self, states: &States, rng: &mut Pcg64Mcg, choices: &mut [Choice]) {
        let Acting { policy, draw } = &mut self.acting;
        policy.input_mut().copy_from_slice(&states.observation);
        self.state.policy.network.forward(self.arch, policy);
        fill_normal(rng, &mut draw.noise);
        draw.evaluate(policy.output(), &states.admissible);
        for (s, choice) in choices.iter_mut().enumerate() {
            let component = |i: usize| draw.displacement[i * states.width + s];
            choice.action.clear();
            choice.action.extend([component(0), component(1)]);
            choice.user = draw.pick_user(s, rng.random());
        }
    }

    /// Alg. 2, "Outer Learning".
    fn learn(&mut self, replay: &Replay, rng: &mut Pcg64Mcg) {
        replay.sample(rng, &mut self.batch);
        self.evaluate_bellman_target(rng);
        let critic_losses = [0, 1].map(|i| self.update_critic(i));
        let policy_loss = self.update_policy(rng);
        self.update_temperatures();
        for (target, critic) in self.state.targets.iter_mut().zip(&self.state.critics) {
            target.follow(self.arch, &critic.network, self.settings.target_rate);
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
            displacement: exp(self.state.displacement_temperature.log),
            user: exp(self.state.user_temperature.log),
        }
    }

    /// Puts `(s, a)` into a critic's trace.
    fn load(trace: &mut Trace, observation: &[f32], action: &[f32]) {
        let (states, actions) = trace.input_mut().split_at_mut(observation.len());
        states.copy_from_slice(observation);
        actions.copy_from_slice(action);
    }

    /// `min_i Q_i` over the two traces' outputs.
    fn take_least(&mut self) {
        let [first, second] = &self.critics;
        let results = self.least.iter_mut().zip(&mut self.first_is_least);
        let values = first.output().iter().zip(second.output());
        for ((least, first_is_least), (&a, &b)) in results.zip(values) {
            (*least, *first_is_least) = if a < b { (a, 1.0) } else { (b, 0.0) };
        }
    }

    /// `r + gamma v(s_{n+1})`, the inner bracket of eq:Q.
    fn evaluate_bellman_target(&mut self, rng: &mut Pcg64Mcg) {
        self.policy
            .input_mut()
            .copy_from_slice(&self.batch.next_observation);
        self.state
            .policy
            .network
            .forward(self.arch, &mut self.policy);
        fill_normal(rng, &mut self.draw.noise);
        self.draw
            .evaluate(self.policy.output(), &self.batch.next_admissible);
        self.draw.choice.copy_from_slice(&self.batch.next_choice);
        for (target, trace) in self.state.targets.iter().zip(&mut self.critics) {
            Self::load(trace, &self.batch.next_observation, &self.draw.displacement);
            target.forward(self.arch, trace);
        }
        self.take_least();
        let temperatures = self.temperatures();
        for s in 0..self.batch.len {
            let value = -self.draw.soft_cost(&self.least, temperatures, s);
            self.target[s] =
                self.batch.reward[s] + self.settings.discount * self.batch.follows[s] * value;
        }
    }

    /// eq:Q for critic `i`; returns the loss.
    fn update_critic(&mut self, i: usize) -> f32 {
        let (critic, trace) = (&mut self.state.critics[i], &mut self.critics[i]);
        Self::load(trace, &self.batch.observation, &self.batch.action);
        critic.network.forward(self.arch, trace);
        let width = self.batch.width;
        let share = 1.0 / self.batch.len as f32;
        let (values, gradient) = trace.loss();
        gradient.fill(0.0);
        let mut loss = 0.0;
        for s in 0..self.batch.len {
            let at = usize::from(self.batch.user[s]) * width + s;
            let error = values[at] - self.target[s];
            loss += 0.5 * error * error * share;
            gradient[at] = error * share;
        }
        let gradient = &mut self.gradient[..critic.network.parameters().len()];
        critic
            .network
            .backward(self.arch, trace, Some(gradient), 0..0);
        critic.descend(self.arch, self.settings.critic_learning_rate, gradient);
        loss
    }

    /// eq:pi; returns the loss. The displacement's gradient comes through both critics, each
    /// where it is the smaller.
    fn update_policy(&mut self, rng: &mut Pcg64Mcg) -> f32 {
        self.policy
            .input_mut()
            .copy_from_slice(&self.batch.observation);
        self.state
            .policy
            .network
            .forward(self.arch, &mut self.policy);
        fill_normal(rng, &mut self.draw.noise);
        self.draw
            .evaluate(self.policy.output(), &self.batch.admissible);
        self.draw.choice.copy_from_slice(&self.batch.choice);
        for (critic, trace) in self.state.critics.iter().zip(&mut self.critics) {
            Self::load(trace, &self.batch.observation, &self.draw.displacement);
            critic.network.forward(self.arch, trace);
        }
        self.take_least();
        let temperatures = self.temperatures();
        let (len, width) = (self.batch.len, self.batch.width);
        let share = 1.0 / len as f32;
        let loss = (0..len)
            .map(|s| self.draw.soft_cost(&self.least, temperatures, s) * share)
            .sum();

        // d/da sum_m pi(m|s) min_i Q_i(s, a, m): rows of a follow those of s in the input.
        let start = self.dimensions.observation;
        let [first, second] = &mut self.critics;
        let gradients = first
            .output_gradient_mut()
            .iter_mut()
            .zip(second.output_gradient_mut());
        let probability = self.draw.probability.iter().zip(&self.first_is_least);
        for ((first, second), (probability, first_is_least)) in gradients.zip(probability) {
            *first = probability * share * first_is_least;
            *second = probability * share * (1.0 - first_is_least);
        }
        for (critic, trace) in self.state.critics.iter().zip(&mut self.critics) {
            critic
                .network
                .backward(self.arch, trace, None, start..start + 2);
        }
        let [first, second] = &mut self.critics;
        let slope = first.input_gradient_mut();
        for (sum, more) in slope[..2 * width].iter_mut().zip(second.input_gradient()) {
            *sum += more;
        }

        let output = self.policy.output_gradient_mut();
        self.draw
            .gradient(&self.least, slope, temperatures, len, output);
        let policy = &mut self.state.policy;
        let gradient = &mut self.gradient[..policy.network.parameters().len()];
        policy
            .network
            .backward(self.arch, &mut self.policy, Some(gradient), 0..0);
        policy.descend(self.arch, self.settings.policy_learning_rate, gradient);
        loss
    }

    /// eq:beta, on the states and displacements of the policy update.
    fn update_temperatures(&mut self) {
        let share = 1.0 / self.batch.len as f32;
        let (mut displacement, mut user) = (0.0, 0.0);
        for s in 0..self.batch.len {
            let surplus = -(self.draw.log_density[s] + self.settings.displacement_entropy);
            displacement += self.draw.choice[s] * surplus;
            user += self.draw.user_entropy[s]
                - self.settings.user_entropy_fraction * self.draw.even_entropy[s];
        }
        let rate = self.settings.temperature_learning_rate;
        let state = &mut self.state;
        state
            .displacement_temperature
            .descend(self.arch, rate, displacement * share);
        state
            .user_temperature
            .descend(self.arch, rate, user * share);
    }

    fn report(&mut self, critic_losses: [f32; 2], policy_loss: f32) {
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let n = self.batch.len;
        let temperatures = self.temperatures();
        self.losses = [
            ("losses/qf1_loss", critic_losses[0]),
            ("losses/qf2_loss", critic_losses[1]),
            ("losses/qf_target", mean(&self.target[..n])),
            ("losses/actor_loss", policy_loss),
            ("losses/alpha_displacement", temperatures.displacement),
            ("losses/alpha_user", temperatures.user),
            (
                "losses/entropy_displacement",
                -mean(&self.draw.log_density[..n]),
            ),
            ("losses/entropy_user", mean(&self.draw.user_entropy[..n])),
        ];
    }
}

#[cfg(test)]
mod tests;
