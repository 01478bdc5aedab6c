//! The start and the end of a leg.
#![no_std]
#![no_main]

use firmware_core::{
    autopilot::{Autopilot, Leg, LegEnd, LegError},
    time::Instant,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    client: &mut Autopilot<f32>,
    now: Instant,
    leg: Leg<f32>,
) -> Result<Option<LegEnd<f32>>, LegError> {
    let end = client.leg_ended(now);
    client.fly_leg(now, leg)?;
    Ok(end)
}
