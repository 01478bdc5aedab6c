// SPDX-License-Identifier: MIT OR Apache-2.0
//! The commands that the client sends, and their parameters in a COMMAND_LONG.

use core::fmt;

use mavlink::MessageData;
use mavlink::dialects::common::{
    CURRENT_MODE_DATA, ESTIMATOR_STATUS_DATA, EXTENDED_SYS_STATE_DATA, GPS_GLOBAL_ORIGIN_DATA,
    HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavCmd, SYS_STATUS_DATA,
};

use crate::autopilot::profile::{Firmware, Mode};
use crate::autopilot::wire::ekf_status_report;
use crate::time::Duration;

/// A command to an autopilot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Send a message at this interval from now on.
    MessageInterval {
        /// Id of the message.
        message: u32,
        /// The interval.
        interval: Duration,
    },
    /// Send a message once.
    Message {
        /// Id of the message.
        message: u32,
    },
    /// Change the flight mode.
    SetMode(Mode),
    /// Let the motors turn.
    Arm,
    /// Stop the motors; refused in flight.
    Disarm,
    /// Rise to this height above the place of take-off, metres.
    TakeOff {
        /// Height, m.
        altitude_m: f32,
    },
    /// Land here.
    Land,
    /// Return to the place of take-off and land.
    Return,
    /// Fly the uploaded mission.
    StartMission,
}

impl Request {
    /// Returns the command's name for messages and logs.
    pub fn name(&self) -> &'static str {
        match self {
            Self::MessageInterval { .. } => "SET_MESSAGE_INTERVAL",
            Self::Message { .. } => "REQUEST_MESSAGE",
            Self::SetMode(_) => "DO_SET_MODE",
            Self::Arm => "arm",
            Self::Disarm => "disarm",
            Self::TakeOff { .. } => "NAV_TAKEOFF",
            Self::Land => "NAV_LAND",
            Self::Return => "NAV_RETURN_TO_LAUNCH",
            Self::StartMission => "MISSION_START",
        }
    }

    /// Returns whether the command can move the vehicle or its motors.
    pub fn moves(&self) -> bool {
        !matches!(self, Self::MessageInterval { .. } | Self::Message { .. })
    }

    pub(super) fn command(&self) -> MavCmd {
        match self {
            Self::MessageInterval { .. } => MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            Self::Message { .. } => MavCmd::MAV_CMD_REQUEST_MESSAGE,
            Self::SetMode(_) => MavCmd::MAV_CMD_DO_SET_MODE,
            Self::Arm | Self::Disarm => MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
            Self::TakeOff { .. } => MavCmd::MAV_CMD_NAV_TAKEOFF,
            Self::Land => MavCmd::MAV_CMD_NAV_LAND,
            Self::Return => MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH,
            Self::StartMission => MavCmd::MAV_CMD_MISSION_START,
        }
    }

    /// Returns parameters 1 to 7. Unused ones are zero, never NaN: a NaN has crashed an autopilot.
    pub(super) fn parameters(&self, firmware: Firmware) -> [f32; 7] {
        let mut p = [0.0; 7];
        match *self {
            Self::MessageInterval { message, interval } => {
                p[0] = message as f32;
                p[1] = interval.as_micros() as f32;
            }
            Self::Message { message } => p[0] = message as f32,
            Self::SetMode(mode) => {
                p[0] = 1.0; // the custom mode is what counts
                (p[1], p[2]) = firmware.mode_parameters(mode);
            }
            Self::Arm => p[0] = 1.0,
            Self::TakeOff { altitude_m } => p[6] = altitude_m,
            Self::Disarm | Self::Land | Self::Return | Self::StartMission => {}
        }
        p
    }
}

/// Returns the name of a message that the client asks for.
fn message_name(id: u32) -> Option<&'static str> {
    Some(match id {
        CURRENT_MODE_DATA::ID => CURRENT_MODE_DATA::NAME,
        ESTIMATOR_STATUS_DATA::ID => ESTIMATOR_STATUS_DATA::NAME,
        EXTENDED_SYS_STATE_DATA::ID => EXTENDED_SYS_STATE_DATA::NAME,
        GPS_GLOBAL_ORIGIN_DATA::ID => GPS_GLOBAL_ORIGIN_DATA::NAME,
        HEARTBEAT_DATA::ID => HEARTBEAT_DATA::NAME,
        LOCAL_POSITION_NED_DATA::ID => LOCAL_POSITION_NED_DATA::NAME,
        SYS_STATUS_DATA::ID => SYS_STATUS_DATA::NAME,
        ekf_status_report::ID => ekf_status_report::NAME,
        _ => return None,
    })
}

/// Writes the command's name and, where it concerns a message, the message's name.
impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        match *self {
            Self::MessageInterval { message, .. } | Self::Message { message } => {
                match message_name(message) {
                    Some(name) => write!(f, " for {name}"),
                    None => write!(f, " for message {message}"),
                }
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_parameter_is_ever_not_a_number() {
        for firmware in [Firmware::Generic, Firmware::ArduCopter, Firmware::Px4] {
            for request in [
                Request::MessageInterval {
                    message: LOCAL_POSITION_NED_DATA::ID,
                    interval: Duration::from_micros(u64::MAX),
                },
                Request::SetMode(firmware.control_mode()),
                Request::TakeOff { altitude_m: 100.0 },
                Request::Arm,
                Request::Return,
            ] {
                assert!(request.parameters(firmware).iter().all(|p| p.is_finite()));
            }
        }
        assert_eq!(
            Request::SetMode(Firmware::Px4.control_mode()).parameters(Firmware::Px4)[..3],
            [1.0, 6.0, 0.0]
        );
    }
}
