//! The validated parameters of a mission: the paper's Table I and the positions of everything.
//!
//! [`MissionParameters`] is the unchecked input; [`Mission::new`] is the only function that checks
//! it. A [`Mission`] that exists is valid, and the rest of the crate relies on it:
//!
//! * every number is finite, every length, duration, speed and power in its range;
//! * start and destination lie in the area `Lambda`, and the destination can be reached:
//!   `||q_o - q_f|| <= (N + 1) V_max delta` (arrival means that `q_f` is at most one more slot
//!   away, eq:traj2 as corrected in `docs/mathematics.md`);
//! * `Gamma < 1/J`, so that the accuracy constraint is not met trivially.

use core::fmt;

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{
    SENSORS_MAX, USERS_MAX,
    channel::ChannelModel,
    scalar::{Position, Scalar},
    shield,
    units::Watt,
};

/// The largest number of slots that a mission may have.
pub const SLOTS_MAX: u32 = 100_000;

/// The best accuracy of a measured position, metres: MAVLink carries it in single precision, which
/// at a kilometre resolves 6e-5 m. Constraints on measured positions hold up to this value.
pub const MEASUREMENT_M: f64 = 1e-3;

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
    /// The environment's `A` and `B` of eq:plos.
    pub environment: Environment<T>,
    /// The excess losses of eq:gain.
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

/// The parameter that an error concerns. [`fmt::Display`] prints its name in the scenario file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs)] // the names are the parameters'
pub enum Parameter {
    Slots,
    SlotDuration,
    Start,
    Destination,
    Area,
    Altitude,
    MaxSpeed,
    Carrier,
    NoisePower,
    EnvironmentA,
    EnvironmentB,
    ExcessLossLos,
    ExcessLossNlos,
    MseThreshold,
    SensorPowerMax,
    UserPowerMax,
    UserPosition(usize),
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
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MissionError<T: fmt::Display> {
    /// A number is NaN, infinite or outside its range.
    #[error("{parameter} is {value}, but must be {expected}")]
    OutOfRange {
        /// The parameter.
        parameter: Parameter,
        /// Its value.
        value: T,
        /// The valid values, as text.
        expected: &'static str,
    },
    /// A place is not finite or lies outside the area.
    #[error(
        "{parameter} is [{east_m}, {north_m}], but must lie in the area \
         [0, {area_east_m}] x [0, {area_north_m}] (metres)"
    )]
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
    #[error("users.positions_m is empty, but at least one user must be served")]
    NoUsers,
    /// There are no sensors.
    #[error("sensors.positions_m is empty, but at least one sensor must be averaged")]
    NoSensors,
    /// `Gamma >= 1/J`: an estimate of constant zero would meet the threshold, so sensors would stay
    /// silent and AirComp would carry no data.
    #[error(
        "aircomp.mse_threshold is {value}, but must be below 1/J = {limit} \
         (J = {sensors} sensors): at or above it an all-zero estimate is accurate enough \
         and no sensor would transmit"
    )]
    MseThresholdTooLoose {
        /// `Gamma`.
        value: T,
        /// `1/J`.
        limit: T,
        /// `J`.
        sensors: usize,
    },
    /// The destination is further away than `(N + 1) V_max delta`.
    #[error(
        "mission.destination_m is {distance_m} m from mission.start_m, but must be within {reach_m} m: \
         (slots + 1) x max_speed_mps x slot_duration_s"
    )]
    DestinationOutOfReach {
        /// From start to destination, metres.
        distance_m: T,
        /// The distance that the mission can cover, metres.
        reach_m: T,
    },
}

/// A valid mission. The [module](self) states what that guarantees.
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
        let slack_m = shield::rounding_m(&p.area, reach_m).max(T::of(MEASUREMENT_M));
        (place - p.destination).norm() <= reach_m + slack_m
    }

    /// Returns the rate that no position can exceed, `log2(1 / (1 - J Gamma))`, bit/s/Hz per slot
    /// (docs/mathematics.md: `f <= J`).
    pub fn slot_rate_limit(&self) -> T {
        let slack = T::one() - T::count(self.sensor_count()) * self.parameters.mse_threshold;
        -slack.log2()
    }
}

