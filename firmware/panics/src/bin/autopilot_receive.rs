//! A message to the MAVLink client.
#![no_std]
#![no_main]

use firmware_core::{
    autopilot::{Autopilot, wire::Address},
    mavlink::dialects::common::MavMessage,
    time::Instant,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(client: &mut Autopilot<f32>, now: Instant, from: Address, message: &MavMessage) {
    client.receive(now, from, message);
}
