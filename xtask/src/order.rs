//! The order of the default mission, whose plan the planner's benchmark measures.

use std::{fs, path::Path};

use anyhow::{Context, Result};
use firmware_core::{
    MotionLimits,
    console::{
        CONSOLE_FRAME_MAX, Call, Clock, MissionOrder, PolicyKind, encode_call, in_single_precision,
    },
};
use scenario::Scenario;

/// The name of the default mission.
pub(crate) const DEFAULT: &str = "separated";

/// Returns the default mission.
pub(crate) fn default_scenario() -> Result<Scenario> {
    Scenario::shipped(DEFAULT).with_context(|| format!("no scenario {DEFAULT} is shipped"))
}

/// Writes the order as a frame of the console, unless the file has it already.
pub(crate) fn write(to: &Path) -> Result<()> {
    let scenario = default_scenario()?;
    let order = MissionOrder {
        mission: in_single_precision(scenario.mission.parameters()),
        map_origin: scenario.map_origin(),
        limits: MotionLimits::ideal(),
        geofence: None,
        ground_patience: None,
        policy_kind: PolicyKind::Plan,
        clock: Clock::Console,
        ground_link: None,
        mavlink_key: None,
    };
    let mut frame = [0; CONSOLE_FRAME_MAX];
    let frame = encode_call(&Call::Order(order), &mut frame)?;
    if fs::read(to).is_ok_and(|written| written == frame) {
        return Ok(());
    }
    fs::write(to, frame).with_context(|| to.display().to_string())
}
