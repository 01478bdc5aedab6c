//! `Controller::note_quality`.
#![no_std]
#![no_main]

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    controller::{ChannelQuality, ControllerError},
};
use panics::TrainedController;

#[unsafe(no_mangle)]
pub fn entry(
    controller: &mut TrainedController,
    quality: &ChannelQuality<USERS_MAX, SENSORS_MAX>,
) -> Result<(), ControllerError> {
    controller.note_quality(quality)
}
