//! The slot problem in closed form, in double precision.
#![no_std]
#![no_main]

use firmware_core::{
    PowerGain, SENSORS_MAX,
    inner::{SlotError, SlotLimits, Solution, Workspace},
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    workspace: &mut Workspace<f64, SENSORS_MAX>,
    limits: &SlotLimits<f64>,
    sensors: &[PowerGain<f64>],
    user: Option<PowerGain<f64>>,
) -> Result<Solution<f64>, SlotError<f64>> {
    workspace.sensors(limits, sensors)?.solve(user)
}
