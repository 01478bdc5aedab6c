//! `Controller::allocate_predicted`.
#![no_std]
#![no_main]

use firmware_core::{
    Position, SENSORS_MAX,
    controller::{ControllerError, SlotCommand},
};
use panics::TrainedController;

#[unsafe(no_mangle)]
pub fn entry(
    controller: &mut TrainedController,
    measured: &Position<f32>,
) -> Result<SlotCommand<f32, SENSORS_MAX>, ControllerError> {
    controller.allocate_predicted(measured)
}
