//! The settings of a vehicle, and the faults that tests inject into it.

use firmware_core::Position;
use firmware_core::autopilot::frames::Geodetic;
use firmware_core::autopilot::wire::signing::LinkSigning;
use firmware_core::time::Duration;
use nalgebra::Vector2;

use super::ability::Ability;
use super::profile::Profile;
use super::timing::{Pauses, Sampling};

/// The settings that a vehicle is created with.
#[derive(Clone, Debug)]
pub struct VehicleSettings {
    /// The type of the vehicle.
    pub profile: Profile,
    /// The location on Earth of the map's origin.
    pub map_origin: Geodetic,
    /// The height of the map above mean sea level, m.
    pub elevation_m: f64,
    /// The initial position of the vehicle on the map, m.
    pub start: Position<f64>,
    /// The physical limits of the body.
    pub ability: Ability,
    /// The MAVLink system id.
    pub system: u8,
    /// The time until the estimator has an absolute position.
    pub ready_after: Duration,
    /// The rate of the vehicle's clock, in seconds per second of the caller's time. PX4's simulator
    /// reaches 0.99 of real time.
    pub clock_rate: f64,
    /// How regularly samples are taken and delivered.
    pub sampling: Sampling,
    /// How often the vehicle sends nothing for a moment.
    pub hiccups: Pauses,
    /// How often the clock stops, as that of a simulator on a busy computer does.
    pub stalls: Pauses,
    /// The steady wind from the west, m/s. Gusts are added to it.
    pub wind_mps: f64,
    /// The ids of messages whose interval cannot be changed.
    pub refused_intervals: Vec<u32>,
    /// The seed of jitter, hiccups, stalls and gusts.
    pub seed: u64,
    /// From this time of its own clock on, the vehicle sends and receives nothing: it fails
    /// silently.
    pub die_after: Option<Duration>,
    /// The parameters that differ from the profile's defaults: name and value.
    pub parameters: Vec<(String, f32)>,
    /// If set, the vehicle signs its messages and requires signatures, from this state on.
    /// [`Vehicle::set_signing_time`](super::Vehicle::set_signing_time) sets its clock; without one it
    /// takes over the time of received messages.
    pub signing: Option<LinkSigning>,
}

impl VehicleSettings {
    /// Returns the settings of a vehicle of this profile on the ground at `start`.
    pub fn new(profile: Profile, map_origin: Geodetic, start: Position<f64>) -> Self {
        Self {
            profile,
            map_origin,
            elevation_m: 0.0,
            start,
            ability: profile.ability(),
            system: 1,
            ready_after: profile.ready_after(),
            clock_rate: profile.clock_rate(),
            sampling: profile.sampling(),
            hiccups: profile.hiccups(),
            stalls: Pauses::default(),
            refused_intervals: profile.refused_intervals(),
            wind_mps: 0.0,
            seed: 1,
            die_after: None,
            parameters: Vec::new(),
            signing: None,
        }
    }
}

/// Faults that tests inject.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// No heartbeats are sent.
    pub no_heartbeat: bool,
    /// No position messages are sent.
    pub no_position: bool,
    /// The error of the reported positions, m.
    pub position_offset_m: Vector2<f64>,
    /// Setpoints are accepted but not followed.
    pub ignore_setpoints: bool,
    /// The heartbeats state that the motors are stopped.
    pub disarmed: bool,
    /// The battery's voltage falls below the autopilot's own threshold.
    pub battery_low: bool,
    /// The reported charge of the battery, percent, or `None` for a full battery.
    pub battery_percent: Option<i8>,
}
