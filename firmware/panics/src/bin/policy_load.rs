//! A `.policy` file read, with its test vector.
#![no_std]
#![no_main]

use firmware_core::policy::mlp::LoadError;
use panics::Trained;

#[unsafe(no_mangle)]
pub fn entry(file: &'static [u8]) -> Result<Trained, LoadError> {
    Trained::load(file)
}
