//! The settings of a flight, and those of the client and of the built-in vehicle that follow from
//! its scenario.

use environment::Allocation;
use firmware_core::{
    Displacement, Position,
    autopilot::{AutopilotSettings, Geofence, failsafe::Watch, preflight::Preflight},
    link::Credentials,
    time::Duration,
};
use scenario::{Events, Scenario};
use vehicle::{Profile, VehicleSettings};

/// The longest time to wait for the first heartbeat of an autopilot.
pub const CONNECT_PATIENCE: Duration = Duration::from_secs(30);

/// The ground sends something in every slot; after this number of slots without it, and at least
/// [`GROUND_PATIENCE`], the vehicle is landed.
const GROUND_SLOTS: u32 = 10;

/// The shortest time without messages of the ground that counts as a loss.
const GROUND_PATIENCE: Duration = Duration::from_secs(10);

/// The distance from the mission's area to the geofence: a vehicle that is outside the geofence is
/// landed.
const FENCE_MARGIN_M: f64 = 50.0;

/// The settings of a flight.
#[derive(Clone, Debug)]
pub struct FlightSettings {
    /// The policy's name, for the record.
    pub policy: String,
    /// The method that allocates the powers of a slot.
    pub inner: Allocation,
    /// The vehicle at the other end, which determines the limits that the guidance plans with.
    pub profile: Profile,
    /// The real-time factor.
    pub real_time_factor: RealTimeFactor,
    /// The seed of the drawn signals.
    pub seed: u64,
    /// The number of symbols drawn in a slot for the empirical MSE.
    pub symbols_per_slot: u32,
    /// The vehicle is not told how good the estimates of channels are, and takes them for exact.
    pub ignores_errors: bool,
    /// The changes of the mission in flight.
    pub events: Events,
    /// The ground's credentials on the ground link; `None` leaves it open. The computer needs its own,
    /// with the same key.
    pub ground_link: Option<Credentials>,
}

/// The relation of the flight's time to real time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RealTimeFactor {
    /// As fast as possible. With an external vehicle: real time.
    Max,
    /// This number of seconds of flight per second.
    Factor(f64),
}

impl RealTimeFactor {
    pub(super) fn factor(self) -> f64 {
        match self {
            Self::Max => 1.0,
            Self::Factor(factor) => factor,
        }
    }
}

/// Returns the client's settings for a mission.
pub fn autopilot_settings(scenario: &Scenario, profile: Profile) -> AutopilotSettings<f64> {
    let p = scenario.mission.parameters();
    let mut limits = profile.client_limits();
    if !profile.is_ideal() {
        // The mission's own speed limit (eq:traj1) also applies between waypoints.
        limits.speed_mps = limits.speed_mps.min(p.max_speed_mps);
    }
    let around = Displacement::new(FENCE_MARGIN_M, FENCE_MARGIN_M);
    let fence = Geofence {
        low: Position::origin() - around,
        high: Position::new(p.area.east_m, p.area.north_m) + around,
        ceiling_m: p.altitude_m + FENCE_MARGIN_M,
    };
    let slot = Duration::from_secs_f64(p.slot_duration_s);
    AutopilotSettings {
        limits,
        geofence: Some(fence),
        preflight: Preflight::of(p),
        watch: Watch {
            ground: Some((slot * GROUND_SLOTS).max(GROUND_PATIENCE)),
            ..Watch::default()
        },
        ..AutopilotSettings::new(
            scenario.map_origin(),
            p.start,
            p.altitude_m,
            p.max_speed_mps,
        )
    }
}

/// Returns the built-in vehicle for a mission: on the ground at its start.
pub fn vehicle_settings(scenario: &Scenario, profile: Profile) -> VehicleSettings {
    let start = scenario.mission.parameters().start;
    let uncertainty = &scenario.uncertainty;
    VehicleSettings {
        // The ideal vehicle has no body.
        wind_mps: if profile.is_ideal() {
            0.0
        } else {
            uncertainty.wind_mps
        },
        seed: uncertainty.seed,
        elevation_m: scenario.origin.elevation_m,
        ..VehicleSettings::new(profile, scenario.map_origin(), start)
    }
}
