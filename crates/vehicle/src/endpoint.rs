//! The messages that the vehicle receives, and what it does on commands.

use firmware_core::autopilot::profile::{Firmware, Mode};
use firmware_core::autopilot::wire::Address;
use firmware_core::time::{Duration, Instant};
use mavlink::dialects::common::{
    COMMAND_ACK_DATA, COMMAND_LONG_DATA, MavCmd, MavMessage, MavParamType, MavResult, MavSeverity,
    PARAM_VALUE_DATA, TIMESYNC_DATA,
};

use super::parameters::Value;
use super::simulated::{FlightMode, Vehicle};

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
