// SPDX-License-Identifier: MIT OR Apache-2.0
//! Changes of what is known of a mission while it is flown.

use core::{error::Error, fmt};

use serde::{Deserialize, Serialize};

use super::{error::MissionError, validated::Mission};
use crate::{
    scalar::{Position, Scalar},
    units::Watt,
};

/// A change of what is known of a mission. It states the new value, not the difference: the same
/// change made twice has the effect of one.
///
/// Users and sensors keep their numbers for the whole mission; a new one gets the next number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar", rename_all = "snake_case")]
pub enum MissionChange<T: Scalar> {
    /// User `user` is at `position_m`: it has moved, joined (the first unused number) or returned.
    User {
        /// The number of the user.
        user: u16,
        /// The position, metres.
        position_m: Position<T>,
    },
    /// User `user` has left: it is no longer served and owed nothing.
    UserLeft {
        /// The number of the user.
        user: u16,
    },
    /// Sensor `sensor` is at `position_m`: it has moved, joined (the first unused number) or
    /// returned.
    Sensor {
        /// The number of the sensor.
        sensor: u16,
        /// The position, metres.
        position_m: Position<T>,
    },
    /// Sensor `sensor` has left, for example because its battery is empty: the average is over the
    /// others.
    SensorLeft {
        /// The number of the sensor.
        sensor: u16,
    },
    /// `Gamma`.
    MseThreshold(T),
    /// `sigma^2`, watts.
    NoisePower(Watt<T>),
    /// `V_max`, metres per second.
    MaxSpeed(T),
    /// `N`, the number of slots of the whole mission.
    Slots(u32),
}

impl<T: Scalar> fmt::Display for MissionChange<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::User { user, position_m } => {
                write!(
                    f,
                    "user {user} is at [{}, {}] m",
                    position_m.x, position_m.y
                )
            }
            Self::UserLeft { user } => write!(f, "user {user} has left"),
            Self::Sensor { sensor, position_m } => {
                write!(
                    f,
                    "sensor {sensor} is at [{}, {}] m",
                    position_m.x, position_m.y
                )
            }
            Self::SensorLeft { sensor } => write!(f, "sensor {sensor} has left"),
            Self::MseThreshold(threshold) => write!(f, "the MSE threshold is {threshold}"),
            Self::NoisePower(power) => write!(f, "the noise power is {} W", power.0),
            Self::MaxSpeed(speed_mps) => write!(f, "the speed limit is {speed_mps} m/s"),
            Self::Slots(slots) => write!(f, "the mission has {slots} slots"),
        }
    }
}

/// Error returned when a change is refused. The mission is then as before.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ChangeError<T: fmt::Display> {
    /// The changed mission is invalid.
    Invalid(MissionError<T>),
    /// The number is neither that of a user or sensor nor the next one.
    UnknownNumber {
        /// `user` or `sensor`.
        what: &'static str,
        /// The number in the change.
        number: u16,
        /// The number that the next one to join gets.
        next: usize,
    },
    /// There is no capacity for one more.
    Full {
        /// `user` or `sensor`.
        what: &'static str,
        /// The number in the change.
        number: u16,
        /// How many there can be.
        capacity: usize,
    },
    /// The last user or sensor cannot leave.
    LastOne {
        /// `user` or `sensor`.
        what: &'static str,
        /// The number in the change.
        number: u16,
    },
    /// The gains of the mission come from a map, which is for the places of its nodes.
    OffTheMap {
        /// `user` or `sensor`.
        what: &'static str,
        /// The number in the change.
        number: u16,
    },
    /// More slots are done or under way than the mission would have.
    SlotsBegun {
        /// `N` in the change.
        slots: u32,
        /// The number of slots that are done or under way.
        begun: u32,
    },
}

impl<T: fmt::Display> fmt::Display for ChangeError<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Invalid(error) => error.fmt(f),
            Self::UnknownNumber { what, number, next } => write!(
                f,
                "{what} {number}, but must be at most {next}, the next unused number"
            ),
            Self::Full {
                what,
                number,
                capacity,
            } => write!(
                f,
                "{what} {number}, but there is capacity for {capacity}, numbered from 0"
            ),
            Self::LastOne { what, number } => {
                write!(f, "{what} {number} is the last one, and cannot leave")
            }
            Self::OffTheMap { what, number } => write!(
                f,
                "{what} {number} moves or joins, but radio.gain_map has gains for the places in the \
                 scenario only"
            ),
            Self::SlotsBegun { slots, begun } => {
                write!(f, "mission.slots is {slots}, but {begun} slots have begun")
            }
        }
    }
}

