// SPDX-License-Identifier: MIT OR Apache-2.0
//! Differences between autopilots: modes, take-off, confirmation of setpoints.
//!
//! The firmware is determined from the autopilot's own heartbeat; it is never configured. Every
//! difference is a method with an exhaustive match, so that the compiler lists what a new firmware
//! has to define.

use mavlink::MessageData;
use mavlink::dialects::common::{
    ESTIMATOR_STATUS_DATA, HEARTBEAT_DATA, MavAutopilot, MavModeFlag, MavType,
};

use super::wire::ekf_status_report;
use crate::time::Duration;

/// The autopilot's software.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Firmware {
    /// The built-in vehicle: it uses ArduCopter's mode numbers and confirms each setpoint.
    Generic,
    /// ArduPilot, flying a multirotor.
    ArduCopter,
    /// PX4.
    Px4,
}

/// A flight mode: the number in HEARTBEAT.custom_mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Mode(pub u32);

const fn px4_mode(main: u32, sub: u32) -> Mode {
    Mode(main << 16 | sub << 24)
}

impl Firmware {
    /// All firmwares. The test `every_heartbeat_is_recognized` checks them.
    pub const ALL: [Self; 3] = [Self::Generic, Self::ArduCopter, Self::Px4];

    /// Returns the autopilot type in the firmware's heartbeat.
    pub const fn autopilot(self) -> MavAutopilot {
        match self {
            Self::Generic => MavAutopilot::MAV_AUTOPILOT_GENERIC,
            Self::ArduCopter => MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
            Self::Px4 => MavAutopilot::MAV_AUTOPILOT_PX4,
        }
    }

    /// Returns whether integer parameters are sent as the bytes of the integer instead of its value.
    pub const fn sends_integers_as_bytes(self) -> bool {
        match self {
            Self::Generic | Self::ArduCopter => false,
            Self::Px4 => true,
        }
    }

    /// Returns the id of the message that reports the state of the position estimator.
    pub const fn estimator_message(self) -> u32 {
        match self {
            Self::ArduCopter => ekf_status_report::ID,
            Self::Generic | Self::Px4 => ESTIMATOR_STATUS_DATA::ID,
        }
    }

    /// Returns whether item 0 of an uploaded mission is the home position.
    pub const fn mission_begins_with_home(self) -> bool {
        match self {
            Self::Generic | Self::ArduCopter => true,
            Self::Px4 => false,
        }
    }

    /// Returns the firmware that sent this heartbeat, or `None` if it is not the autopilot of a
    /// vehicle that hovers.
    pub fn of(heartbeat: &HEARTBEAT_DATA) -> Option<Self> {
        let hovers = matches!(
            heartbeat.mavtype,
            MavType::MAV_TYPE_GENERIC
                | MavType::MAV_TYPE_QUADROTOR
                | MavType::MAV_TYPE_COAXIAL
                | MavType::MAV_TYPE_HELICOPTER
                | MavType::MAV_TYPE_HEXAROTOR
                | MavType::MAV_TYPE_OCTOROTOR
                | MavType::MAV_TYPE_TRICOPTER
                | MavType::MAV_TYPE_DODECAROTOR
                | MavType::MAV_TYPE_DECAROTOR
                | MavType::MAV_TYPE_GENERIC_MULTIROTOR
        );
        Self::ALL
            .into_iter()
            .find(|firmware| hovers && firmware.autopilot() == heartbeat.autopilot)
    }

    /// Returns the mode in which the autopilot follows our setpoints: GUIDED or OFFBOARD.
    pub const fn control_mode(self) -> Mode {
        match self {
            Self::Generic | Self::ArduCopter => Mode(4),
            Self::Px4 => px4_mode(6, 0),
        }
    }

    /// Returns the mode that NAV_LAND leads to.
    pub const fn land_mode(self) -> Mode {
        match self {
            Self::Generic | Self::ArduCopter => Mode(9),
            Self::Px4 => px4_mode(4, 6),
        }
    }

    /// Returns the mode that NAV_RETURN_TO_LAUNCH leads to.
    pub const fn return_mode(self) -> Mode {
        match self {
            Self::Generic | Self::ArduCopter => Mode(6),
            Self::Px4 => px4_mode(4, 5),
        }
    }

