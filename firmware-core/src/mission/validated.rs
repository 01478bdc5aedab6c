// SPDX-License-Identifier: MIT OR Apache-2.0
//! A mission whose parameters have been checked.

use serde::{Deserialize, Serialize};

use super::{
    error::MissionError,
    parameters::MissionParameters,
    tolerance::{MEASUREMENT_M, rounding_m},
};
#[cfg(feature = "gain-map")]
use crate::channel::gain_map::GainMap;
use crate::{
    SENSORS_MAX, USERS_MAX,
    channel::{ChannelModel, GroundNode},
    scalar::{Position, Scalar},
    units::PowerGain,
};

/// A valid mission. The [module](super) states what that guarantees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    bound = "T: Scalar",
    into = "MissionParameters<T, M, J>",
    try_from = "MissionParameters<T, M, J>"
)]
pub struct Mission<T: Scalar, const M: usize = USERS_MAX, const J: usize = SENSORS_MAX> {
    pub(super) parameters: MissionParameters<T, M, J>,
    channel: ChannelModel<T>,
    /// The gains, where they do not come from the channel model.
    #[cfg(feature = "gain-map")]
    gain_map: Option<GainMap>,
    /// The users and sensors that left.
    pub(super) absent_users: [bool; M],
    pub(super) absent_sensors: [bool; J],
    /// The number of slots that were done when each user joined; 0 for those from the start.
    pub(super) joined_after: [u32; M],
}

impl<T: Scalar, const M: usize, const J: usize> Mission<T, M, J> {
    /// Checks the parameters. This is the only way to create a mission.
    ///
    /// # Errors
    /// Returns the first error, in the order of the scenario file.
    pub fn new(parameters: MissionParameters<T, M, J>) -> Result<Self, MissionError<T>> {
        let mission = Self {
            channel: ChannelModel::new(&parameters),
            #[cfg(feature = "gain-map")]
            gain_map: None,
            parameters,
            absent_users: [false; M],
            absent_sensors: [false; J],
            joined_after: [0; M],
        };
        mission.check()?;
        let p = &mission.parameters;
        let distance_m = (p.destination - p.start).norm();
        let reach_m = T::count(p.slots as usize + 1) * mission.reach_m();
        if distance_m > reach_m {
            return Err(MissionError::DestinationOutOfReach {
                distance_m,
                reach_m,
            });
        }
        Ok(mission)
    }

    /// Checks every parameter by itself, and `Gamma` for the sensors that are there.
    pub(super) fn check(&self) -> Result<(), MissionError<T>> {
        let p = &self.parameters;
        p.check_numbers()?;
        p.check_places()?;
        let sensors = self.sensors().count();
        if p.mse_threshold * T::count(sensors) >= T::one() {
            return Err(MissionError::MseThresholdTooLoose {
                value: p.mse_threshold,
                limit: T::one() / T::count(sensors),
                sensors,
            });
        }
        Ok(())
    }

    /// Returns the parameters of the mission.
    pub fn parameters(&self) -> &MissionParameters<T, M, J> {
        &self.parameters
    }

    /// Returns the model of the air-to-ground channel over the area.
    pub fn channel(&self) -> &ChannelModel<T> {
        &self.channel
    }

    /// Returns the mission with gains from a map in place of those of the channel model.
    #[cfg(feature = "gain-map")]
    #[must_use]
    pub fn with_gain_map(mut self, map: GainMap) -> Self {
        self.gain_map = Some(map);
        self
    }

    /// Returns whether the gains come from a map. They are then no function of the distance alone.
    pub fn has_gain_map(&self) -> bool {
        #[cfg(feature = "gain-map")]
        return self.gain_map.is_some();
        #[cfg(not(feature = "gain-map"))]
        false
    }

    /// Returns bounds on the gain of a node with the vehicle up to `radius_m` from `vehicle`, if the
    /// gains come from a map.
    #[cfg(feature = "policy")]
    pub(crate) fn map_bounds(
        &self,
        node: GroundNode,
        vehicle: &Position<T>,
        radius_m: T,
    ) -> Option<(PowerGain<T>, PowerGain<T>)> {
        #[cfg(feature = "gain-map")]
        return Some(self.gain_map?.bounds(node, vehicle, radius_m));
        #[cfg(not(feature = "gain-map"))]
        {
            let _ = (node, vehicle, radius_m);
            None
        }
    }

    /// Returns the mean power gain between a vehicle over `vehicle` and a node on the ground: that
    /// of the map, if there is one, and otherwise that of the channel model; 0 for a node that the
    /// mission does not have. Worst case: as [`ChannelModel::power_gain`].
    pub fn power_gain(&self, node: GroundNode, vehicle: &Position<T>) -> PowerGain<T> {
        #[cfg(feature = "gain-map")]
        if let Some(map) = &self.gain_map {
            return map.power_gain(node, vehicle);
        }
        let ground = match node {
            GroundNode::User(user) => self.parameters.users.get(user),
            GroundNode::Sensor(sensor) => self.parameters.sensors.get(sensor),
        };
        ground.map_or(PowerGain(T::zero()), |ground| {
            self.channel.power_gain(vehicle, ground)
        })
    }

