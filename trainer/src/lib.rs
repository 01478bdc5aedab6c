//! Learning for the outer problem: SAC and DDPG over the onboard controller.
//!
//! | module | answers |
//! |---|---|
//! | [`settings`] | what can be set, and which of it is the paper's |
//! | [`env`](mod@env) | the MDP, on firmware-core's own shield, channel and slot solution |
//! | [`sac`], [`ddpg`] | how the networks learn; [`head`] is SAC's hybrid action |
//! | [`relaxation`] | what is still to be had from a place, for value shaping |
//! | [`replay`] | the memory |
//! | [`nn`] | layers, back-propagation, Adam |
//! | [`training`] | the loop, [`metrics`], [`tensorboard`], [`checkpoint`]; [`run`] is what it leaves |
//! | [`actor`], [`onnx`] | the policy that results, and its files |
//! | [`evaluate`], [`compare`], [`card`] | what it comes to in flight, and what is said of it |

pub mod actor;
pub mod card;
pub mod checkpoint;
pub mod compare;
pub mod ddpg;
pub mod env;
pub mod evaluate;
#[cfg(test)]
mod fixture;
pub mod head;
pub mod learner;
pub mod metrics;
pub mod nn;
pub mod onnx;
pub mod relaxation;
pub mod replay;
pub mod run;
pub mod sac;
pub mod settings;
pub mod tensorboard;
pub mod training;
