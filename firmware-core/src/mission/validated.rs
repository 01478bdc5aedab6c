//! A mission whose parameters have been checked.

use serde::{Deserialize, Serialize};

use super::{
    error::MissionError,
    parameters::MissionParameters,
    tolerance::{MEASUREMENT_M, rounding_m},
};
use crate::{
    SENSORS_MAX, USERS_MAX,
    channel::ChannelModel,
    scalar::{Position, Scalar},
};

/// A valid mission. The [module](super) states what that guarantees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    bound = "T: Scalar",
    into = "MissionParameters<T, M, J>",
    try_from = "MissionParameters<T, M, J>"
)]
pub struct Mission<T: Scalar, const M: usize = USERS_MAX, const J: usize = SENSORS_MAX> {
    parameters: MissionParameters<T, M, J>,
    channel: ChannelModel<T>,
}

impl<T: Scalar, const M: usize, const J: usize> Mission<T, M, J> {
    /// Checks the parameters. This is the only way to create a mission.
    ///
    /// # Errors
    /// Returns the first error, in the order of the scenario file.
    pub fn new(parameters: MissionParameters<T, M, J>) -> Result<Self, MissionError<T>> {
        let p = &parameters;
        p.check_numbers()?;
        p.check_places()?;
        let sensors = T::count(p.sensors.len());
        if p.mse_threshold * sensors >= T::one() {
            return Err(MissionError::MseThresholdTooLoose {
                value: p.mse_threshold,
                limit: T::one() / sensors,
                sensors: p.sensors.len(),
            });
        }
        let distance_m = (p.destination - p.start).norm();
        let reach_m = T::count(p.slots as usize + 1) * p.max_speed_mps * p.slot_duration_s;
        if distance_m > reach_m {
            return Err(MissionError::DestinationOutOfReach {
                distance_m,
                reach_m,
            });
        }
        let channel = ChannelModel::new(p);
        Ok(Self {
            parameters,
            channel,
        })
    }

    /// Returns the parameters of the mission.
    pub fn parameters(&self) -> &MissionParameters<T, M, J> {
        &self.parameters
    }

    /// Returns the air-to-ground channel over the area.
    pub fn channel(&self) -> &ChannelModel<T> {
        &self.channel
    }

    /// Returns `N`, the number of slots.
    pub fn slots(&self) -> u32 {
        self.parameters.slots
    }

    /// Returns `M`, the number of users of the mission (not the capacity).
    pub fn user_count(&self) -> usize {
        self.parameters.users.len()
    }

    /// Returns `J`, the number of sensors of the mission (not the capacity).
    pub fn sensor_count(&self) -> usize {
        self.parameters.sensors.len()
    }

    /// Returns `floor(N / M)`, the number of slots that every user must be served in (eq:a3).
    pub fn quota(&self) -> u32 {
        self.parameters.slots / self.parameters.users.len() as u32
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
        let slack = T::one() - T::count(self.sensor_count()) * self.parameters.mse_threshold;
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