    /// Returns `N`, the number of slots.
    pub fn slots(&self) -> u32 {
        self.parameters.slots
    }

    /// Returns `M`, the number of users of the mission (not the capacity), including any that left.
    pub fn user_count(&self) -> usize {
        self.parameters.users.len()
    }

    /// Returns `J`, the number of sensors of the mission (not the capacity), including any that
    /// left.
    pub fn sensor_count(&self) -> usize {
        self.parameters.sensors.len()
    }

    /// Returns whether the mission has this user now: the number exists, and the user has not left.
    pub fn has_user(&self, user: usize) -> bool {
        user < self.user_count() && self.absent_users.get(user) == Some(&false)
    }

    /// Returns whether the mission has this sensor now: the number exists, and it has not left.
    pub fn has_sensor(&self, sensor: usize) -> bool {
        sensor < self.sensor_count() && self.absent_sensors.get(sensor) == Some(&false)
    }

    /// Returns those of `values`, one per sensor, that belong to sensors that have not left.
    pub fn of_sensors<'a, V>(&'a self, values: &'a [V]) -> impl Iterator<Item = &'a V> + Clone {
        let values = values.iter().zip(&self.absent_sensors);
        values.filter_map(|(value, &absent)| (!absent).then_some(value))
    }

    /// Moves values to their sensors: `values`, one per sensor, begins with those of the sensors
    /// that have not left. The others get `none`.
    #[cfg(feature = "policy")]
    pub(crate) fn spread_to_sensors<V: Copy>(&self, values: &mut [V], none: V) {
        let sensors = self.sensor_count().min(values.len());
        let absent = self.absent_sensors.iter().take(sensors);
        let mut next = absent.clone().filter(|&&absent| !absent).count();
        if next == sensors {
            return;
        }
        for (sensor, &absent) in absent.enumerate().rev() {
            let mut value = none;
            if !absent {
                next = next.saturating_sub(1);
                value = values.get(next).copied().unwrap_or(none);
            }
            if let Some(place) = values.get_mut(sensor) {
                *place = value;
            }
        }
    }

    /// Returns number and position of every user that has not left.
    pub fn users(&self) -> impl Iterator<Item = (usize, &Position<T>)> + Clone {
        let users = self.parameters.users.iter().enumerate();
        users.filter(|&(user, _)| self.has_user(user))
    }

    /// Returns number and position of every sensor that has not left.
    pub fn sensors(&self) -> impl Iterator<Item = (usize, &Position<T>)> + Clone {
        let sensors = self.parameters.sensors.iter().enumerate();
        sensors.filter(|&(sensor, _)| self.has_sensor(sensor))
    }

    /// Returns the number of slots that a user must be served in: eq:a3 for the users that are
    /// there, `floor((N - n) / M)` for one that joined after `n` slots, and 0 for one that left.
    pub fn quota_of(&self, user: usize) -> u32 {
        if !self.has_user(user) {
            return 0;
        }
        let joined_after = self.joined_after.get(user).copied().unwrap_or(0);
        let slots = self.slots().saturating_sub(joined_after);
        // There is this user at least.
        slots.checked_div(self.users().count() as u32).unwrap_or(0)
    }

    /// Returns `floor(N / M)`, the number of slots that every user must be served in (eq:a3), for a
    /// mission in which nobody joins or leaves; otherwise see [`quota_of`](Self::quota_of).
    pub fn quota(&self) -> u32 {
        let users = self.parameters.users.len() as u32;
        // A mission has users.
        self.parameters.slots.checked_div(users).unwrap_or(0)
    }

    /// Returns `V_max delta`, the distance that the vehicle can fly in a slot, metres (eq:traj1).
    pub fn reach_m(&self) -> T {
        self.parameters.max_speed_mps * self.parameters.slot_duration_s
    }

    /// Returns whether a mission that ends over `place` has arrived: the destination is at most one
    /// more slot away (eq:traj2, as corrected), up to [`MEASUREMENT_M`] or to rounding where that
    /// is coarser.
    pub fn has_arrived(&self, place: &Position<T>) -> bool {
        let (p, reach_m) = (&self.parameters, self.reach_m());
        let slack_m = rounding_m(&p.area, reach_m).max(T::of(MEASUREMENT_M));
        (place - p.destination).norm() <= reach_m + slack_m
    }

    /// Returns the rate that no position can exceed, `log2(1 / (1 - J Gamma))`, bit/s/Hz per slot
    /// (docs/mathematics.md: `f <= J`).
    pub fn slot_rate_limit(&self) -> T {
        let slack = T::one() - T::count(self.sensors().count()) * self.parameters.mse_threshold;
        -slack.log2()
    }
}

impl<T: Scalar, const M: usize, const J: usize> From<Mission<T, M, J>>
    for MissionParameters<T, M, J>
{
    fn from(mission: Mission<T, M, J>) -> Self {
        mission.parameters
    }
}

impl<T: Scalar, const M: usize, const J: usize> TryFrom<MissionParameters<T, M, J>>
    for Mission<T, M, J>
{
    type Error = MissionError<T>;

    fn try_from(parameters: MissionParameters<T, M, J>) -> Result<Self, Self::Error> {
        Self::new(parameters)
    }
}
