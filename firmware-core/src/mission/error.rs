// SPDX-License-Identifier: MIT OR Apache-2.0
//! The errors of a mission, which name the parameter and its value.

use core::{error::Error, fmt};

use serde::{Deserialize, Serialize};

use super::parameters::RadioModel;

/// The parameter that an error concerns. [`fmt::Display`] prints its name in the scenario file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Parameter {
    /// `N`, the number of slots.
    Slots,
    /// `delta`, the duration of a slot.
    SlotDuration,
    /// `q_o`, the start.
    Start,
    /// `q_f`, the destination.
    Destination,
    /// `Lambda`, the area.
    Area,
    /// `H`, the altitude.
    Altitude,
    /// `V_max`, the largest speed.
    MaxSpeed,
    /// `f_c`, the carrier frequency.
    Carrier,
    /// `sigma^2`, the noise power.
    NoisePower,
    /// `A` of eq:plos.
    EnvironmentA,
    /// `B` of eq:plos.
    EnvironmentB,
    /// `mu_LoS`, the excess loss with line of sight.
    ExcessLossLos,
    /// `mu_NLoS`, the excess loss without line of sight.
    ExcessLossNlos,
    /// `Gamma`, the largest admissible MSE.
    MseThreshold,
    /// `p_b^max`, the peak power of a sensor.
    SensorPowerMax,
    /// `p^max`, the peak power of a user.
    UserPowerMax,
    /// `u_m`, the position of the user with this index.
    UserPosition(usize),
    /// `v_j`, the position of the sensor with this index.
    SensorPosition(usize),
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Self::Slots => "mission.slots",
            Self::SlotDuration => "mission.slot_duration_s",
            Self::Start => "mission.start_m",
            Self::Destination => "mission.destination_m",
            Self::Area => "mission.area_m",
            Self::Altitude => "mission.altitude_m",
            Self::MaxSpeed => "mission.max_speed_mps",
            Self::Carrier => "radio.carrier_hz",
            Self::NoisePower => "radio.noise_dbm",
            Self::EnvironmentA => "radio.environment.a",
            Self::EnvironmentB => "radio.environment.b",
            Self::ExcessLossLos => "radio.excess_loss_db.los",
            Self::ExcessLossNlos => "radio.excess_loss_db.nlos",
            Self::MseThreshold => "aircomp.mse_threshold",
            Self::SensorPowerMax => "aircomp.sensor_power_max_w",
            Self::UserPowerMax => "users.power_max_w",
            Self::UserPosition(index) => return write!(f, "users.positions_m[{index}]"),
            Self::SensorPosition(index) => return write!(f, "sensors.positions_m[{index}]"),
        };
        f.write_str(name)
    }
}

/// Error returned when the mission is invalid. Every variant carries the invalid value.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MissionError<T: fmt::Display> {
    /// A number is NaN, infinite or outside its range.
    OutOfRange {
        /// The parameter.
        parameter: Parameter,
        /// The invalid value.
        value: T,
        /// The valid values, as text.
        expected: &'static str,
    },
    /// A place is not finite or lies outside the area.
    OutsideArea {
        /// The parameter.
        parameter: Parameter,
        /// East of the origin, metres.
        east_m: T,
        /// North of the origin, metres.
        north_m: T,
        /// The area's extent to the east, metres.
        area_east_m: T,
        /// The area's extent to the north, metres.
        area_north_m: T,
    },
    /// There are no users.
    NoUsers,
    /// There are no sensors.
    NoSensors,
    /// `Gamma >= 1/J`: an estimate of constant zero would meet the threshold, so sensors would stay
    /// silent and AirComp would carry no data.
    MseThresholdTooLoose {
        /// `Gamma`.
        value: T,
        /// `1/J`.
        limit: T,
        /// `J`.
        sensors: usize,
    },
    /// The altitude is not one that the radio model is for.
    AltitudeOutsideRadioModel {
        /// The radio model.
        model: RadioModel,
        /// `H`, metres.
        altitude_m: T,
        /// `H` must be greater than this, metres.
        above_m: T,
        /// `H` must be at most this, metres.
        up_to_m: T,
    },
    /// The area is larger than the distances that the radio model is for.
    AreaBeyondRadioModel {
        /// The radio model.
        model: RadioModel,
        /// The diagonal of the area, metres.
        diagonal_m: T,
        /// The longest horizontal distance of the model, metres.
        limit_m: T,
    },
    /// The destination is further away than `(N + 1) V_max delta`.
    DestinationOutOfReach {
        /// From start to destination, metres.
        distance_m: T,
        /// The distance that the mission can cover, metres.
        reach_m: T,
    },
}

impl<T: fmt::Display> fmt::Display for MissionError<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfRange {
                parameter,
                value,
                expected,
            } => write!(f, "{parameter} is {value}, but must be {expected}"),
            Self::OutsideArea {
                parameter,
                east_m,
                north_m,
                area_east_m,
                area_north_m,
            } => write!(
                f,
                "{parameter} is [{east_m}, {north_m}], but must lie in the area \
                 [0, {area_east_m}] x [0, {area_north_m}] (metres)"
            ),
            Self::NoUsers => {
                f.write_str("users.positions_m is empty, but at least one user must be served")
            }
            Self::NoSensors => f.write_str(
                "sensors.positions_m is empty, but at least one sensor must be averaged",
            ),
            Self::MseThresholdTooLoose {
                value,
                limit,
                sensors,
            } => write!(
                f,
                "aircomp.mse_threshold is {value}, but must be below 1/J = {limit} \
                 (J = {sensors} sensors): at or above it an all-zero estimate is accurate enough \
                 and no sensor would transmit"
            ),
            Self::AltitudeOutsideRadioModel {
                model,
                altitude_m,
                above_m,
                up_to_m,
            } => write!(
                f,
                "mission.altitude_m is {altitude_m}, but must be above {above_m} and at most \
                 {up_to_m} m for radio.model \"{model}\" (3GPP TR 36.777, Annex B)"
            ),
            Self::AreaBeyondRadioModel {
                model,
                diagonal_m,
                limit_m,
            } => write!(
                f,
                "mission.area_m has a diagonal of {diagonal_m} m, but it must be at most {limit_m} m \
                 for radio.model \"{model}\" (3GPP TR 36.777, Annex B)"
            ),
            Self::DestinationOutOfReach {
                distance_m,
                reach_m,
            } => write!(
                f,
                "mission.destination_m is {distance_m} m from mission.start_m, but must be within \
                 {reach_m} m: (slots + 1) x max_speed_mps x slot_duration_s"
            ),
        }
    }
}

impl<T: fmt::Debug + fmt::Display> Error for MissionError<T> {}
