//! A byte from the console.
#![no_std]
#![no_main]

use firmware_core::{
    console::{Call, Calls},
    link::FrameError,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(calls: &mut Calls, byte: u8) -> Option<Result<Call, FrameError>> {
    calls.push(byte)
}
