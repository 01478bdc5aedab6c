//! The upload of a plan to an autopilot.
#![no_std]
#![no_main]

use firmware_core::{
    autopilot::{mission::MissionUpload, wire::Address},
    mavlink::dialects::common::MavMessage,
    time::Instant,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    upload: &mut MissionUpload<'_, f32>,
    now: Instant,
    from: Address,
    message: &MavMessage,
) -> Option<MavMessage> {
    upload.receive(now, from, message);
    upload.poll(now)
}
