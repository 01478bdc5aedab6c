//! A message to a MAVLink frame, signed or not.
#![no_std]
#![no_main]

use firmware_core::autopilot::wire::{Encoder, FrameBuffer};
use firmware_core::mavlink::dialects::common::MavMessage;
use panics as _;

#[unsafe(no_mangle)]
pub fn entry<'b>(
    encoder: &mut Encoder,
    message: &MavMessage,
    buffer: &'b mut FrameBuffer,
) -> Option<&'b [u8]> {
    encoder.encode_of_client(message, buffer)
}
