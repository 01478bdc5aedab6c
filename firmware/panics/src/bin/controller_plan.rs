//! `Controller::plan` with a trained policy.
#![no_std]
#![no_main]

use firmware_core::{
    Position,
    controller::{ControllerError, Plan},
};
use panics::TrainedController;

#[unsafe(no_mangle)]
pub fn entry(
    controller: &mut TrainedController,
    measured: Position<f32>,
) -> Result<Plan<f32>, ControllerError> {
    controller.plan(measured)
}
