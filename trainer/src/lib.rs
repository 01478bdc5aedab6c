//! Learning for the outer problem: SAC and DDPG over the onboard controller.
//!
//! | module | answers |
//! |---|---|
//! | [`settings`] | what can be set, and which of it is the paper's |
//! | [`sac`], [`ddpg`] | how the networks learn; [`head`] is SAC's hybrid action |
//! | [`replay`] | the memory |
//! | [`nn`] | layers, back-propagation, Adam |

pub mod actor;
pub mod env;
pub mod head;
pub mod learner;
pub mod nn;
pub mod replay;
pub mod sac;
pub mod settings;
