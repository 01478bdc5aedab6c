//! The messages that the vehicle receives: commands, setpoints, parameters.

use firmware_core::autopilot::frames::{Geodetic, vector_from_ned};
use firmware_core::autopilot::profile::{Firmware, Mode};
use firmware_core::autopilot::wire::Address;
use firmware_core::time::{Duration, Instant};
use mavlink::dialects::common::{
    COMMAND_ACK_DATA, COMMAND_LONG_DATA, MavCmd, MavMessage, MavParamType, MavResult, MavSeverity,
    PARAM_VALUE_DATA, POSITION_TARGET_GLOBAL_INT_DATA, POSITION_TARGET_LOCAL_NED_DATA,
    PositionTargetTypemask as Mask, SET_POSITION_TARGET_GLOBAL_INT_DATA,
    SET_POSITION_TARGET_LOCAL_NED_DATA, TIMESYNC_DATA,
};

use super::body::Target;
use super::parameters::Value;
use super::simulated::{FlightMode, Setpoint, Vehicle};
use super::streams::LOCAL_POSITION_NED;

/// Setpoints further apart than this are not a stream (PX4 requires 2 Hz).
const STREAM_GAP: Duration = Duration::from_millis(500);

impl Vehicle {
    fn is_for_us(&self, system: u8, component: u8) -> bool {
        [0, self.settings.system].contains(&system) && [0, 1].contains(&component)
    }

