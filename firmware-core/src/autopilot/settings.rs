// SPDX-License-Identifier: MIT OR Apache-2.0
//! The settings of the client. A client that exists has valid settings.

use nalgebra::Vector2;
use thiserror::Error;

use super::command::Patience;
use super::failsafe::Watch;
use super::frames::Geodetic;
use super::preflight::Preflight;
use super::wire::Address;
use crate::limits::MotionLimits;
use crate::scalar::{Position, Scalar};
use crate::time::Duration;

/// The kind of coordinates in which setpoints are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coordinates {
    /// SET_POSITION_TARGET_LOCAL_NED: metres, exact to f32.
    #[default]
    Local,
    /// SET_POSITION_TARGET_GLOBAL_INT: 1e-7 degrees, some 1 cm; does not depend on where the
    /// autopilot's estimator started.
    Global,
}

/// The region that the vehicle may be sent to: a rectangle on the map and a ceiling.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct Geofence<T: Scalar> {
    /// South-west corner, m.
    pub low: Position<T>,
    /// North-east corner, m.
    pub high: Position<T>,
    /// Ceiling above the place of take-off, m.
    pub ceiling_m: T,
}

impl<T: Scalar> Geofence<T> {
    /// Returns whether a place is inside by at least `margin_m` (if negative: outside by less than
    /// that).
    pub fn contains(&self, place: &Position<T>, margin_m: T) -> bool {
        place.x >= self.low.x + margin_m
            && place.y >= self.low.y + margin_m
            && place.x <= self.high.x - margin_m
            && place.y <= self.high.y - margin_m
    }

    /// Returns the nearest place inside.
    pub fn clamp(&self, place: Position<T>) -> Position<T> {
        Position::new(
            place.x.max(self.low.x).min(self.high.x),
            place.y.max(self.low.y).min(self.high.y),
        )
    }
}

/// The address that the client's own frames carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OwnAddress {
    /// System id, 1 to 255; `None` for that of the vehicle, as MAVLink specifies for an onboard
    /// computer.
    pub system: Option<u8>,
    /// Component id, 2 to 255: 0 means every component, and 1 is the autopilot.
    pub component: u8,
}

impl OwnAddress {
    /// The address of an onboard computer of the vehicle (MAV_COMP_ID_ONBOARD_COMPUTER).
    pub const ONBOARD_COMPUTER: Self = Self {
        system: None,
        component: 191,
    };

    /// Returns the address, with the system id of the vehicle where it is known. Until then, system
    /// 1 is used.
    pub fn resolve(self, vehicle: Option<u8>) -> Address {
        Address {
            system: self.system.or(vehicle).unwrap_or(1),
            component: self.component,
        }
    }
}

/// The settings of the client. [`AutopilotSettings::new`] returns the defaults.
#[derive(Clone, Copy, Debug)]
pub struct AutopilotSettings<T: Scalar> {
    /// The address that our frames carry. By default the vehicle's onboard computer.
    pub own: OwnAddress,
    /// The vehicle's system id; `None` selects the first autopilot that is heard.
    pub vehicle: Option<u8>,
    /// The position of the map's origin on Earth.
    pub map_origin: Geodetic,
    /// The start of the mission, m.
    pub start: Position<T>,
    /// Flight altitude above the place of take-off (the paper's H), m.
    pub altitude_m: T,
    /// The limits of the vehicle; infinite for the paper's kinematics.
    pub limits: MotionLimits<T>,
    /// The speed that the airframe is known to reach, m/s. Where it is `None` and parameters had to
    /// be set, a trial leg before the first slot measures it.
    pub airframe_speed_mps: Option<T>,
    /// Speed of the flight to the start, m/s.
    pub transit_speed_mps: T,
    /// Rate of climb where take-off is flown with setpoints, m/s.
    pub climb_speed_mps: T,
    /// The geofence; `None` for no limit.
    pub geofence: Option<Geofence<T>>,
    /// Time between setpoints: 50 to 200 ms.
    pub setpoint_interval: Duration,
    /// The requested time between position samples.
    pub telemetry_interval: Duration,
    /// The kind of coordinates of setpoints.
    pub coordinates: Coordinates,
    /// The distance at which the start and the altitude count as reached, m.
    pub arrival_radius_m: T,
    /// The distance up to which a leg starts from the reference and not from the vehicle, m.
    pub lag_tolerance_m: T,
    /// How long after a slot's end a position sample is waited for, in vehicle time.
    pub sample_patience: Duration,
    /// How long after a leg's end the vehicle continues its motion until the next leg is known;
    /// then it stops. In vehicle time.
    pub coast: Duration,
    /// Time-outs and attempts of commands.
    pub patience: Patience,
    /// The comparisons with the vehicle before take-off.
    pub preflight: Preflight<T>,
    /// Whether parameters that limit the mission are set, and restored after it. Off by default:
    /// then their limits are reported and obeyed.
    pub set_parameters: bool,
    /// The thresholds and time-outs of the failsafes.
    pub watch: Watch<T>,
}

