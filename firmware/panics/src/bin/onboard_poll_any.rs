//! The whole onboard computer of a board with the policy for any mission in flash.
#![no_std]
#![no_main]

use firmware_core::{
    autopilot::wire::FrameBuffer, link::FRAME_MAX, onboard::Activity, onboard::Probe, time::Instant,
};
use panics::AnyMissionComputer;

struct Silent;

impl Probe for Silent {
    fn begin(&mut self, _: Activity) {}
    fn end(&mut self, _: Activity) {}
}

#[unsafe(no_mangle)]
pub fn entry<'b>(
    computer: &mut AnyMissionComputer,
    now: Instant,
    (ground, mavlink): (&[u8], &[u8]),
    frames: (&'b mut [u8; FRAME_MAX], &'b mut FrameBuffer),
) -> (Option<&'b [u8]>, Option<&'b [u8]>) {
    computer.receive_ground(now, ground);
    computer.receive_mavlink(now, mavlink, false);
    computer.poll(now, &mut Silent);
    (
        computer.take_ground_frame(frames.0),
        computer.take_mavlink_frame(now, frames.1),
    )
}
