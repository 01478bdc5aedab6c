//! The text of an event.
#![no_std]
#![no_main]

use firmware_core::{
    autopilot::Event,
    console::{self, TEXT_MAX},
    heapless::String,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(event: &Event) -> String<TEXT_MAX> {
    console::words(event)
}