/// An invalid mission is not reported as a source, because its message is already this one's.
impl<T: fmt::Debug + fmt::Display> Error for ChangeError<T> {}

impl<T: fmt::Display> From<MissionError<T>> for ChangeError<T> {
    fn from(error: MissionError<T>) -> Self {
        Self::Invalid(error)
    }
}

impl<T: Scalar, const M: usize, const J: usize> Mission<T, M, J> {
    /// Makes a change after `slots_begun` slots are done or under way. Quotas follow: see
    /// [`quota_of`](Self::quota_of).
    ///
    /// Whether the destination is still within reach is not checked, because a vehicle that has
    /// become slower flies on: the shield then takes the shortest way.
    ///
    /// Worst case: the mission is copied, and every parameter is checked.
    ///
    /// # Errors
    /// Returns an error if the changed mission is invalid or exceeds the capacities; it is then as
    /// before.
    pub fn change(
        &mut self,
        change: &MissionChange<T>,
        slots_begun: u32,
    ) -> Result<(), ChangeError<T>> {
        self.check_map(change)?;
        let mut changed = self.clone();
        let p = &mut changed.parameters;
        match *change {
            MissionChange::User { user, position_m } => {
                let absent = &mut changed.absent_users;
                let joins = set_place(&mut p.users, absent, ("user", user), position_m)?;
                let user = usize::from(user);
                let is_back = joins || !self.has_user(user);
                if let Some(after) = changed.joined_after.get_mut(user).filter(|_| is_back) {
                    *after = slots_begun;
                }
            }
            MissionChange::Sensor { sensor, position_m } => {
                let absent = &mut changed.absent_sensors;
                set_place(&mut p.sensors, absent, ("sensor", sensor), position_m)?;
            }
            MissionChange::UserLeft { user } => {
                leave(&mut changed.absent_users, p.users.len(), ("user", user))?;
            }
            MissionChange::SensorLeft { sensor } => {
                let count = p.sensors.len();
                leave(&mut changed.absent_sensors, count, ("sensor", sensor))?;
            }
            MissionChange::MseThreshold(threshold) => p.mse_threshold = threshold,
            MissionChange::NoisePower(power) => p.noise_power = power,
            MissionChange::MaxSpeed(speed_mps) => p.max_speed_mps = speed_mps,
            MissionChange::Slots(slots) if slots < slots_begun => {
                let begun = slots_begun;
                return Err(ChangeError::SlotsBegun { slots, begun });
            }
            MissionChange::Slots(slots) => p.slots = slots,
        }
        changed.check()?;
        *self = changed;
        Ok(())
    }
}

impl<T: Scalar, const M: usize, const J: usize> Mission<T, M, J> {
    /// Checks that a map of gains, if there is one, has those of a node's new place.
    fn check_map(&self, change: &MissionChange<T>) -> Result<(), ChangeError<T>> {
        let p = &self.parameters;
        let (what, number, places, place) = match change {
            MissionChange::User { user, position_m } => {
                ("user", *user, p.users.as_slice(), position_m)
            }
            MissionChange::Sensor { sensor, position_m } => {
                ("sensor", *sensor, p.sensors.as_slice(), position_m)
            }
            _ => return Ok(()),
        };
        if !self.has_gain_map() || places.get(usize::from(number)) == Some(place) {
            return Ok(());
        }
        Err(ChangeError::OffTheMap { what, number })
    }
}

