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
    let (policy, name) = HostPolicy::load(policy, scenario)?;
    let settings = FlightSettings {
        ground_link: None,
        policy: name,
        inner,
        profile: Profile::Ideal,
        real_time_factor: RealTimeFactor::Max,
        seed: 1,
        // The rates are analytic; the signals are drawn by `host-sim run`.
        symbols_per_slot: 1,
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
