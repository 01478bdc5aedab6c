//! The slot problem in closed form.
#![no_std]
#![no_main]

use firmware_core::{
    PowerGain, SENSORS_MAX,
    inner::{SlotError, SlotLimits, Solution, Workspace},
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    workspace: &mut Workspace<f32, SENSORS_MAX>,
    limits: &SlotLimits<f32>,
    sensors: &[PowerGain<f32>],
    user: Option<PowerGain<f32>>,
) -> Result<Solution<f32>, SlotError<f32>> {
    workspace.sensors(limits, sensors)?.solve(user)
}
