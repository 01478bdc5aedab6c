//! `Controller::note_change`.
#![no_std]
#![no_main]

use firmware_core::controller::DatedChange;
use panics::TrainedController;

#[unsafe(no_mangle)]
pub fn entry(controller: &mut TrainedController, change: &DatedChange<f32>) -> bool {
    controller.note_change(change)
}
