//! A message to the ground link.
#![no_std]
#![no_main]

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    link::{self, FrameTooLong, Message},
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry<'f>(
    message: &Message<f32, USERS_MAX, SENSORS_MAX>,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    link::encode(message, frame)
}
