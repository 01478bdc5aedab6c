//! The slot problem for gains within bounds.
#![no_std]
#![no_main]

use firmware_core::{
    SENSORS_MAX,
    inner::{
        SlotError, SlotLimits, Workspace,
        bounded::{GainBounds, Guarantee},
    },
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    workspace: &mut Workspace<f32, SENSORS_MAX>,
    limits: &SlotLimits<f32>,
    sensors: &[GainBounds<f32>],
    user: Option<GainBounds<f32>>,
) -> Result<Guarantee<f32>, SlotError<f32>> {
    workspace.guarantee(limits, sensors, user)
}
