// SPDX-License-Identifier: MIT OR Apache-2.0
//! Comparisons of the vehicle with the mission before take-off. Waiting does not make them pass.
//!
//! An [`Obstacle`](super::Obstacle) is waited for; a [`PreflightRefusal`] ends the start at once,
//! before the motors turn, with the two numbers that do not match. A client that was not told to
//! launch lists them ([`Autopilot::refusals`](super::Autopilot::refusals)).

use core::fmt;

use super::profile::Firmware;
use crate::mission::MissionParameters;
use crate::scalar::{Position, Scalar};

/// The requirements of a mission that are compared before take-off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preflight<T: Scalar> {
    /// South-west and north-east corner of the mission's area, m; `None` where the mission has no
    /// area: then the distance to the start is used, and the autopilot's geofence is not compared.
    pub area: Option<(Position<T>, Position<T>)>,
    /// The largest distance from the area at which the vehicle may stand, m.
    pub distance_m: T,
    /// The speed of a straight flight from the start to the destination that takes all slots, m/s;
    /// `None` where the destination is not known.
    pub needed_speed_mps: Option<T>,
    /// The destination; `None` where it is not known, and no trial leg is flown then.
    pub destination: Option<Position<T>>,
}

impl<T: Scalar> Default for Preflight<T> {
    fn default() -> Self {
        Self {
            area: None,
            distance_m: T::of(500.0),
            needed_speed_mps: None,
            destination: None,
        }
    }
}

impl<T: Scalar> Preflight<T> {
    /// Returns the requirements of a mission. It arrives within `(N + 1) V delta` of its start.
    pub fn of<const M: usize, const J: usize>(mission: &MissionParameters<T, M, J>) -> Self {
        let distance_m = (mission.destination - mission.start).norm();
        let time_s = T::count(mission.slots as usize + 1) * mission.slot_duration_s;
        Self {
            area: Some((
                Position::origin(),
                Position::new(mission.area.east_m, mission.area.north_m),
            )),
            needed_speed_mps: Some(distance_m / time_s),
            destination: Some(mission.destination),
            ..Self::default()
        }
    }

    /// Returns how far outside the area a place is, m; without an area its distance from `start`.
    pub(super) fn outside_m(&self, place: &Position<T>, start: &Position<T>) -> T {
        let nearest = match &self.area {
            Some((low, high)) => Position::new(
                place.x.max(low.x).min(high.x),
                place.y.max(low.y).min(high.y),
            ),
            None => *start,
        };
        (place - nearest).norm()
    }

    /// Returns the distance from a place to the farthest corner of the area, m.
    pub(super) fn farthest_m(&self, place: &Position<T>) -> Option<T> {
        let (low, high) = self.area?;
        let corners = [
            low,
            high,
            Position::new(low.x, high.y),
            Position::new(high.x, low.y),
        ];
        Some(corners.iter().fold(T::zero(), |farthest, corner| {
            farthest.max((corner - place).norm())
        }))
    }
}

/// The reason why a mission is not started. It does not go away by waiting.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum PreflightRefusal {
    /// The vehicle stands too far away.
    TooFar {
        /// The distance from the vehicle to the mission's area (or start), m.
        distance_m: f32,
        /// The longest distance that is flown to it, m.
        limit_m: f32,
    },
    /// The battery is at or below the threshold of the battery failsafe.
    BatteryLow {
        /// The charge of the battery, percent.
        percent: i8,
        /// The threshold, percent.
        threshold: i8,
    },
    /// The mission's area reaches beyond the autopilot's own circular geofence.
    OutsideAutopilotFence {
        /// The parameter that holds the radius.
        parameter: &'static str,
        /// The radius, m.
        limit_m: f32,
        /// The distance from the vehicle to the farthest corner of the area, m.
        needed_m: f32,
    },
    /// The mission's altitude reaches the ceiling of the autopilot's own geofence.
    AboveAutopilotFence {
        /// The parameter that holds the ceiling.
        parameter: &'static str,
        /// The ceiling, m.
        limit_m: f32,
        /// The mission's altitude, m.
        needed_m: f32,
    },
    /// The destination cannot be reached in the mission's slots.
    TooSlow {
        /// The speed that the straight path requires, m/s.
        needed_mps: f32,
        /// The speed that the vehicle's limits allow, m/s.
        possible_mps: f32,
        /// The parameter that limits the speed, and the value to set it to.
        parameter: Option<(&'static str, f32)>,
    },
    /// The destination cannot be reached in the mission's slots, as the trial leg has shown.
    SlowAirframe {
        /// The speed that the straight path requires, m/s.
        needed_mps: f32,
        /// The largest speed of the trial leg, m/s.
        reached_mps: f32,
    },
}

impl fmt::Display for PreflightRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooFar {
                distance_m,
                limit_m,
            } => write!(
                f,
                "the vehicle stands {distance_m:.0} m outside the mission's area, and at most \
                 {limit_m:.0} m are flown to it: compare its position with the scenario's origin"
            ),
            Self::BatteryLow { percent, threshold } => write!(
                f,
                "the battery shows {percent} %, and the battery failsafe lands below {threshold} %"
            ),
            Self::OutsideAutopilotFence {
                parameter,
                limit_m,
                needed_m,
            } => write!(
                f,
                "the mission's area reaches {needed_m:.0} m from the vehicle, and the autopilot's \
                 own geofence ends at {limit_m:.0} m ({parameter})"
            ),
            Self::AboveAutopilotFence {
                parameter,
                limit_m,
                needed_m,
            } => write!(
                f,
                "the mission flies at {needed_m:.0} m, and the autopilot's own geofence ends at \
                 {limit_m:.0} m ({parameter})"
            ),
            Self::TooSlow {
                needed_mps,
                possible_mps,
                parameter,
            } => {
                write!(
                    f,
                    "reaching the destination needs {needed_mps:.1} m/s, but the vehicle's limits allow \
                     {possible_mps:.1} m/s"
                )?;
                match parameter {
                    Some((name, value)) => write!(f, ": set {name} to {value}"),
                    None => Ok(()),
                }
            }
            Self::SlowAirframe {
                needed_mps,
                reached_mps,
            } => write!(
                f,
                "reaching the destination needs {needed_mps:.1} m/s, but the airframe reached \
                 {reached_mps:.1} m/s on the trial leg: fly a mission with more slots or a \
                 shorter way"
            ),
        }
    }
}