/// Sets the place of a user or sensor, which is there from now on, and returns whether it is a new
/// one.
fn set_place<T: Scalar, const N: usize>(
    places: &mut heapless::Vec<Position<T>, N>,
    absent: &mut [bool; N],
    (what, number): (&'static str, u16),
    position_m: Position<T>,
) -> Result<bool, ChangeError<T>> {
    let (index, next) = (usize::from(number), places.len());
    if index > next {
        return Err(ChangeError::UnknownNumber { what, number, next });
    }
    let full = ChangeError::Full {
        what,
        number,
        capacity: N,
    };
    *absent.get_mut(index).ok_or(full)? = false;
    match places.get_mut(index) {
        Some(place) => *place = position_m,
        None => places.push(position_m).map_err(|_| full)?,
    }
    Ok(index == next)
}

fn leave<T: Scalar, const N: usize>(
    absent: &mut [bool; N],
    count: usize,
    (what, number): (&'static str, u16),
) -> Result<(), ChangeError<T>> {
    let next = count;
    let unknown = ChangeError::UnknownNumber { what, number, next };
    let absent = absent.get_mut(..count).ok_or(unknown)?;
    *absent.get_mut(usize::from(number)).ok_or(unknown)? = true;
    if absent.iter().all(|&absent| absent) {
        return Err(ChangeError::LastOne { what, number });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_missions::table_one;

    const HERE: Position<f64> = Position::new(500.0, 500.0);

    /// Each refused change is named, and leaves the mission as it was.
    #[test]
    fn a_refused_change_changes_nothing() {
        let mission = table_one::<f64>();
        let refused = |change| {
            let mut changed = mission.clone();
            let error = changed.change(&change, 30).expect_err("refused");
            assert_eq!(changed, mission, "{change:?}");
            std::format!("{error}")
        };
        let position_m = HERE;
        for (change, words) in [
            (
                MissionChange::User {
                    user: 16,
                    position_m,
                },
                "user 16, but must be at most 15, the next unused number",
            ),
            (
                MissionChange::UserLeft { user: 15 },
                "user 15, but must be at most 15, the next unused number",
            ),
            (
                MissionChange::Sensor {
                    sensor: 3,
                    position_m: Position::new(-1.0, 5.0),
                },
                "sensors.positions_m[3] is [-1, 5]",
            ),
            (MissionChange::MseThreshold(0.5), "must be below 1/J"),
            (
                MissionChange::MseThreshold(f64::NAN),
                "aircomp.mse_threshold is NaN",
            ),
            (MissionChange::MaxSpeed(0.0), "mission.max_speed_mps is 0"),
            (
                MissionChange::Slots(29),
                "mission.slots is 29, but 30 slots have begun",
            ),
            (MissionChange::Slots(u32::MAX), "mission.slots is"),
            (MissionChange::NoisePower(Watt(-1.0)), "radio.noise_dbm is"),
        ] {
            let error = refused(change);
            assert!(error.contains(words), "{error}");
        }
    }

    #[test]
    fn users_join_up_to_the_capacity_and_all_but_the_last_may_leave() {
        let mut mission = table_one::<f64>();
        let join = |user| MissionChange::User {
            user,
            position_m: HERE,
        };
        assert_eq!(mission.change(&join(15), 30), Ok(()));
        assert_eq!(mission.user_count(), 16);
        let full = mission.change(&join(16), 30);
        assert!(matches!(full, Err(ChangeError::Full { capacity: 16, .. })));
        // 16 users: floor(60 / 16) for those from the start, floor(30 / 16) for the new one.
        assert_eq!((mission.quota_of(0), mission.quota_of(15)), (3, 1));
        for user in 0..15 {
            assert_eq!(
                mission.change(&MissionChange::UserLeft { user }, 40),
                Ok(())
            );
            assert!(!mission.has_user(user.into()));
            assert_eq!(mission.quota_of(user.into()), 0);
        }
        let last = mission.change(&MissionChange::UserLeft { user: 15 }, 40);
        assert!(matches!(last, Err(ChangeError::LastOne { number: 15, .. })));
        assert_eq!(mission.quota_of(15), 30);
    }

    #[test]
    fn the_threshold_is_for_the_sensors_that_are_there() {
        let mut mission = table_one::<f64>();
        let most = mission.slot_rate_limit();
        for sensor in 0..9 {
            let left = MissionChange::SensorLeft { sensor };
            assert_eq!(mission.change(&left, 10), Ok(()));
        }
        assert_eq!(
            (mission.sensor_count(), mission.sensors().count()),
            (36, 27)
        );
        assert!(mission.slot_rate_limit() < most);
    }
}
