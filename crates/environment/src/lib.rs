//! The Markov decision process (MDP) of Sec. V-A: the environment in which policies are trained.
//!
//! An [`Environment`] flies one mission, slot by slot. Shield, fairness rule, channel model, slot
//! solution and MSE are those of `firmware-core`, so the environment that trains is the
//! environment that flies; only the reward is defined in this crate.
//!
//! | module | content |
//! |---|---|
//! | `mdp` | [`Environment`]: reset, observe, step; [`EpisodeState`] |
//! | `gains` | the gains of all nodes at once, with vector instructions (feature `simd`) |
//! | `action` | [`Action`], and [`UserSet`] for the users that a state admits |
//! | `normalizer` | [`Normalizer`] and [`Dimensions`]: scaling and size of the observation |
//! | `settings` | [`EnvironmentSettings`]: reward weights, constraint handling, power allocation |
//! | `outcome` | [`Step`], [`Reward`], [`StepResult`], [`Episode`]: what the environment reports |
//! | `relaxation` | [`ValueToGo`]: the value function of the relaxed mission, for reward shaping |
//!
//! # Example
//!
//! One episode with the same action in every slot:
//!
//! ```
//! use environment::{Action, Environment, EnvironmentSettings};
//! use scenario::Scenario;
//!
//! let scenario = Scenario::shipped("separated").expect("a shipped scenario");
//! let mut environment = Environment::new(scenario.mission, &EnvironmentSettings::default());
//! let mut observation = vec![0.0; environment.dimensions().observation];
//! environment.reset();
//! loop {
//!     environment.observe(&mut observation);
//!     // The lowest admissible user is served; half of the largest displacement, north-east.
//!     let user = environment.admissible().trailing_zeros() as usize;
//!     let components = vec![0.5, 0.5];
//!     if environment.step(&Action { components, user }).last {
//!         break;
//!     }
//! }
//! assert!(environment.episode().arrived && environment.episode().fair);
//! ```

#![deny(missing_docs)]

mod action;
mod allocation;
#[cfg(all(feature = "simd", target_arch = "x86_64"))]
mod gains;
mod mdp;
mod normalizer;
mod outcome;
mod relaxation;
mod settings;
#[cfg(test)]
mod tests;

pub use action::{Action, UserSet};
pub use allocation::Allocation;
pub use mdp::{Environment, EpisodeState};
pub use normalizer::{Dimensions, Normalizer};
pub use outcome::{Episode, Reward, Step, StepResult};
pub use relaxation::ValueToGo;
pub use settings::{Constraints, EnvironmentSettings};
