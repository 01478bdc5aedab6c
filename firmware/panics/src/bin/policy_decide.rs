//! The network of a trained policy.
#![no_std]
#![no_main]

use firmware_core::{
    USERS_MAX,
    policy::{Action, Observation, Policy},
};
use panics::Trained;

#[unsafe(no_mangle)]
pub fn entry(policy: &mut Trained, observation: &Observation<'_, f32>) -> Action<f32, USERS_MAX> {
    policy.decide(observation)
}
