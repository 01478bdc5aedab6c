//! The order of a mission for a board.

use firmware_core::{
    MotionLimits,
    autopilot::Geofence,
    console::{Clock, MissionOrder, PolicyKind, in_single_precision},
};
use scenario::Scenario;
use vehicle::Profile;

use crate::flight::settings::autopilot_settings;

/// Checks that an order can carry what is known of a mission.
///
/// # Errors
/// Returns a message of one line if it cannot.
pub fn check_order(scenario: &Scenario) -> Result<(), String> {
    if scenario.mission.has_gain_map() {
        return Err(
            "radio.gain_map is given, but a board's order cannot carry it: use the controller in \
             this process with --precision f64 (the default)"
                .into(),
        );
    }
    Ok(())
}

/// Returns the order of a mission for a board, with an open ground link. [`check_order`] says
/// whether there is one.
pub fn order(scenario: &Scenario, profile: Profile, policy_kind: PolicyKind) -> MissionOrder {
    let flight = autopilot_settings(scenario, profile);
    let number = |x: f64| x as f32;
    MissionOrder {
        mission: in_single_precision(scenario.mission.parameters()),
        map_origin: scenario.map_origin(),
        limits: MotionLimits {
            speed_mps: number(flight.limits.speed_mps),
            acceleration_mps2: number(flight.limits.acceleration_mps2),
            jerk_mps3: number(flight.limits.jerk_mps3),
        },
        geofence: flight.geofence.map(|fence| Geofence {
            low: fence.low.map(number),
            high: fence.high.map(number),
            ceiling_m: number(fence.ceiling_m),
        }),
        ground_patience: flight.watch.ground,
        policy_kind,
        clock: Clock::Console,
        ground_link: None,
        mavlink_key: None,
    }
}