impl<T: Scalar, const M: usize, const J: usize> MissionParameters<T, M, J> {
    fn check_numbers(&self) -> Result<(), MissionError<T>> {
        // Far beyond any real aircraft, but small enough for squares to stay finite in f32.
        let within = |parameter, value: T, low: f64, high: f64, expected| {
            let holds = value >= T::of(low) && value <= T::of(high);
            in_range(parameter, value, holds, expected)
        };
        let positive = |parameter, value: T| {
            let expected = "a number above 0 and at most 1000000";
            let holds = value > T::zero() && value <= T::of(1e6);
            in_range(parameter, value, holds, expected)
        };
        if self.slots == 0 || self.slots > SLOTS_MAX {
            return Err(MissionError::OutOfRange {
                parameter: Parameter::Slots,
                value: T::count(self.slots as usize),
                expected: "a whole number from 1 to 100000",
            });
        }
        within(
            Parameter::SlotDuration,
            self.slot_duration_s,
            0.1,
            3600.0,
            "from 0.1 to 3600 s",
        )?;
        positive(Parameter::Area, self.area.east_m)?;
        positive(Parameter::Area, self.area.north_m)?;
        within(
            Parameter::Altitude,
            self.altitude_m,
            1.0,
            20_000.0,
            "from 1 to 20000 m",
        )?;
        positive(Parameter::MaxSpeed, self.max_speed_mps)?;
        within(
            Parameter::Carrier,
            self.carrier_hz,
            1e6,
            1e12,
            "from 1e6 to 1e12 Hz",
        )?;
        in_range(
            Parameter::NoisePower,
            self.noise_power.0,
            self.noise_power.0 > T::zero(),
            "a finite power above 0 W",
        )?;
        positive(Parameter::EnvironmentA, self.environment.a)?;
        positive(Parameter::EnvironmentB, self.environment.b)?;
        let loss = |parameter, value: T| {
            in_range(
                parameter,
                value,
                value >= T::zero() && value <= T::of(200.0),
                "a loss from 0 to 200 dB",
            )
        };
        loss(Parameter::ExcessLossLos, self.excess_loss_db.los)?;
        loss(Parameter::ExcessLossNlos, self.excess_loss_db.nlos)?;
        in_range(
            Parameter::ExcessLossNlos,
            self.excess_loss_db.nlos,
            self.excess_loss_db.nlos >= self.excess_loss_db.los,
            "no less than radio.excess_loss_db.los",
        )?;
        in_range(
            Parameter::MseThreshold,
            self.mse_threshold,
            self.mse_threshold > T::zero(),
            "above 0 and below 1/J",
        )?;
        positive(Parameter::SensorPowerMax, self.sensor_power_max.0)?;
        positive(Parameter::UserPowerMax, self.user_power_max.0)
    }

    fn check_places(&self) -> Result<(), MissionError<T>> {
        self.check_place(Parameter::Start, &self.start)?;
        self.check_place(Parameter::Destination, &self.destination)?;
        if self.users.is_empty() {
            return Err(MissionError::NoUsers);
        }
        if self.sensors.is_empty() {
            return Err(MissionError::NoSensors);
        }
        for (index, place) in self.users.iter().enumerate() {
            self.check_place(Parameter::UserPosition(index), place)?;
        }
        for (index, place) in self.sensors.iter().enumerate() {
            self.check_place(Parameter::SensorPosition(index), place)?;
        }
        Ok(())
    }

    fn check_place(
        &self,
        parameter: Parameter,
        place: &Position<T>,
    ) -> Result<(), MissionError<T>> {
        // `contains` is false for NaN.
        if self.area.contains(place) {
            return Ok(());
        }
        Err(MissionError::OutsideArea {
            parameter,
            east_m: place.x,
            north_m: place.y,
            area_east_m: self.area.east_m,
            area_north_m: self.area.north_m,
        })
    }
}

fn in_range<T: Scalar>(
    parameter: Parameter,
    value: T,
    holds: bool,
    expected: &'static str,
) -> Result<(), MissionError<T>> {
    if holds && value.finite() {
        return Ok(());
    }
    Err(MissionError::OutOfRange {
        parameter,
        value,
        expected,
    })
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
