//! The setpoints that the vehicle receives: which it follows, and how it echoes them.

use firmware_core::autopilot::frames::{Geodetic, vector_from_ned};
use firmware_core::autopilot::profile::Firmware;
use firmware_core::time::{Duration, Instant};
use mavlink::MessageData;
use mavlink::dialects::common::{
    LOCAL_POSITION_NED_DATA, MavMessage, POSITION_TARGET_GLOBAL_INT_DATA,
    POSITION_TARGET_LOCAL_NED_DATA, PositionTargetTypemask as Mask,
    SET_POSITION_TARGET_GLOBAL_INT_DATA, SET_POSITION_TARGET_LOCAL_NED_DATA,
};

use super::body::Target;
use super::simulated::{FlightMode, Setpoint, Vehicle};

/// Setpoints further apart than this are not a stream (PX4 requires 2 Hz).
const STREAM_GAP: Duration = Duration::from_millis(500);

impl Vehicle {
    /// Returns whether setpoints have been received for half a second or more, without a gap, until
    /// now.
    pub(super) fn stream_flows(&self, now: Instant) -> bool {
        let fresh = self.setpoint.is_some_and(|s| now - s.came < STREAM_GAP);
        fresh
            && self
                .stream_since
                .is_some_and(|since| now - since >= STREAM_GAP)
    }

    pub(super) fn take_local(&mut self, now: Instant, s: &SET_POSITION_TARGET_LOCAL_NED_DATA) {
        let numbers = [s.x, s.y, s.z, s.vx, s.vy, s.vz];
        if !numbers.iter().all(|v| v.is_finite()) {
            let reached = self.behavior().crashes_on_nan && self.mode == FlightMode::Guided;
            self.crashed |= reached;
            return;
        }
        let target = Target {
            position: self.local_frame().from_local(s.x, s.y),
            altitude_m: f64::from(-s.z),
            velocity: velocity(s.type_mask, s.vx, s.vy),
            acceleration: acceleration(s.type_mask, s.afx, s.afy),
            age_s: 0.0,
        };
        if !self.take_target(now, target) {
            return;
        }
        match self.firmware {
            Firmware::Generic => {
                let echo = POSITION_TARGET_LOCAL_NED_DATA {
                    time_boot_ms: now.millis_wrapping(),
                    x: s.x,
                    y: s.y,
                    z: s.z,
                    vx: s.vx,
                    vy: s.vy,
                    vz: s.vz,
                    afx: s.afx,
                    afy: s.afy,
                    afz: s.afz,
                    yaw: s.yaw,
                    yaw_rate: s.yaw_rate,
                    type_mask: s.type_mask,
                    coordinate_frame: s.coordinate_frame,
                };
                self.send(&MavMessage::POSITION_TARGET_LOCAL_NED(echo));
                self.send_message(now, LOCAL_POSITION_NED_DATA::ID);
            }
            // ArduCopter echoes every target in global coordinates.
            Firmware::ArduCopter => {
                let place = self.local_frame().to_geodetic(target.position);
                self.send(&MavMessage::POSITION_TARGET_GLOBAL_INT(
                    POSITION_TARGET_GLOBAL_INT_DATA {
                        time_boot_ms: now.millis_wrapping(),
                        lat_int: place.latitude_e7,
                        lon_int: place.longitude_e7,
                        alt: -s.z,
                        vx: s.vx,
                        vy: s.vy,
                        vz: s.vz,
                        type_mask: s.type_mask,
                        ..POSITION_TARGET_GLOBAL_INT_DATA::DEFAULT
                    },
                ));
            }
            Firmware::Px4 => {}
        }
    }

    pub(super) fn take_global(&mut self, now: Instant, s: &SET_POSITION_TARGET_GLOBAL_INT_DATA) {
        if ![s.alt, s.vx, s.vy, s.vz].iter().all(|v| v.is_finite()) {
            return;
        }
        let place = Geodetic {
            latitude_e7: s.lat_int,
            longitude_e7: s.lon_int,
        };
        let target = Target {
            position: self.local_frame().from_geodetic(place),
            altitude_m: f64::from(s.alt),
            velocity: velocity(s.type_mask, s.vx, s.vy),
            acceleration: acceleration(s.type_mask, s.afx, s.afy),
            age_s: 0.0,
        };
        if self.take_target(now, target) && self.behavior().echoes_setpoints {
            let echo = POSITION_TARGET_GLOBAL_INT_DATA {
                time_boot_ms: now.millis_wrapping(),
                lat_int: s.lat_int,
                lon_int: s.lon_int,
                alt: s.alt,
                vx: s.vx,
                vy: s.vy,
                vz: s.vz,
                afx: s.afx,
                afy: s.afy,
                afz: s.afz,
                yaw: s.yaw,
                yaw_rate: s.yaw_rate,
                type_mask: s.type_mask,
                coordinate_frame: s.coordinate_frame,
            };
            self.send(&MavMessage::POSITION_TARGET_GLOBAL_INT(echo));
            if self.firmware.confirms_setpoints() {
                self.send_message(now, LOCAL_POSITION_NED_DATA::ID);
            }
        }
    }

    /// Accepts a setpoint or silently drops it. Returns true if it was accepted.
    fn take_target(&mut self, now: Instant, target: Target) -> bool {
        let gap = self.setpoint.is_none_or(|s| now - s.came > STREAM_GAP);
        if gap || self.stream_since.is_none() {
            self.stream_since = Some(now);
        }
        let guided = self.mode == FlightMode::Guided && self.armed;
        let on_ground_too = !self.firmware.takes_off_by_command();
        let flies = guided && (!self.body.is_on_ground() || on_ground_too);
        if !(flies || on_ground_too) {
            return false;
        }
        self.previous = self.setpoint;
        self.setpoint = Some(Setpoint { came: now, target });
        if flies {
            // A target during take-off replaces the take-off.
            self.take_off_to = None;
            self.hold_altitude_m = target.altitude_m;
            if !self.faults.ignore_setpoints {
                self.body.take(&target);
            }
        }
        flies
    }
}

fn velocity(mask: Mask, north: f32, east: f32) -> Option<nalgebra::Vector2<f64>> {
    let ignored =
        Mask::POSITION_TARGET_TYPEMASK_VX_IGNORE | Mask::POSITION_TARGET_TYPEMASK_VY_IGNORE;
    (!mask.intersects(ignored)).then(|| vector_from_ned(north, east))
}

fn acceleration(mask: Mask, north: f32, east: f32) -> nalgebra::Vector2<f64> {
    let ignored =
        Mask::POSITION_TARGET_TYPEMASK_AX_IGNORE | Mask::POSITION_TARGET_TYPEMASK_AY_IGNORE;
    if mask.intersects(ignored) || !(north.is_finite() && east.is_finite()) {
        nalgebra::Vector2::zeros()
    } else {
        vector_from_ned(north, east)
    }
}
