//! Training of policies for the outer problem: SAC and DDPG over the onboard controller.
//!
//! The environment is the crate [`environment`], which uses the shield, channel model and slot
//! solution of `firmware-core`.
//!
//! | module | content |
//! |---|---|
//! | [`settings`] | all settings of a run, with the paper's values marked |
//! | [`sac`], [`ddpg`] | the learning algorithms; [`head`] is SAC's hybrid action |
//! | [`temperature`] | SAC's temperatures |
//! | [`imitation`] | one policy for any mission, which imitates the planner |
//! | [`reinforcement`] | the same policy, improved by SAC |
//! | [`any_mission`] | the checkpoints of both |
//! | [`record`] | what the runs for any mission have in common |
//! | [`learner`] | the interface of a learning algorithm |
//! | [`replay`] | the replay memory |
//! | [`nn`] | layers, back-propagation, Adam |
//! | [`overlay`] | settings that a file changes |
//! | [`training`] | a run: start, resume, train, evaluate, save |
//! | [`metrics`], [`tensorboard`], [`checkpoint`], [`run`] | the files of a run |
//! | [`sweep`] | many runs, described by one file, on one machine or on many |
//! | [`actor`], [`onnx`] | the resulting policy and its files |
//! | [`evaluate`], [`compare`], [`card`], [`curves`] | evaluation flights, comparison tables, model cards, learning curves |

#![deny(missing_docs)]

pub mod actor;
pub mod any_mission;
pub mod card;
pub mod checkpoint;
pub mod compare;
pub mod curves;
pub mod ddpg;
pub mod evaluate;
#[cfg(test)]
mod fixture;
pub mod head;
pub mod imitation;
pub mod learner;
pub mod metrics;
pub mod nn;
pub mod onnx;
pub mod overlay;
mod progress_bar;
pub mod record;
pub mod reinforcement;
pub mod replay;
mod rollout;
pub mod run;
pub mod sac;
pub mod settings;
pub mod sweep;
pub mod temperature;
pub mod tensorboard;
pub mod training;
