//! The Markov decision process (MDP) of Sec. V-A: the environment in which policies are trained.
//!
//! An [`Environment`] flies one mission, slot by slot. Shield, fairness rule, channel model, slot
//! solution and MSE are those of `firmware-core`, so the environment that trains is the
//! environment that flies; only the reward is defined in this crate.
//!
//! | module | content |
//! |---|---|
//! | `mdp` | [`Environment`]: reset, observe, step |
//! | `action` | [`Action`], and [`UserSet`] for the users that a state admits |
//! | `normalizer` | [`Normalizer`] and [`Dimensions`]: scaling and size of the observation |
//! | `settings` | [`EnvironmentSettings`]: reward weights, constraint handling, power allocation |
//! | `outcome` | [`Step`], [`Reward`], [`StepResult`], [`Episode`]: what the environment reports |
//! | `relaxation` | [`ValueToGo`]: the value function of the relaxed mission, for reward shaping |

#![deny(missing_docs)]

mod action;
mod mdp;
mod normalizer;
mod outcome;
mod relaxation;
mod settings;
#[cfg(test)]
mod tests;

pub use action::{Action, UserSet};
pub use mdp::Environment;
pub use normalizer::{Dimensions, Normalizer};
pub use outcome::{Episode, Reward, Step, StepResult};
pub use relaxation::ValueToGo;
pub use settings::{Constraints, EnvironmentSettings};
