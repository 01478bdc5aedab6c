//! `Controller::allocate`.
#![no_std]
#![no_main]

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    controller::{ChannelState, ControllerError, SlotCommand},
};
use panics::TrainedController;

#[unsafe(no_mangle)]
pub fn entry(
    controller: &mut TrainedController,
    state: &ChannelState<f32, USERS_MAX, SENSORS_MAX>,
) -> Result<SlotCommand<f32, SENSORS_MAX>, ControllerError> {
    controller.allocate(state)
}
