//! The text of an event, and that of a refused order.
#![no_std]
#![no_main]

use firmware_core::{
    autopilot::Event,
    console::{self, OrderError, TEXT_MAX},
    heapless::String,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(event: &Event, error: &OrderError) -> [String<TEXT_MAX>; 2] {
    [console::words(event), console::words(error)]
}
