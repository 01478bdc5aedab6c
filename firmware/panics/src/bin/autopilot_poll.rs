//! `Autopilot::poll`.
#![no_std]
#![no_main]

use firmware_core::{autopilot::Autopilot, mavlink::dialects::common::MavMessage, time::Instant};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(client: &mut Autopilot<f32>, now: Instant) -> Option<MavMessage> {
    client.poll(now)
}
