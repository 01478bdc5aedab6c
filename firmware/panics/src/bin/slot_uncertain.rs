//! The slot problem with error statistics: closed form, coefficients and MSE, and gains within bounds.
#![no_std]
#![no_main]

use firmware_core::{
    PowerGain, SENSORS_MAX,
    inner::{
        ExactSolver, SlotAllocation, SlotError, SlotLimits, UncertainWorkspace,
        bounded::{GainBounds, Guarantee},
    },
    uncertainty::{SensorUncertainty, Uncertainty, UncertaintyError},
};
use panics as _;

type Slot = Result<SlotAllocation<f32>, SlotError<f32>>;

#[unsafe(no_mangle)]
pub fn entry(
    workspace: &mut UncertainWorkspace<f32, SENSORS_MAX>,
    limits: &SlotLimits<f32>,
    (amplitude_gains, bounds): (&[f32], &[GainBounds<f32>]),
    (user, user_bounds): (Option<PowerGain<f32>>, Option<GainBounds<f32>>),
    statistics: &mut [SensorUncertainty<f32>],
    (sensor_error_variance, phase_error_rad, user_error_variance): (f32, f32, f32),
    coefficients: &mut [f32],
) -> Result<(Slot, Result<Guarantee<f32>, SlotError<f32>>), UncertaintyError<f32>> {
    let sensor = SensorUncertainty::with_phase_error(sensor_error_variance, phase_error_rad)?;
    statistics.fill(sensor);
    let uncertainty = Uncertainty::<f32, SENSORS_MAX>::new(statistics, user_error_variance)?;
    let uncertainty = uncertainty.of_slot();
    let slot = workspace
        .sensors_of_amplitude(limits, amplitude_gains, &uncertainty)
        .and_then(|field| field.allocate(&ExactSolver, amplitude_gains, user, coefficients));
    let guarantee = workspace.guarantee(limits, bounds, user_bounds, &uncertainty);
    Ok((slot, guarantee))
}
