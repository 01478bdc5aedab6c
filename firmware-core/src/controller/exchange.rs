//! What goes into the controller and what comes out.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{
    inner::Status,
    mission::Mission,
    scalar::{Position, Scalar},
    shield::Intervention,
    units::{PowerGain, Watt},
};

/// The channels of one slot, measured at the position reached.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct ChannelState<T: Scalar, const M: usize, const J: usize> {
    /// Which slot this is about.
    pub slot: u32,
    /// `|g_m|^2` of every user; 0 for one that is not heard.
    pub user_gains: Vec<PowerGain<T>, M>,
    /// `|h_j|^2` of every sensor; 0 for one that is not heard.
    pub sensor_gains: Vec<PowerGain<T>, J>,
}

impl<T: Scalar, const M: usize, const J: usize> ChannelState<T, M, J> {
    /// The channels that the model gives for a vehicle over `vehicle`.
    pub fn predicted(mission: &Mission<T, M, J>, slot: u32, vehicle: &Position<T>) -> Self {
        let channel = mission.channel();
        let p = mission.parameters();
        let gain = |ground: &Position<T>| channel.power_gain(vehicle, ground);
        Self {
            slot,
            user_gains: p.users.iter().map(gain).collect(),
            sensor_gains: p.sensors.iter().map(gain).collect(),
        }
    }
}

/// What was decided before flying a slot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct Plan<T: Scalar> {
    /// `n`, 1 to `N`.
    pub slot: u32,
    /// Where to be at the slot's end, metres.
    pub waypoint: Position<T>,
    /// The user to serve.
    pub served_user: usize,
    /// What the shield changed of the policy's action.
    pub intervention: Intervention,
}

/// Where a slot's channel state came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChannelSource {
    /// From the ground, for this slot and position.
    Measured,
    /// None came in time: from the last that did, aged, and the channel model at the measured
    /// position.
    Predicted,
}

/// What everybody does in a slot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct SlotCommand<T: Scalar, const J: usize> {
    /// `n`, 1 to `N`.
    pub slot: u32,
    /// The user that transmits; `None` where no user was heard. It is another than planned
    /// where only the planned one was not heard.
    pub served_user: Option<usize>,
    /// `p`, its power.
    pub user_power: Watt<T>,
    /// `|b_j|` of every sensor, square root of watts.
    pub sensor_coefficients: Vec<T, J>,
    /// `eta`, one over square root of watts.
    pub normalizing_factor: T,
    /// `R_n`, bit/s/Hz; the least of it where gains are known within bounds only.
    pub rate: T,
    /// `MSE_n` with these powers, coefficients and `eta`; the most of it where gains are known
    /// within bounds only.
    pub mse: T,
    /// How the slot problem came out.
    pub status: Status<T>,
    /// Where the gains came from.
    pub source: ChannelSource,
    /// How old the channel state is, slots; 0 when it is this slot's.
    pub age_slots: u32,
    /// How many gains were NaN, infinite, negative or above 1 and counted as 0.
    pub rejected_gains: u16,
    /// How many sensors were not heard and stay silent: their gain is 0 or was rejected. The
    /// average is still over all `J`; each of these adds `1/J^2` to the MSE.
    pub unheard_sensors: u16,
}

impl<T: Scalar, const J: usize> SlotCommand<T, J> {
    /// Nobody transmits, and the average is estimated as 0: the command of last resort.
    pub(super) fn silent(slot: u32, sensors: usize) -> Self {
        let mse = T::one() / T::count(sensors);
        Self {
            slot,
            served_user: None,
            user_power: Watt(T::zero()),
            sensor_coefficients: core::iter::repeat_n(T::zero(), sensors).collect(),
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