/// The largest number of refusals at once.
pub const REFUSALS: usize = 5;

/// The radius and the ceiling of the autopilot's own geofence about its home: the name of the
/// parameter and metres.
pub(super) type OwnFence = [Option<(&'static str, f32)>; 2];

pub(super) fn own_fence(firmware: Firmware, parameter: impl Fn(&str) -> Option<f32>) -> OwnFence {
    let number = |name: &'static str| Some((name, parameter(name)?));
    // Zero disables a distance of PX4's fence.
    let above_zero = |name| number(name).filter(|&(_, limit_m)| limit_m > 0.0);
    match firmware {
        Firmware::Generic => [None, None],
        Firmware::ArduCopter => {
            let enabled = parameter("FENCE_ENABLE").is_some_and(|value| value != 0.0);
            let types = parameter("FENCE_TYPE").unwrap_or(0.0) as u32;
            let bit = |bit: u32| enabled && types & bit != 0;
            [
                number("FENCE_RADIUS").filter(|_| bit(2)),
                number("FENCE_ALT_MAX").filter(|_| bit(1)),
            ]
        }
        Firmware::Px4 => {
            // Action 0 does nothing, 1 only warns.
            let acts = parameter("GF_ACTION").is_some_and(|value| value >= 2.0);
            [
                above_zero("GF_MAX_HOR_DIST").filter(|_| acts),
                above_zero("GF_MAX_VER_DIST").filter(|_| acts),
            ]
        }
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    fn preflight() -> Preflight<f64> {
        Preflight {
            area: Some((Position::origin(), Position::new(1000.0, 500.0))),
            ..Preflight::default()
        }
    }

    #[test]
    fn distances_are_to_the_area_and_to_its_farthest_corner() {
        let start = Position::origin();
        let outside = |x, y| preflight().outside_m(&Position::new(x, y), &start);
        assert_eq!(outside(400.0, 200.0), 0.0);
        assert_eq!(outside(1300.0, 900.0), 500.0);
        assert_eq!(outside(-100.0, 200.0), 100.0);
        let farthest = preflight().farthest_m(&Position::new(400.0, 500.0));
        assert_eq!(farthest, Some((600.0f64 * 600.0 + 500.0 * 500.0).sqrt()));
        let nowhere = Preflight::<f64>::default();
        assert_eq!(nowhere.outside_m(&Position::new(3.0, 4.0), &start), 5.0);
        assert_eq!(nowhere.farthest_m(&start), None);
    }

    #[test]
    fn the_autopilots_own_fence_counts_where_it_acts() {
        let parameters = |all: &'static [(&str, f32)]| {
            move |name: &str| all.iter().find(|(known, _)| *known == name).map(|p| p.1)
        };
        let arducopter = |all| own_fence(Firmware::ArduCopter, parameters(all));
        let (radius, ceiling) = (("FENCE_RADIUS", 300.0), ("FENCE_ALT_MAX", 100.0));
        const OFF: &[(&str, f32)] = &[
            ("FENCE_ENABLE", 0.0),
            ("FENCE_TYPE", 7.0),
            ("FENCE_RADIUS", 300.0),
        ];
        assert_eq!(arducopter(OFF), [None, None]);
        const BOTH: &[(&str, f32)] = &[
            ("FENCE_ENABLE", 1.0),
            ("FENCE_TYPE", 7.0),
            ("FENCE_RADIUS", 300.0),
            ("FENCE_ALT_MAX", 100.0),
        ];
        assert_eq!(arducopter(BOTH), [Some(radius), Some(ceiling)]);
        const CEILING: &[(&str, f32)] = &[
            ("FENCE_ENABLE", 1.0),
            ("FENCE_TYPE", 1.0),
            ("FENCE_RADIUS", 300.0),
            ("FENCE_ALT_MAX", 100.0),
        ];
        assert_eq!(arducopter(CEILING), [None, Some(ceiling)]);
        const PX4: &[(&str, f32)] = &[
            ("GF_ACTION", 2.0),
            ("GF_MAX_HOR_DIST", 400.0),
            ("GF_MAX_VER_DIST", 0.0),
        ];
        let fence = own_fence(Firmware::Px4, parameters(PX4));
        assert_eq!(fence, [Some(("GF_MAX_HOR_DIST", 400.0)), None]);
    }

    #[test]
    fn a_refusal_has_both_numbers_and_what_to_change() {
        let slow = PreflightRefusal::TooSlow {
            needed_mps: 20.84,
            possible_mps: 9.5,
            parameter: Some(("WPNAV_SPEED", 3500.0)),
        };
        assert_eq!(
            slow.to_string(),
            "reaching the destination needs 20.8 m/s, but the vehicle's limits allow 9.5 m/s: set \
             WPNAV_SPEED to 3500"
        );
    }
}
