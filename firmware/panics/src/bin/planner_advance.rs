//! `Planner::advance`.
#![no_std]
#![no_main]

use firmware_core::planner::Progress;
use panics::Planner;

#[unsafe(no_mangle)]
pub fn entry(planner: &mut Planner, budget: u64) -> Progress {
    planner.advance(budget)
}
