//! A file of format version 2 read, with its test vector.
#![no_std]
#![no_main]

use firmware_core::policy::sets::{SetsLoadError, SetsWork};
use panics::AnyNetwork;

#[unsafe(no_mangle)]
pub fn entry(file: &'static [u8], work: &mut SetsWork) -> Result<AnyNetwork, SetsLoadError> {
    AnyNetwork::load(file, work)
}
