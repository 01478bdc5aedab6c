//! A decision of the policy for any mission: observation, features and network.
#![no_std]
#![no_main]

use firmware_core::{
    USERS_MAX,
    policy::{Action, Observation, Policy},
};
use panics::AnyMission;

#[unsafe(no_mangle)]
pub fn entry(
    policy: &mut AnyMission,
    observation: &Observation<'_, f32>,
) -> Action<f32, USERS_MAX> {
    policy.decide(observation)
}
