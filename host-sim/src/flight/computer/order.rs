//! The order of a mission for a board.

use firmware_core::{
    MotionLimits,
    autopilot::Geofence,
    console::{Clock, MissionOrder, PolicyKind, in_single_precision},
};
use scenario::Scenario;
use vehicle::Profile;

use crate::flight::settings::autopilot_settings;

/// Returns the order of a mission for a board, with an open ground link.
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
