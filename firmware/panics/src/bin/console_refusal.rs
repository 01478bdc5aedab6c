//! The text of a refused order.
#![no_std]
#![no_main]

use firmware_core::{
    console::{self, OrderError, TEXT_MAX},
    heapless::String,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(error: &OrderError) -> String<TEXT_MAX> {
    console::words(error)
}
