//! A byte from the ground link.
#![no_std]
#![no_main]

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    link::{Decoder, FrameError, Message},
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    decoder: &mut Decoder,
    byte: u8,
) -> Option<Result<Message<f32, USERS_MAX, SENSORS_MAX>, FrameError>> {
    decoder.push(byte)
}
