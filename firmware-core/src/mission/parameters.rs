// SPDX-License-Identifier: MIT OR Apache-2.0
//! The unchecked parameters of a mission.

use core::fmt;

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{
    scalar::{Position, Scalar},
    units::Watt,
};

/// The rectangle `Lambda = [0, east] x [0, north]`, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Area<T> {
    /// Extent to the east, metres.
    pub east_m: T,
    /// Extent to the north, metres.
    pub north_m: T,
}

impl<T: Scalar> Area<T> {
    /// Returns whether a place lies in the area, its border included.
    pub fn contains(&self, place: &Position<T>) -> bool {
        let within = |value: T, extent: T| value >= T::zero() && value <= extent;
        within(place.x, self.east_m) && within(place.y, self.north_m)
    }

    /// Returns the nearest place in the area.
    pub fn nearest(&self, place: &Position<T>) -> Position<T> {
        let within = |value: T, extent: T| value.max(T::zero()).min(extent);
        Position::new(within(place.x, self.east_m), within(place.y, self.north_m))
    }
}

/// The unchecked parameters of a mission. Units are metres, seconds, watts, hertz and decibels.
///
/// `M` is the capacity for users, `J` the capacity for sensors; the mission's own numbers of users
/// and sensors are the lengths of the two vectors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct MissionParameters<T: Scalar, const M: usize, const J: usize> {
    /// `N`, the number of slots.
    pub slots: u32,
    /// `delta`, the duration of a slot, seconds.
    pub slot_duration_s: T,
    /// `q_o`, the start of the mission.
    pub start: Position<T>,
    /// `q_f`, the destination of the mission.
    pub destination: Position<T>,
    /// `Lambda`, the area that the vehicle never leaves.
    pub area: Area<T>,
    /// `H`, metres.
    pub altitude_m: T,
    /// `V_max`, metres per second.
    pub max_speed_mps: T,
    /// `f_c`, hertz.
    pub carrier_hz: T,
    /// The model of the mean channel gain.
    pub radio_model: RadioModel,
    /// The environment's `A` and `B` of eq:plos, which [`RadioModel::ProbabilisticLos`] uses.
    pub environment: Environment<T>,
    /// The excess losses of eq:gain, which [`RadioModel::ProbabilisticLos`] uses.
    pub excess_loss_db: ExcessLoss<T>,
    /// `sigma^2`, watts.
    pub noise_power: Watt<T>,
    /// `Gamma`, the largest admissible MSE of the average, dimensionless.
    pub mse_threshold: T,
    /// `p^max`, the peak power of a user, watts.
    pub user_power_max: Watt<T>,
    /// `p_b^max`, the peak power of a sensor, watts: `|b_j|^2 <= p_b^max`.
    pub sensor_power_max: Watt<T>,
    /// `u_m`, the positions of the users.
    pub users: Vec<Position<T>, M>,
    /// `v_j`, the positions of the sensors.
    pub sensors: Vec<Position<T>, J>,
}

impl<T: Scalar, const M: usize, const J: usize> MissionParameters<T, M, J> {
    /// Returns the values of the paper's Table I, without any user or sensor.
    ///
    /// ```
    /// use firmware_core::{Mission, Position, mission::MissionParameters};
    ///
    /// let mission = Mission::new(MissionParameters::<f64, 4, 8> {
    ///     users: [Position::new(200.0, 700.0)].into_iter().collect(),
    ///     sensors: [Position::new(700.0, 100.0), Position::new(800.0, 300.0)].into_iter().collect(),
    ///     ..MissionParameters::table_one()
    /// })?;
    /// assert_eq!((mission.slots(), mission.user_count(), mission.sensor_count()), (60, 1, 2));
    /// # Ok::<(), firmware_core::mission::MissionError<f64>>(())
    /// ```
    pub fn table_one() -> Self {
        let place = |x: f64, y: f64| Position::new(T::of(x), T::of(y));
        Self {
            slots: 60,
            slot_duration_s: T::one(),
            start: place(50.0, 50.0),
            destination: place(950.0, 950.0),
            area: Area {
                east_m: T::of(1000.0),
                north_m: T::of(1000.0),
            },
            altitude_m: T::of(100.0),
            max_speed_mps: T::of(30.0),
            carrier_hz: T::of(2e9),
            radio_model: RadioModel::ProbabilisticLos,
            environment: Environment {
                a: T::of(9.613),
                b: T::of(0.158),
            },
            excess_loss_db: ExcessLoss {
                los: T::one(),
                nlos: T::of(20.0),
            },
            noise_power: Watt::from_dbm(T::of(-95.0)),
            mse_threshold: T::of(0.015),
            user_power_max: Watt(T::of(0.2)),
            sensor_power_max: Watt(T::of(0.05)),
            users: Vec::new(),
            sensors: Vec::new(),
        }
    }
}

/// The model of the mean channel gain. [`fmt::Display`] prints its name in the scenario file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "kebab-case")]
pub enum RadioModel {
    /// The paper's probabilistic line of sight (eq:gain to eq:gmn).
    #[default]
    ProbabilisticLos,
    /// Urban macro of 3GPP TR 36.777, Annex B.
    UmaAv,
    /// Urban micro (street canyon) of 3GPP TR 36.777, Annex B.
    UmiAv,
    /// Rural macro of 3GPP TR 36.777, Annex B.
    RmaAv,
}

impl fmt::Display for RadioModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::ProbabilisticLos => "probabilistic-los",
            Self::UmaAv => "uma-av",
            Self::UmiAv => "umi-av",
            Self::RmaAv => "rma-av",
        })
    }
}

/// `A` and `B` of eq:plos; `A` is also the elevation (degrees) around which the probability of
/// line of sight changes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Environment<T> {
    /// `A`.
    pub a: T,
    /// `B`, per degree.
    pub b: T,
}

/// `mu_LoS` and `mu_NLoS` of eq:gain, decibels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExcessLoss<T> {
    /// The loss with line of sight.
    pub los: T,
    /// The loss without line of sight.
    pub nlos: T,
}
