//! Imitation of the planner by one network for any mission (`trainer train --missions random`).
//!
//! Missions are drawn from the distribution of `scenario random` and planned by the onboard planner.
//! The network learns the planner's waypoint and user in every slot, also from positions beside the
//! planned path and from the states that it flies to itself (DAgger: Ross, Gordon and Bagnell, 2011).
//!
//! | module | content |
//! |---|---|
//! | [`settings`] | all settings of a run |
//! | [`card`] | the model card |
//! | [`demonstration`] | a planned mission as examples |
//! | [`mission_queue`] | missions from threads in the background, in an order that depends on nothing else |
//! | [`symmetry`] | reflections of a mission |
//! | [`encoder`] | a state as inputs of the network |
//! | [`sample`] | an example as inputs and label, reflected and disturbed |
//! | [`loss`] | the loss |
//! | [`policy`] | the network as a policy that flies |
//! | [`held_out`] | evaluation on missions that are not learned from |
//! | [`states`] | random states of random missions |
//! | [`trained`] | a trained network with its origin, and its `.policy` file |
//! | [`run`] | a run: start, resume, train, evaluate, save |

pub mod card;
pub mod demonstration;
pub mod encoder;
pub mod held_out;
pub mod loss;
pub mod mission_queue;
pub mod policy;
pub mod run;
pub mod sample;
pub mod settings;
pub mod states;
pub mod symmetry;
#[cfg(test)]
mod tests;
pub mod trained;
