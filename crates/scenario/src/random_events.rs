//! Events for tests of replanning: one kind of change, at mid-mission.

use std::f64::consts::TAU;

use firmware_core::{
    Displacement, Position, SENSORS_MAX, USERS_MAX, controller::DatedChange, mission::MissionChange,
};
use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::{Events, HostMission};

/// How far a user moves, metres.
const MOVE_M: f64 = 200.0;
/// The factor by which `Gamma` is tightened.
const TIGHTER: f64 = 0.8;
/// The number of slots that are lost.
const SLOTS_LOST: u32 = 5;

/// A kind of change in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// A third of the users move by 200 m, each in a direction of its own.
    UsersMove,
    /// Two users leave.
    UsersLeave,
    /// A user joins.
    UserJoins,
    /// A quarter of the sensors fall silent.
    SensorsLeave,
    /// `Gamma` becomes 0.8 of what it was.
    TighterThreshold,
    /// The speed limit is halved.
    HalfSpeed,
    /// The mission ends five slots earlier.
    SlotsLost,
}

impl EventKind {
    /// Every kind.
    pub const ALL: [Self; 7] = [
        Self::UsersMove,
        Self::UsersLeave,
        Self::UserJoins,
        Self::SensorsLeave,
        Self::TighterThreshold,
        Self::HalfSpeed,
        Self::SlotsLost,
    ];

    /// Returns the name for tables.
    pub fn title(self) -> &'static str {
        match self {
            Self::UsersMove => "a third of the users move by 200 m",
            Self::UsersLeave => "two users leave",
            Self::UserJoins => "a user joins",
            Self::SensorsLeave => "a quarter of the sensors fall silent",
            Self::TighterThreshold => "the MSE threshold becomes 0.8 of itself",
            Self::HalfSpeed => "the speed limit is halved",
            Self::SlotsLost => "five slots are lost",
        }
    }

    /// Draws events of this kind for the slot after half of the mission. Returns `None` if the
    /// mission is too small for it.
    pub fn draw(self, mission: &HostMission, seed: u64) -> Option<Events> {
        let mut random = Pcg64::seed_from_u64(seed);
        let p = mission.parameters();
        let from_slot = p.slots / 2 + 1;
        let (users, sensors) = (mission.user_count(), mission.sensor_count());
        let mut some = |count: usize, of: usize| {
            let mut numbers: Vec<u16> = (0..of as u16).collect();
            numbers.shuffle(&mut random);
            numbers.truncate(count);
            numbers
        };
        let within = |place: Position<f64>| {
            Position::new(
                place.x.clamp(0.0, p.area.east_m),
                place.y.clamp(0.0, p.area.north_m),
            )
        };
        let changes: Vec<MissionChange<f64>> = match self {
            // A map of gains has those of the nodes' places only.
            Self::UsersMove | Self::UserJoins if mission.has_gain_map() => Vec::new(),
            Self::UsersMove => {
                let moving = some(users / 3, users);
                let moved = moving.into_iter().map(|user| {
                    let (sin, cos) = random.random_range(0.0..TAU).sin_cos();
                    let way = Displacement::new(cos, sin) * MOVE_M;
                    let position_m = within(p.users[usize::from(user)] + way);
                    MissionChange::User { user, position_m }
                });
                moved.collect()
            }
            Self::UsersLeave if users > 3 => {
                let leaving = some(2, users).into_iter();
                leaving
                    .map(|user| MissionChange::UserLeft { user })
                    .collect()
            }
            Self::UserJoins if users < USERS_MAX => {
                let mut along = |extent_m: f64| random.random_range(0.0..=extent_m);
                vec![MissionChange::User {
                    user: users as u16,
                    position_m: Position::new(along(p.area.east_m), along(p.area.north_m)),
                }]
            }
            Self::SensorsLeave if (4..=SENSORS_MAX).contains(&sensors) => {
                let leaving = some(sensors / 4, sensors).into_iter();
                let left = leaving.map(|sensor| MissionChange::SensorLeft { sensor });
                left.collect()
            }
            Self::TighterThreshold => {
                vec![MissionChange::MseThreshold(p.mse_threshold * TIGHTER)]
            }
            Self::HalfSpeed => vec![MissionChange::MaxSpeed(p.max_speed_mps / 2.0)],
            Self::SlotsLost if p.slots > 4 * SLOTS_LOST => {
                vec![MissionChange::Slots(p.slots - SLOTS_LOST)]
            }
            _ => Vec::new(),
        };
        let dated = changes
            .into_iter()
            .map(|change| DatedChange { from_slot, change });
        let events = Events::new(dated.collect());
        (from_slot > 1 && !events.changes().is_empty()).then_some(events)
    }
}