    /// Returns the mode that flies an uploaded mission.
    pub const fn mission_mode(self) -> Mode {
        match self {
            Self::Generic | Self::ArduCopter => Mode(3),
            Self::Px4 => px4_mode(4, 4),
        }
    }

    /// Returns parameters 2 and 3 of DO_SET_MODE.
    pub const fn mode_parameters(self, mode: Mode) -> (f32, f32) {
        match self {
            Self::Generic | Self::ArduCopter => (mode.0 as f32, 0.0),
            Self::Px4 => (((mode.0 >> 16) & 0xFF) as f32, (mode.0 >> 24) as f32),
        }
    }

    /// Returns a mode's name for messages.
    pub const fn mode_name(self, mode: Mode) -> &'static str {
        match self {
            Self::Generic | Self::ArduCopter => match mode.0 {
                0 => "STABILIZE",
                1 => "ACRO",
                2 => "ALT_HOLD",
                3 => "AUTO",
                4 => "GUIDED",
                5 => "LOITER",
                6 => "RTL",
                7 => "CIRCLE",
                9 => "LAND",
                11 => "DRIFT",
                13 => "SPORT",
                16 => "POSHOLD",
                17 => "BRAKE",
                20 => "GUIDED_NOGPS",
                21 => "SMART_RTL",
                _ => "another mode",
            },
            Self::Px4 => match ((mode.0 >> 16) & 0xFF, mode.0 >> 24) {
                (1, _) => "MANUAL",
                (2, _) => "ALTCTL",
                (3, _) => "POSCTL",
                (4, 2) => "AUTO.TAKEOFF",
                (4, 3) => "AUTO.LOITER",
                (4, 4) => "AUTO.MISSION",
                (4, 5) => "AUTO.RTL",
                (4, 6) => "AUTO.LAND",
                (5, _) => "ACRO",
                (6, _) => "OFFBOARD",
                (7, _) => "STABILIZED",
                _ => "another mode",
            },
        }
    }

    /// Returns how long setpoints must be streamed before the control mode is requested. Where it
    /// is not zero, take-off too is flown with setpoints.
    pub const fn stream_before_control(self) -> Duration {
        match self {
            Self::Generic | Self::ArduCopter => Duration::ZERO,
            // PX4 needs more than 2 Hz for a moment; its examples use one second.
            Self::Px4 => Duration::from_secs(1),
        }
    }

    /// Returns whether the autopilot accepts a SET_MESSAGE_INTERVAL for its heartbeat. PX4 refuses
    /// it and sends one a second; its CURRENT_MODE shows earlier who has control.
    pub const fn sends_heartbeats_on_request(self) -> bool {
        match self {
            Self::Generic | Self::ArduCopter => true,
            Self::Px4 => false,
        }
    }

    /// Returns whether take-off is commanded by NAV_TAKEOFF; otherwise it is flown with rising
    /// setpoints.
    pub const fn takes_off_by_command(self) -> bool {
        match self {
            Self::Generic | Self::ArduCopter => true,
            Self::Px4 => false,
        }
    }

    /// Returns whether each setpoint is echoed at once, so that a position sample after the echo
    /// was taken after the setpoint. (ArduCopter echoes at its telemetry rate; PX4 echoes the
    /// output of its own smoothing.)
    pub const fn confirms_setpoints(self) -> bool {
        match self {
            Self::Generic => true,
            Self::ArduCopter | Self::Px4 => false,
        }
    }

    /// Returns the name of the firmware for messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Generic => "the built-in vehicle",
            Self::ArduCopter => "ArduCopter",
            Self::Px4 => "PX4",
        }
    }
}

/// Returns the mode of a heartbeat.
pub fn mode_of(heartbeat: &HEARTBEAT_DATA) -> Mode {
    Mode(heartbeat.custom_mode)
}

/// Returns whether the heartbeat reports that motors may turn.
pub fn is_armed(heartbeat: &HEARTBEAT_DATA) -> bool {
    heartbeat
        .base_mode
        .contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_heartbeat_is_recognized() {
        for firmware in Firmware::ALL {
            let heartbeat = HEARTBEAT_DATA {
                mavtype: MavType::MAV_TYPE_QUADROTOR,
                autopilot: firmware.autopilot(),
                ..HEARTBEAT_DATA::DEFAULT
            };
            assert_eq!(Firmware::of(&heartbeat), Some(firmware));
        }
    }
}