/// Error returned for an invalid setting.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// A number is not finite, or not above zero.
    #[error("{name} is {value}; it must be a number above 0")]
    NotPositive {
        /// The name of the setting.
        name: &'static str,
        /// The invalid value.
        value: f64,
    },
    /// The setpoint interval is too short or too long for any autopilot.
    #[error("setpoint_interval is {micros} us; it must be from 50 000 to 200 000 us (5 to 20 Hz)")]
    SetpointInterval {
        /// The invalid value, us.
        micros: u64,
    },
    /// The start is not inside the fence.
    #[error("the start ({x}, {y}) m is outside the geofence")]
    StartOutsideFence {
        /// East, m.
        x: f64,
        /// North, m.
        y: f64,
    },
    /// A margin is not finite, or below zero.
    #[error("{name} is {value}; it must be a number, 0 or above")]
    Negative {
        /// The name of the setting.
        name: &'static str,
        /// The invalid value.
        value: f64,
    },
    /// The flight altitude is above the fence's ceiling.
    #[error(
        "altitude_m is {altitude_m}; it must be at most {ceiling_m}, the ceiling of the geofence"
    )]
    AboveCeiling {
        /// The altitude, m.
        altitude_m: f64,
        /// The ceiling, m.
        ceiling_m: f64,
    },
    /// The system or component id is not valid for a client.
    #[error(
        "own address: system {system}, component {component}; ids of a client are 1 to 255, \
             and component 1 is the autopilot"
    )]
    OwnAddress {
        /// System id; 0 where it is not a valid one.
        system: u8,
        /// Component id.
        component: u8,
    },
    /// A limit is not above zero.
    #[error("limits must be above 0 (infinite is allowed)")]
    Limits,
}

impl<T: Scalar> AutopilotSettings<T> {
    /// Returns the defaults for a mission with this start, altitude and speed.
    pub fn new(map_origin: Geodetic, start: Position<T>, altitude_m: T, speed_mps: T) -> Self {
        Self {
            own: OwnAddress::ONBOARD_COMPUTER,
            vehicle: None,
            map_origin,
            start,
            altitude_m,
            limits: MotionLimits::ideal(),
            airframe_speed_mps: None,
            transit_speed_mps: speed_mps,
            climb_speed_mps: T::of(3.0),
            geofence: None,
            setpoint_interval: Duration::from_millis(100),
            telemetry_interval: Duration::from_millis(50),
            coordinates: Coordinates::Local,
            arrival_radius_m: T::of(2.0),
            // A quarter of a second.
            lag_tolerance_m: (speed_mps * T::of(0.25)).max(T::of(2.0)),
            sample_patience: Duration::from_millis(250),
            coast: Duration::from_millis(800),
            patience: Patience::default(),
            preflight: Preflight::default(),
            set_parameters: false,
            watch: Watch::default(),
        }
    }

