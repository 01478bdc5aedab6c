//! How a mission with the examined autopilot would end: it is flown with the built-in vehicle and the
//! autopilot's parameters.

use std::fmt;

use environment::Allocation;
use firmware_core::{
    USERS_MAX,
    autopilot::{Autopilot, preflight::Preflight},
    policy::Policy,
    time::Duration,
};
use scenario::{Events, Scenario};
use vehicle::{Profile, Vehicle, VehicleSettings};

use crate::flight::{self, FlightSettings, Peer, ProfileChoice, RealTimeFactor};

/// The predicted end of a mission with the examined autopilot.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// The speed that the limits and parameters allow, m/s.
    pub possible_mps: f64,
    /// The speed that the straight path to the destination needs, m/s.
    pub needed_mps: f64,
    /// The sum rate of the ideal flight, bit/s/Hz.
    pub ideal: f64,
    /// The simulated flight; `None` if it would not start.
    pub flight: Option<PredictedFlight>,
}

/// A simulated flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedFlight {
    /// Whether the vehicle arrives.
    pub arrives: bool,
    /// The distance from the end of the flight to the destination, m.
    pub distance_m: f64,
    /// The sum rate, bit/s/Hz.
    pub total: f64,
}

impl fmt::Display for Prediction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the vehicle can fly {:.1} m/s and needs {:.1} m/s to arrive; ",
            self.possible_mps, self.needed_mps
        )?;
        match self.flight {
            None => f.write_str("the mission would not start"),
            Some(flight) if flight.arrives => write!(
                f,
                "it would arrive with a sum rate of {:.1} bit/s/Hz ({:.0} % of {:.1} in an ideal \
                 flight), if the airframe reaches the speed that its parameters allow",
                flight.total,
                100.0 * flight.total / self.ideal,
                self.ideal
            ),
            Some(flight) => write!(
                f,
                "it would not arrive: it would end {:.0} m from the destination",
                flight.distance_m
            ),
        }
    }
}

/// Flies the mission twice with the built-in vehicle: once with the behaviour and the parameters of
/// the examined autopilot, and once with the ideal profile. The policy of each flight is given.
/// Returns `None` until the parameters have been read.
pub fn predict<P: Policy<f64, USERS_MAX>>(
    scenario: &Scenario,
    [policy, ideal_policy]: [P; 2],
    client: &Autopilot<f64>,
    starts: bool,
) -> Option<Prediction> {
    let (_, firmware) = client.vehicle().filter(|_| client.parameters_are_read())?;
    let fly = |policy: P, profile: Profile, parameters: Vec<(String, f32)>| {
        let settings = FlightSettings {
            ground_link: None,
            policy: String::new(),
            inner: Allocation::Exact,
            profile,
            real_time_factor: RealTimeFactor::Max,
            seed: 1,
            symbols_per_slot: 1,
            ignores_errors: false,
            events: Events::default(),
        };
        let vehicle = VehicleSettings {
            parameters,
            ready_after: Duration::from_secs(1),
            ..flight::vehicle_settings(scenario, profile)
        };
        let peer = Peer::built_in(Vehicle::new(vehicle));
        // A flight that was aborted on the way has not arrived either.
        let (record, ended) = match flight::fly(scenario, policy, &settings, peer, &mut ()) {
            Ok(record) => (record, true),
            Err(failed) => (*failed.record?, false),
        };
        let summary = (!record.slots.is_empty()).then(|| record.summary())?;
        Some(PredictedFlight {
            arrives: ended && summary.arrived,
            distance_m: summary.arrival_distance_m,
            total: summary.sum_rate,
        })
    };
    let ideal = fly(ideal_policy, Profile::Ideal, Vec::new())?;
    let read = client
        .parameters()
        .map(|(name, value)| (name.to_owned(), value));
    let flown = starts.then(|| fly(policy, ProfileChoice::of(firmware), read.collect()));
    let mission = scenario.mission.parameters();
    Some(Prediction {
        possible_mps: client.limits().speed_mps.min(mission.max_speed_mps),
        needed_mps: Preflight::of(mission).needed_speed_mps.unwrap_or_default(),
        ideal: ideal.total,
        flight: flown.flatten(),
    })
}
