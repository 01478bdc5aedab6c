//! A controller from its creation on, with the exact solver alone.
#![no_std]
#![no_main]

use firmware_core::{
    Position, SENSORS_MAX, USERS_MAX,
    console::BoardMission,
    controller::{ChannelState, Controller, SlotCommand},
};
use panics::{Trained, TrainedController};

#[unsafe(no_mangle)]
pub fn entry(
    mission: &BoardMission,
    policy: Trained,
    measured: Position<f32>,
    state: &ChannelState<f32, USERS_MAX, SENSORS_MAX>,
) -> Option<SlotCommand<f32, SENSORS_MAX>> {
    let mut controller: TrainedController = Controller::new(mission.clone(), policy);
    controller.plan(measured).ok()?;
    controller.allocate(state).ok()
}
