//! SAC for the policy for any mission (`trainer train --missions random --algorithm sac`).
//!
//! The policy is the network of [`imitation`](crate::imitation). Each episode is a new mission of the
//! same distribution, in the environment that trains policies of one mission
//! ([`environment`]), with the prices of the onboard planner and with value shaping. Rewards are in
//! units of the mean rate of a slot of the mission's plan, so that missions count alike.
//!
//! The network computes a displacement `v(s)` (units of the way of a slot, at most 1 long) and a
//! score per user. The stochastic policy is
//!
//! ```text
//! u = v(s) + sigma epsilon,   epsilon ~ N(0, I),   a = u / max(1, ||u||)
//! pi(m|s) = softmax of the scores over the admissible users, 0 for the others
//! ```
//!
//! `sigma` is one learned number, which is not exported: the vehicle flies `v(s)` and the user with
//! the highest score. One number is enough because reflections exchange the two components
//! ([`symmetry`](crate::imitation::symmetry)), and because sigma only says how far from its own
//! flights the policy looks. The entropy of `u` is then the same in every state, so it has no effect
//! on which action is best and is left out of the values; it decides sigma alone.
//!
//! The critics ([`Heads::Critic`](crate::nn::sets::Heads)) take the state, with `a` as two more
//! features of the mission, and return a value per user, so expectations over users are exact sums,
//! as in [`sac`](crate::sac):
//!
//! ```text
//! v(s)    = sum_m pi(m|s) [ min_i Q'_i(s, a, m) - alpha_u ln pi(m|s) ],  a ~ pi
//! J_Q     = mean h( Q_i(s_n, a_n, m_n) - r - gamma v(s_{n+1}) ),  h of Huber           (eq:Q)
//! J_pi    = mean sum_m pi(m|s) [ alpha_u ln pi(m|s) - min_i Q_i(s, a, m) ] + w J_imitation
//! J_sigma = -mean sum_m pi(m|s) min_i Q_i(s, v + sigma epsilon, m) - 2 alpha_d ln sigma
//! ```
//!
//! `w` is the setting `imitation_weight`: the loss of imitation on planned missions, which keeps the
//! policy where the critics are not yet right.
//!
//! | module | content |
//! |---|---|
//! | [`settings`] | all settings of a run |
//! | [`task`] | a mission with the planner's prices and the value function of its relaxation |
//! | [`episode`] | a flown mission |
//! | [`memory`] | the missions that are learned from, and transitions drawn from them |
//! | [`distribution`] | the stochastic policy in a state, and the gradient of its value |
//! | [`chunk`] | transitions as inputs of the networks |
//! | [`networks`] | actor, critics and targets |
//! | [`learner`] | a gradient step |
//! | [`run`] | a run: start, resume, train, save |

pub mod chunk;
pub mod distribution;
pub mod episode;
pub mod learner;
pub mod memory;
pub mod networks;
pub mod run;
pub mod settings;
pub mod task;
#[cfg(test)]
mod tests;