    /// Checks all settings.
    ///
    /// # Errors
    /// Returns the first invalid setting.
    pub(crate) fn check(&self) -> Result<(), SettingsError> {
        let positive = [
            ("altitude_m", self.altitude_m),
            ("transit_speed_mps", self.transit_speed_mps),
            ("climb_speed_mps", self.climb_speed_mps),
            ("arrival_radius_m", self.arrival_radius_m),
            ("lag_tolerance_m", self.lag_tolerance_m),
            ("watch.jump_m", self.watch.jump_m),
        ];
        let airframe = self
            .airframe_speed_mps
            .map(|mps| ("airframe_speed_mps", mps));
        for (name, value) in positive.into_iter().chain(airframe) {
            if !(value.finite() && value > T::zero()) {
                let value = value.to_f64();
                return Err(SettingsError::NotPositive { name, value });
            }
        }
        let own = self.own.resolve(self.vehicle);
        if own.system == 0 || own.component <= 1 {
            let Address { system, component } = own;
            return Err(SettingsError::OwnAddress { system, component });
        }
        let margin_m = self.watch.fence_margin_m;
        if !(margin_m.finite() && margin_m >= T::zero()) {
            return Err(SettingsError::Negative {
                name: "watch.fence_margin_m",
                value: margin_m.to_f64(),
            });
        }
        let micros = self.setpoint_interval.as_micros();
        if !(50_000..=200_000).contains(&micros) {
            return Err(SettingsError::SetpointInterval { micros });
        }
        if !self.limits.is_valid() {
            return Err(SettingsError::Limits);
        }
        let (x, y) = (self.start.x.to_f64(), self.start.y.to_f64());
        let finite = self.start.coords.map(|c| c.finite()) == Vector2::new(true, true);
        let inside = self
            .geofence
            .is_none_or(|fence| fence.contains(&self.start, T::zero()));
        if !(finite && inside) {
            return Err(SettingsError::StartOutsideFence { x, y });
        }
        // In this form a ceiling that is NaN is refused, too.
        let reaches = |fence: &Geofence<T>| fence.ceiling_m >= self.altitude_m;
        if let Some(fence) = self.geofence.as_ref().filter(|fence| !reaches(fence)) {
            return Err(SettingsError::AboveCeiling {
                altitude_m: self.altitude_m.to_f64(),
                ceiling_m: fence.ceiling_m.to_f64(),
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> AutopilotSettings<f64> {
        let origin = Geodetic {
            latitude_e7: 0,
            longitude_e7: 0,
        };
        let corner = Position::new(100.0, 100.0);
        AutopilotSettings {
            geofence: Some(Geofence {
                low: -corner,
                high: corner,
                ceiling_m: 110.0,
            }),
            ..AutopilotSettings::new(origin, Position::origin(), 100.0, 30.0)
        }
    }

    #[test]
    fn an_address_that_no_client_can_have_is_refused() {
        for (system, component) in [(Some(0), 191), (None, 0), (Some(7), 1)] {
            let own = OwnAddress { system, component };
            let refused = AutopilotSettings { own, ..settings() }.check();
            let named = matches!(refused, Err(SettingsError::OwnAddress { .. }));
            assert!(named, "{own:?}: {refused:?}");
        }
    }

    /// A comparison with NaN is false: what is not checked for it is switched off by it.
    #[test]
    fn what_is_no_number_is_refused() {
        assert_eq!(settings().check(), Ok(()));
        for value in [f64::NAN, 99.0, f64::NEG_INFINITY] {
            let mut low = settings();
            if let Some(fence) = &mut low.geofence {
                fence.ceiling_m = value;
            }
            let refused = low.check();
            let above = matches!(refused, Err(SettingsError::AboveCeiling { .. }));
            assert!(above, "{value}: {refused:?}");
        }
        for value in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            let mut jump = settings();
            jump.watch.jump_m = value;
            let refused = jump.check();
            let named = matches!(
                refused,
                Err(SettingsError::NotPositive {
                    name: "watch.jump_m",
                    ..
                })
            );
            assert!(named, "{value}: {refused:?}");
        }
        for value in [f64::NAN, -1.0, f64::INFINITY] {
            let mut margin = settings();
            margin.watch.fence_margin_m = value;
            let refused = margin.check();
            let named = matches!(refused, Err(SettingsError::Negative { .. }));
            assert!(named, "{value}: {refused:?}");
        }
    }
}
