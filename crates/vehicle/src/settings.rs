//! The settings of a vehicle, and the faults that tests inject into it.

use firmware_core::Position;
use firmware_core::autopilot::frames::Geodetic;
use firmware_core::autopilot::wire::signing::SigningKey;
use firmware_core::time::Duration;
use nalgebra::Vector2;

use super::ability::Ability;
use super::profile::Profile;
use super::timing::{Pauses, Sampling};

/// What a vehicle is made with.
#[derive(Clone, Debug)]
pub struct VehicleSettings {
    /// Which vehicle.
    pub profile: Profile,
    /// Where the map's origin lies on Earth.
    pub map_origin: Geodetic,
    /// Height of the map above mean sea level, m.
    pub elevation_m: f64,
    /// Where it stands at first, on the map, m.
    pub start: Position<f64>,
    /// What its body can do.
    pub ability: Ability,
    /// Its MAVLink system id.
    pub system: u8,
    /// Until its estimator has an absolute position.
    pub ready_after: Duration,
    /// How fast its clock runs, in seconds per second of the caller's time. PX4's simulator keeps
    /// 0.99 of real time.
    pub clock_rate: f64,
    /// How regularly its samples are taken and delivered.
    pub sampling: Sampling,
    /// How often nothing comes from it for a moment.
    pub hiccups: Pauses,
    /// How often its clock stands still: a simulator on a computer that is busy.
    pub stalls: Pauses,
    /// Steady wind from the west, m/s, with gusts.
    pub wind_mps: f64,
    /// Ids of messages whose interval it does not let anybody set.
    pub refused_intervals: Vec<u32>,
    /// Of jitter, hiccups, stalls and gusts.
    pub seed: u64,
    /// From this time of its own on it sends and takes nothing any more: death without a word.
    pub die_after: Option<Duration>,
    /// Parameters that differ from the profile's defaults: name and value.
    pub parameters: Vec<(String, f32)>,
    /// Signs and requires signatures: the key, and the time at first, microseconds since 1970;
    /// [`Vehicle::set_signing_time`] moves it on.
    pub signing: Option<(SigningKey, u64)>,
}

impl VehicleSettings {
    /// A vehicle of this profile on the ground at `start`.
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

/// Things that go wrong on purpose, for tests.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// Heartbeats stop.
    pub no_heartbeat: bool,
    /// Position messages stop.
    pub no_position: bool,
    /// Positions are reported wrong by so much, m.
    pub position_offset_m: Vector2<f64>,
    /// Setpoints are taken and not flown.
    pub ignore_setpoints: bool,
    /// Its heartbeats say that the motors stand still.
    pub disarmed: bool,
    /// The battery's voltage falls below the autopilot's own threshold.
    pub battery_low: bool,
    /// What the battery shows, percent; `None` for full.
    pub battery_percent: Option<i8>,
}
