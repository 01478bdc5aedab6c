// SPDX-License-Identifier: MIT OR Apache-2.0
//! The inputs and outputs of the controller.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{
    channel::GroundNode,
    collect::collect_first,
    inner::Status,
    mission::Mission,
    scalar::{Position, Scalar},
    shield::Intervention,
    units::{PowerGain, Watt},
};

/// Checks, at compile time in a constant, that a [`SlotCommand`] can count the gains of so many users
/// and sensors, which it does with 16 bits.
///
/// # Panics
/// Panics if it cannot.
pub(crate) const fn check_gain_count(users: usize, sensors: usize) {
    const MOST: usize = u16::MAX as usize;
    assert!(
        users <= MOST && sensors <= MOST - users,
        "the capacities M for users and J for sensors are together more than 65,535, the most that \
         a slot command can count (`rejected_gains`, `unheard_sensors`)"
    );
}

/// The channels of one slot, measured at the position reached.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct ChannelState<T: Scalar, const M: usize, const J: usize> {
    /// The slot that the channels were measured in.
    pub slot: u32,
    /// `|g_m|^2` of every user; 0 for one that is not heard.
    pub user_gains: Vec<PowerGain<T>, M>,
    /// `|h_j|^2` of every sensor; 0 for one that is not heard.
    pub sensor_gains: Vec<PowerGain<T>, J>,
}

impl<T: Scalar, const M: usize, const J: usize> ChannelState<T, M, J> {
    /// Returns the mean gains that are known of the mission for a vehicle over `vehicle`.
    pub fn predicted(mission: &Mission<T, M, J>, slot: u32, vehicle: &Position<T>) -> Self {
        let gain = |node| mission.power_gain(node, vehicle);
        let users = (0..mission.user_count()).map(GroundNode::User);
        let sensors = (0..mission.sensor_count()).map(GroundNode::Sensor);
        Self {
            slot,
            user_gains: collect_first(users.map(gain)),
            sensor_gains: collect_first(sensors.map(gain)),
        }
    }
}

/// The decision for a slot, made before it is flown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct Plan<T: Scalar> {
    /// `n`, 1 to `N`.
    pub slot: u32,
    /// The place to be at by the slot's end, metres.
    pub waypoint: Position<T>,
    /// The user to serve.
    pub served_user: usize,
    /// What the shield changed in the policy's action.
    pub intervention: Intervention,
}

/// The origin of a slot's channel state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ChannelSource {
    /// From the ground, for this slot and position.
    Measured,
    /// No state was received in time: predicted from the last one, aged, and the channel model at
    /// the measured position.
    Predicted,
}

/// The transmissions of users and sensors in a slot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct SlotCommand<T: Scalar, const J: usize> {
    /// `n`, 1 to `N`.
    pub slot: u32,
    /// The user that transmits, or `None` where no user was heard. It differs from the planned user
    /// only where the planned one was not heard.
    pub served_user: Option<usize>,
    /// `p`, its power.
    pub user_power: Watt<T>,
    /// `|b_j|` of every sensor, square root of watts.
    pub sensor_coefficients: Vec<T, J>,
    /// `eta`, one over square root of watts.
    pub normalizing_factor: T,
    /// `R_n`, bit/s/Hz: one that can be achieved where the gains have errors
    /// ([`ChannelQuality`](super::ChannelQuality)); the smallest rate where they are known within bounds only.
    pub rate: T,
    /// `MSE_n` with these powers, coefficients and `eta`: its expectation where the gains have errors;
    /// the largest MSE where they are known within bounds only.
    pub mse: T,
    /// The status of the slot problem's solution. [`Status::ErrorFloor`] says that the gains are not
    /// known well enough for `Gamma`, whatever the powers.
    pub status: Status<T>,
    /// The origin of the gains.
    pub source: ChannelSource,
    /// The age of the channel state, slots; 0 when it is this slot's.
    pub age_slots: u32,
    /// The number of gains that were NaN, infinite, negative or above 1 and counted as 0.
    pub rejected_gains: u16,
    /// The number of sensors that were not heard and stay silent: their gain is 0 or was rejected.
    /// The average is still over all `J`; each of these adds `1/J^2` to the MSE.
    pub unheard_sensors: u16,
}

impl<T: Scalar, const J: usize> SlotCommand<T, J> {
    /// Returns the command in which nobody transmits and the average is estimated as 0, used where
    /// nothing else is possible.
    pub(super) fn silent(slot: u32, sensors: usize) -> Self {
        let mse = T::one() / T::count(sensors);
        Self {
            slot,
            served_user: None,
            user_power: Watt(T::zero()),
            sensor_coefficients: collect_first(core::iter::repeat_n(T::zero(), sensors)),
            normalizing_factor: T::zero(),
            rate: T::zero(),
            mse,
            status: Status::Infeasible { least_mse: mse },
            source: ChannelSource::Measured,
            age_slots: 0,
            rejected_gains: 0,
            unheard_sensors: 0,
        }
    }
}
