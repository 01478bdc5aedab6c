// SPDX-License-Identifier: MIT OR Apache-2.0
//! The ranges of the parameters of a mission.

use super::{
    error::{MissionError, Parameter},
    parameters::MissionParameters,
};
use crate::scalar::{Position, Scalar};

/// The largest number of slots that a mission may have.
pub const SLOTS_MAX: u32 = 100_000;

impl<T: Scalar, const M: usize, const J: usize> MissionParameters<T, M, J> {
    /// Checks every number.
    pub(super) fn check_numbers(&self) -> Result<(), MissionError<T>> {
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
        self.check_radio_model()?;
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

    /// Checks that the mission is within what its radio model is for.
    fn check_radio_model(&self) -> Result<(), MissionError<T>> {
        let model = self.radio_model;
        let Some(range) = model.valid_range::<T>() else {
            return Ok(());
        };
        let (above_m, up_to_m) = (range.above_m, range.up_to_m);
        let altitude_m = self.altitude_m;
        if altitude_m <= above_m || altitude_m > up_to_m {
            return Err(MissionError::AltitudeOutsideRadioModel {
                model,
                altitude_m,
                above_m,
                up_to_m,
            });
        }
        in_range(
            Parameter::Carrier,
            self.carrier_hz,
            self.carrier_hz >= T::of(0.5e9) && self.carrier_hz <= T::of(100e9),
            "from 0.5e9 to 100e9 Hz for the radio models of 3GPP TR 36.777, Annex B",
        )?;
        let (east_m, north_m) = (self.area.east_m, self.area.north_m);
        let diagonal_m = (east_m * east_m + north_m * north_m).sqrt();
        let limit_m = range.distance_m;
        if diagonal_m > limit_m {
            return Err(MissionError::AreaBeyondRadioModel {
                model,
                diagonal_m,
                limit_m,
            });
        }
        Ok(())
    }

    /// Checks every position.
    pub(super) fn check_places(&self) -> Result<(), MissionError<T>> {
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
