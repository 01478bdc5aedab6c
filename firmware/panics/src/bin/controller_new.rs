//! The creation of a controller.
#![no_std]
#![no_main]

use firmware_core::{Mission, SENSORS_MAX, USERS_MAX, controller::Controller};
use panics::{Trained, TrainedController};

#[unsafe(no_mangle)]
pub fn entry(mission: &Mission<f32, USERS_MAX, SENSORS_MAX>, policy: Trained) -> TrainedController {
    Controller::new(mission.clone(), policy)
}
