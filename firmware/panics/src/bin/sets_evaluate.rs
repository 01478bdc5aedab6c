//! The network for any mission.
#![no_std]
#![no_main]

use firmware_core::policy::sets::{SetsObservation, SetsOutput, SetsWork};
use panics::AnyNetwork;

#[unsafe(no_mangle)]
pub fn entry(
    network: &AnyNetwork,
    observation: &SetsObservation,
    work: &mut SetsWork,
) -> Option<SetsOutput> {
    network.evaluate(observation, work)
}
