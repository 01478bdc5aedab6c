//! What a program asks of the MAVLink client beside the slots.
#![no_std]
#![no_main]

use firmware_core::{
    MotionLimits,
    autopilot::{
        Autopilot, ChangedParameter, Event, SettingsError,
        preflight::{PreflightRefusal, REFUSALS},
    },
    heapless::Vec,
    time::Instant,
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    client: &mut Autopilot<f32>,
    now: Instant,
    limits: MotionLimits<f32>,
    changes: &[ChangedParameter],
    name: &str,
) -> Result<
    (
        Instant,
        Vec<PreflightRefusal, REFUSALS>,
        Option<Event>,
        Option<f32>,
    ),
    SettingsError,
> {
    client.set_limits(limits)?;
    client.restore_first(changes);
    client.launch(now);
    client.note_ground_link(now);
    client.land(now);
    client.return_and_land(now);
    client.stop(now);
    let event = client.take_next_event();
    let refusals = client.refusals(now);
    Ok((client.poll_at(now), refusals, event, client.parameter(name)))
}
