//! A report to the console.
#![no_std]
#![no_main]

use firmware_core::{
    console::{self, BoardReport},
    link::FrameTooLong,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry<'f>(report: &BoardReport, frame: &'f mut [u8]) -> Result<&'f [u8], FrameTooLong> {
    console::encode_report(report, frame)
}
