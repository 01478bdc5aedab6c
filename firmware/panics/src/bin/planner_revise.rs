//! The planner as a policy: a change of the mission.
#![no_std]
#![no_main]

use firmware_core::{USERS_MAX, mission::MissionChange, policy::Policy};
use panics::Planner;

#[unsafe(no_mangle)]
pub fn entry(planner: &mut Planner, change: &MissionChange<f32>, slots_begun: u32) {
    Policy::<f32, USERS_MAX>::revise(planner, change, slots_begun);
}
