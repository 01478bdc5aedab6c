//! A controller from its creation on, with any method, Alg. 1 among them, and channels that are not known
//! exactly.
#![no_std]
#![no_main]

use firmware_core::{
    Position, SENSORS_MAX, USERS_MAX,
    console::BoardMission,
    controller::{ChannelQuality, ChannelState, Controller, SlotCommand},
    inner::Method,
};
use panics::Trained;

#[unsafe(no_mangle)]
pub fn entry(
    mission: &BoardMission,
    policy: Trained,
    method: Method<f32>,
    measured: Position<f32>,
    quality: &ChannelQuality<USERS_MAX, SENSORS_MAX>,
    state: &ChannelState<f32, USERS_MAX, SENSORS_MAX>,
) -> Option<SlotCommand<f32, SENSORS_MAX>> {
    let mut controller = Controller::with_solver(mission.clone(), policy, method);
    controller.plan(measured).ok()?;
    let _ = controller.note_quality(quality);
    controller.allocate(state).ok()
}
