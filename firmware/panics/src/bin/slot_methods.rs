//! The slot problem by any method, Alg. 1 among them, with coefficients and MSE.
#![no_std]
#![no_main]

use firmware_core::PowerGain;
use firmware_core::inner::{Method, SensorField, SlotAllocation, SlotError};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    field: &SensorField<'_, f32>,
    method: &Method<f32>,
    amplitude_gains: &[f32],
    user: Option<PowerGain<f32>>,
    coefficients: &mut [f32],
) -> Result<SlotAllocation<f32>, SlotError<f32>> {
    field.allocate(method, amplitude_gains, user, coefficients)
}
