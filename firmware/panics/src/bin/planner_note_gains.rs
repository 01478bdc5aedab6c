//! The planner as a policy: measured gains.
#![no_std]
#![no_main]

use firmware_core::{
    USERS_MAX,
    policy::{MeasuredGains, Policy},
};
use panics::Planner;

#[unsafe(no_mangle)]
pub fn entry(planner: &mut Planner, gains: &MeasuredGains<'_, f32>) {
    Policy::<f32, USERS_MAX>::note_gains(planner, gains);
}