    pub(super) fn handle(&mut self, now: Instant, from: Address, message: &MavMessage) {
        use mavlink::Message;
        let system = message.target_system_id().unwrap_or(0);
        let component = message.target_component_id().unwrap_or(0);
        if !self.is_for_us(system, component) {
            return;
        }
        match message {
            MavMessage::HEARTBEAT(_) if self.parameters.is("SYSID_MYGCS", from.system.into()) => {
                self.ground_heard = Some(now);
            }
            MavMessage::COMMAND_LONG(command) => {
                if let Some(result) = self.obey(now, command) {
                    self.send(&MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
                        command: command.command,
                        result,
                        progress: 0,
                        result_param2: 0,
                        target_system: from.system,
                        target_component: from.component,
                    }));
                }
            }
            MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint) => self.take_local(now, setpoint),
            MavMessage::SET_POSITION_TARGET_GLOBAL_INT(setpoint) => self.take_global(now, setpoint),
            MavMessage::PARAM_REQUEST_READ(request) => {
                let name = request.param_id.to_str().unwrap_or_default().to_owned();
                let index = match usize::try_from(request.param_index) {
                    Ok(index) => Some(index),
                    Err(_) => self.parameters.index_of(&name),
                };
                if let Some(index) = index {
                    self.send_parameter(index);
                }
            }
            MavMessage::PARAM_REQUEST_LIST(_) => {
                for index in 0..self.parameters.len() {
                    self.send_parameter(index);
                }
            }
            MavMessage::PARAM_SET(set) => {
                let name = set.param_id.to_str().unwrap_or_default().to_owned();
                let value = match set.param_type {
                    MavParamType::MAV_PARAM_TYPE_INT32
                        if self.firmware.sends_integers_as_bytes() =>
                    {
                        set.param_value.to_bits() as i32 as f32
                    }
                    _ => set.param_value,
                };
                self.parameters.set(&name, value);
                if let Some(index) = self.parameters.index_of(&name) {
                    self.send_parameter(index);
                }
            }
            MavMessage::TIMESYNC(sync) if sync.tc1 == 0 => {
                self.send(&MavMessage::TIMESYNC(TIMESYNC_DATA {
                    tc1: i64::try_from(now.as_micros()).unwrap_or(i64::MAX) * 1_000,
                    ts1: sync.ts1,
                    target_system: from.system,
                    target_component: from.component,
                }));
            }
            other => {
                self.handle_mission(now, from, other);
            }
        }
    }

    fn send_parameter(&mut self, index: usize) {
        let Some((name, value)) = self.parameters.at(index) else {
            return;
        };
        let (param_value, param_type) = match value {
            Value::Real(value) => (value, MavParamType::MAV_PARAM_TYPE_REAL32),
            // PX4 sends the bytes of an integer, ArduPilot its value.
            Value::Integer(value) if self.firmware.sends_integers_as_bytes() => (
                f32::from_bits(value as u32),
                MavParamType::MAV_PARAM_TYPE_INT32,
            ),
            Value::Integer(value) => (value as f32, MavParamType::MAV_PARAM_TYPE_INT32),
        };
        self.send(&MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
            param_value,
            param_count: self.parameters.len() as u16,
            param_index: index as u16,
            param_id: name.into(),
            param_type,
        }));
    }

    fn obey(&mut self, now: Instant, command: &COMMAND_LONG_DATA) -> Option<MavResult> {
        use MavResult as R;
        Some(match command.command {
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL
                if self
                    .settings
                    .refused_intervals
                    .contains(&(command.param1 as u32)) =>
            {
                R::MAV_RESULT_FAILED
            }
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => {
                let interval = match command.param2 {
                    us if us > 0.0 => Some(Duration::from_micros(us as u64)),
                    0.0 => Some(Duration::from_secs(1)),
                    _ => None,
                };
                self.streams.set(now, command.param1 as u32, interval);
                R::MAV_RESULT_ACCEPTED
            }
            MavCmd::MAV_CMD_REQUEST_MESSAGE => {
                if self.send_message(now, command.param1 as u32) {
                    R::MAV_RESULT_ACCEPTED
                } else {
                    R::MAV_RESULT_FAILED
                }
            }
            MavCmd::MAV_CMD_DO_SET_MODE => self.change_mode(now, command),
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if command.param1 == 1.0 => self.arm(now),
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => {
                if self.body.is_on_ground() {
                    self.armed = false;
                    R::MAV_RESULT_ACCEPTED
                } else {
                    R::MAV_RESULT_FAILED
                }
            }
            MavCmd::MAV_CMD_NAV_TAKEOFF => {
                let able = self.armed && self.mode == FlightMode::Guided;
                if able && self.body.is_on_ground() && command.param7 > 0.0 {
                    self.setpoint = None;
                    self.take_off_to = Some(f64::from(command.param7));
                    R::MAV_RESULT_ACCEPTED
                } else {
                    R::MAV_RESULT_FAILED
                }
            }
            MavCmd::MAV_CMD_NAV_LAND => {
                self.set_mode(FlightMode::Land);
                R::MAV_RESULT_ACCEPTED
            }
            MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH => {
                self.set_mode(FlightMode::Return);
                R::MAV_RESULT_ACCEPTED
            }
            MavCmd::MAV_CMD_MISSION_START => self.start_mission(now),
            // The speed can only be changed once there is a target.
            MavCmd::MAV_CMD_DO_CHANGE_SPEED if self.setpoint.is_none() => R::MAV_RESULT_FAILED,
            MavCmd::MAV_CMD_DO_CHANGE_SPEED => R::MAV_RESULT_ACCEPTED,
            _ => R::MAV_RESULT_UNSUPPORTED,
        })
    }

    fn change_mode(&mut self, now: Instant, command: &COMMAND_LONG_DATA) -> MavResult {
        let wanted = match self.firmware {
            Firmware::Px4 => Mode((command.param2 as u32) << 16 | (command.param3 as u32) << 24),
            Firmware::Generic | Firmware::ArduCopter => Mode(command.param2 as u32),
        };
        let Some(mode) = self.mode_numbered(wanted) else {
            return MavResult::MAV_RESULT_DENIED;
        };
        let needs_stream = self.firmware.stream_before_control() > Duration::ZERO;
        if mode == FlightMode::Guided && needs_stream && !self.stream_flows(now) {
            let text = "Offboard: no setpoint stream";
            self.say(MavSeverity::MAV_SEVERITY_CRITICAL, text);
            return MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
        }
        if mode == FlightMode::Auto && self.mission_settles(now) {
            return MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
        }
        self.set_mode(mode);
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn arm(&mut self, now: Instant) -> MavResult {
        if self.armed {
            return MavResult::MAV_RESULT_ACCEPTED;
        }
        if !self.is_ready() {
            let text = "PreArm: Need Position Estimate";
            self.say(MavSeverity::MAV_SEVERITY_CRITICAL, text);
            return MavResult::MAV_RESULT_FAILED;
        }
        self.armed = true;
        self.armed_at = now;
        self.home = self.body.position;
        MavResult::MAV_RESULT_ACCEPTED
    }

    /// Returns whether setpoints have been received for half a second or more, without a gap, until
    /// now.
    fn stream_flows(&self, now: Instant) -> bool {
        let fresh = self.setpoint.is_some_and(|s| now - s.came < STREAM_GAP);
        fresh
            && self
                .stream_since
                .is_some_and(|since| now - since >= STREAM_GAP)
    }

    fn take_local(&mut self, now: Instant, s: &SET_POSITION_TARGET_LOCAL_NED_DATA) {
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
                self.send_message(now, LOCAL_POSITION_NED);
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

    fn take_global(&mut self, now: Instant, s: &SET_POSITION_TARGET_GLOBAL_INT_DATA) {
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
                self.send_message(now, LOCAL_POSITION_NED);
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

    /// Returns the number that represents a mode in messages.
    pub(super) fn custom_mode(&self, mode: FlightMode) -> u32 {
        let (manual, loiter) = match self.firmware {
            Firmware::Generic | Firmware::ArduCopter => (0, 5),
            Firmware::Px4 => (3 << 16, 4 << 16 | 3 << 24),
        };
        match mode {
            FlightMode::Manual => manual,
            FlightMode::Loiter => loiter,
            FlightMode::Guided => self.firmware.control_mode().0,
            FlightMode::Auto => self.firmware.mission_mode().0,
            FlightMode::Return => self.firmware.return_mode().0,
            FlightMode::Land => self.firmware.land_mode().0,
        }
    }

    fn mode_numbered(&self, mode: Mode) -> Option<FlightMode> {
        [
            FlightMode::Manual,
            FlightMode::Loiter,
            FlightMode::Guided,
            FlightMode::Auto,
            FlightMode::Return,
            FlightMode::Land,
        ]
        .into_iter()
        .find(|&known| self.custom_mode(known) == mode.0)
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
