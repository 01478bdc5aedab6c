//! The planner as a policy: a decision, after a correction of the plan for the position.
#![no_std]
#![no_main]

use firmware_core::{
    USERS_MAX,
    policy::{Action, Observation, Policy},
};
use panics::Planner;

#[unsafe(no_mangle)]
pub fn entry(planner: &mut Planner, observation: &Observation<'_, f32>) -> Action<f32, USERS_MAX> {
    planner.decide(observation)
}
