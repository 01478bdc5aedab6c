//! The flight of a scenario on the built-in ideal vehicle, which follows every setpoint exactly: what
//! the figures measure, and what other flights are compared with.

use crate::{
    flight::{self, FlightSettings, Peer, RealTimeFactor},
    policy::{HostPolicy, PolicyChoice},
    record::FlightRecord,
};
use environment::Allocation;
use scenario::{Events, Scenario};
use vehicle::{Profile, Vehicle};

/// How a flight is flown.
#[derive(Clone, Copy, Debug)]
pub struct IdealFlightSettings {
    /// The method that allocates the powers.
    pub inner: Allocation,
    /// The vehicle does not learn how good the estimates of channels are.
    pub ignores_errors: bool,
    /// The seed of the drawn signals.
    pub seed: u64,
}

impl Default for IdealFlightSettings {
    fn default() -> Self {
        Self {
            inner: Allocation::Exact,
            ignores_errors: false,
            seed: 1,
        }
    }
}

/// Flies a scenario on the built-in ideal vehicle.
///
/// # Errors
/// Returns a message of one line if the policy cannot be loaded or does not fit, or if the flight
/// was aborted.
pub fn fly(
    scenario: &Scenario,
    events: &Events,
    policy: &PolicyChoice,
    inner: Allocation,
) -> Result<FlightRecord, String> {
    let settings = IdealFlightSettings {
        inner,
        ..IdealFlightSettings::default()
    };
    fly_under(scenario, events, policy, &settings)
}

/// As [`fly`], with all settings.
///
/// # Errors
/// As [`fly`].
pub fn fly_under(
    scenario: &Scenario,
    events: &Events,
    policy: &PolicyChoice,
    settings: &IdealFlightSettings,
) -> Result<FlightRecord, String> {
    fly_loaded(
        scenario,
        events,
        HostPolicy::load(policy, scenario)?,
        settings,
    )
}

/// As [`fly_under`], with a policy that was loaded for the mission, and its name.
///
/// # Errors
/// Returns a message of one line if the flight was aborted.
pub fn fly_loaded(
    scenario: &Scenario,
    events: &Events,
    (policy, name): (HostPolicy, String),
    &IdealFlightSettings {
        inner,
        ignores_errors,
        seed,
    }: &IdealFlightSettings,
) -> Result<FlightRecord, String> {
    let settings = FlightSettings {
        ground_link: None,
        policy: name,
        inner,
        profile: Profile::Ideal,
        real_time_factor: RealTimeFactor::Max,
        seed,
        // The rates are analytic; the signals are drawn by `host-sim run`.
        symbols_per_slot: 1,
        ignores_errors,
        events: events.clone(),
    };
    let vehicle = Vehicle::new(flight::vehicle_settings(scenario, Profile::Ideal));
    let flown = flight::fly(
        scenario,
        policy,
        &settings,
        Peer::built_in(vehicle),
        &mut (),
    );
    flown.map_err(|failed| failed.error.to_string())
}
