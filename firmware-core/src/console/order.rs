// SPDX-License-Identifier: MIT OR Apache-2.0
//! The order for a flight, and the reasons to refuse it.

use serde::{Deserialize, Serialize};

use super::mavlink_key::MavlinkKey;
use crate::{
    SENSORS_MAX, USERS_MAX,
    autopilot::{Geofence, SettingsError, frames::Geodetic},
    limits::MotionLimits,
    link::Credentials,
    mission::{MissionError, MissionParameters},
    planner::PlannerError,
    policy::{PolicyMismatch, sets::SetsMismatch},
    scalar::{Position, Scalar},
    time::Duration,
};

/// The policy that a board uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PolicyKind {
    /// The trained policy in the board's flash, whether it is for one mission or for any.
    Trained,
    /// Straight to the destination, serving the nearest user.
    StraightLine,
    /// The plan that the board makes before take-off, and revises after changes.
    Plan,
}

/// The clock that a board uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Clock {
    /// The board's own timer.
    Board,
    /// The time sent in [`Tick`](super::Tick)s.
    Console,
}

/// An order to fly a mission, with all that a board needs for it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MissionOrder {
    /// The mission, not yet checked.
    pub mission: MissionParameters<f32, USERS_MAX, SENSORS_MAX>,
    /// The position of the map's origin on Earth.
    pub map_origin: Geodetic,
    /// The limits of the vehicle.
    pub limits: MotionLimits<f32>,
    /// The geofence that the vehicle must stay in.
    pub geofence: Option<Geofence<f32>>,
    /// The longest silence of the ground; the vehicle is landed after it.
    pub ground_patience: Option<Duration>,
    /// The policy to use.
    pub policy_kind: PolicyKind,
    /// The clock to use.
    pub clock: Clock,
    /// The authentication of the ground link; `None` leaves it open.
    pub ground_link: Option<Credentials>,
    /// The key of MAVLink signing. Without one the board neither signs nor requires signatures.
    pub mavlink_key: Option<MavlinkKey>,
}

/// Error returned when an order cannot be flown.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OrderError {
    /// The mission is invalid.
    #[error(transparent)]
    Mission(#[from] MissionError<f32>),
    /// The trained policy is for another mission.
    #[error(transparent)]
    Policy(#[from] PolicyMismatch),
    /// The mission is too large for the board's policy for any mission.
    #[error(transparent)]
    TooLarge(#[from] SetsMismatch),
    /// The board's planner cannot plan the mission.
    #[error("planner: {0}")]
    Planner(#[from] PlannerError),
    /// The board has no planner.
    #[error("the board has no planner")]
    NoPlanner,
    /// The board has no trained policy.
    #[error("the board has no trained policy")]
    NoPolicy,
    /// The board's memory holds the computer of another order.
    #[error("the board has memory for one computer, which is in use")]
    MemoryInUse,
    /// The autopilot settings are invalid.
    #[error(transparent)]
    Flight(#[from] SettingsError),
    /// The board's watchdog cannot wait for one of the mission's slots.
    #[error("slots of {slot_s} s: the board's watchdog can wait for slots of at most {most_s} s")]
    SlotTooLong {
        /// `delta`, seconds.
        slot_s: f32,
        /// The longest slot that can be flown, seconds.
        most_s: f64,
    },
}

/// The time that a slot may take beyond twice its duration before a watchdog stops the board. It
/// covers late channel state, late samples and a slow bench.
const SLOT_MARGIN: Duration = Duration::from_secs(20);

/// Returns how long a board's watchdog waits for a slot of this duration.
pub fn slot_patience(slot_duration_s: f32) -> Duration {
    Duration::from_secs_f64(2.0 * f64::from(slot_duration_s)) + SLOT_MARGIN
}

impl MissionOrder {
    /// Checks whether a watchdog with the longest time-out `longest` can wait for a slot.
    ///
    /// # Errors
    /// Returns an error if it cannot: it would stop the board in a normal slot.
    pub fn check_watchdog(&self, longest: Duration) -> Result<(), OrderError> {
        let slot_s = self.mission.slot_duration_s;
        if slot_patience(slot_s) <= longest {
            return Ok(());
        }
        let most_s = longest.saturating_sub(SLOT_MARGIN).as_secs_f64() / 2.0;
        Err(OrderError::SlotTooLong { slot_s, most_s })
    }
}

/// Converts a mission's parameters to single precision, as a [`MissionOrder`] carries them.
/// Positions are exact to 0.06 mm at a kilometre.
pub fn in_single_precision<T: Scalar, const M: usize, const J: usize>(
    p: &MissionParameters<T, M, J>,
) -> MissionParameters<f32, M, J> {
    use crate::mission::{Area, Environment, ExcessLoss};
    let number = |x: T| x.to_f64() as f32;
    let place = |place: &Position<T>| place.map(number);
    MissionParameters {
        slots: p.slots,
        slot_duration_s: number(p.slot_duration_s),
        start: place(&p.start),
        destination: place(&p.destination),
        area: Area {
            east_m: number(p.area.east_m),
            north_m: number(p.area.north_m),
        },
        altitude_m: number(p.altitude_m),
        max_speed_mps: number(p.max_speed_mps),
        carrier_hz: number(p.carrier_hz),
        radio_model: p.radio_model,
        environment: Environment {
            a: number(p.environment.a),
            b: number(p.environment.b),
        },
        excess_loss_db: ExcessLoss {
            los: number(p.excess_loss_db.los),
            nlos: number(p.excess_loss_db.nlos),
        },
        noise_power: crate::Watt(number(p.noise_power.0)),
        mse_threshold: number(p.mse_threshold),
        user_power_max: crate::Watt(number(p.user_power_max.0)),
        sensor_power_max: crate::Watt(number(p.sensor_power_max.0)),
        users: p.users.iter().map(place).collect(),
        sensors: p.sensors.iter().map(place).collect(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::{super::protocol::words, *};
    use crate::{link::GroundKey, test_missions::table_one};

    pub(in crate::console) fn order() -> MissionOrder {
        let mission = table_one::<f64>();
        MissionOrder {
            mission: in_single_precision(mission.parameters()),
            map_origin: Geodetic {
                latitude_e7: -353_632_621,
                longitude_e7: 1_491_652_374,
            },
            limits: MotionLimits::ideal(),
            geofence: Some(Geofence {
                low: Position::new(-50.0, -50.0),
                high: Position::new(1050.0, 1050.0),
                ceiling_m: 150.0,
            }),
            ground_patience: Some(Duration::from_secs(1_000_000)),
            policy_kind: PolicyKind::StraightLine,
            clock: Clock::Console,
            ground_link: Some(Credentials {
                key: GroundKey::new([0xff; 32]),
                start: [0xff; 12],
            }),
            mavlink_key: None,
        }
    }

    /// A slot that a watchdog cannot wait for is refused before the flight.
    #[test]
    fn a_watchdog_waits_for_every_slot_that_is_flown() {
        let longest = Duration::from_secs(171);
        let mut order = order();
        for (slot_s, flown) in [(1.0, true), (75.5, true), (75.6, false), (200.0, false)] {
            order.mission.slot_duration_s = slot_s;
            let outcome = order.check_watchdog(longest);
            assert_eq!(outcome.is_ok(), flown, "{slot_s}: {outcome:?}");
            if let Err(why) = outcome {
                assert!(words(&why).contains("at most 75.5 s"), "{why}");
            } else {
                assert!(slot_patience(slot_s) >= Duration::from_secs_f64(2.0 * f64::from(slot_s)));
            }
        }
    }
}
