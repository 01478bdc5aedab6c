// SPDX-License-Identifier: MIT OR Apache-2.0
//! The items of a mission.

use mavlink::dialects::common::{MISSION_ITEM_INT_DATA, MavCmd, MavFrame, MavMissionType};
use thiserror::Error;

use crate::autopilot::frames::{Geodetic, MapFrame};
use crate::autopilot::profile::Firmware;
use crate::autopilot::wire::Address;
use crate::scalar::{Position, Scalar};

/// The end of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Lands at the last waypoint.
    Land,
    /// Returns to the place of take-off and lands there.
    Return,
}

/// A mission in the form in which the autopilot gets it.
#[derive(Clone, Copy, Debug)]
pub struct MissionPlan<'a, T: Scalar> {
    /// Determines whether item 0 is the home position (ArduPilot) or the take-off (PX4).
    pub firmware: Firmware,
    /// The position of the map.
    pub map: MapFrame<T>,
    /// Waypoints, m.
    pub waypoints: &'a [Position<T>],
    /// The altitude above the place of take-off, m.
    pub altitude_m: T,
    /// The speed between waypoints, m/s.
    pub speed_mps: T,
    /// The command after the last waypoint.
    pub ending: Ending,
}

/// Error returned when a plan cannot be uploaded.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The plan has no waypoints.
    #[error("the mission has no waypoints")]
    Empty,
    /// The plan has more items than the protocol can number.
    #[error("the mission has {0} waypoints; at most 65 000 can be uploaded")]
    TooLong(usize),
    /// A waypoint has a coordinate that is not finite.
    #[error("waypoint {0} is not finite")]
    NotFinite(usize),
    /// The altitude or the speed is not finite, or not above zero.
    #[error("{name} is {value}; it must be a number above 0")]
    NotPositive {
        /// The name of the value.
        name: &'static str,
        /// The invalid value.
        value: f64,
    },
}

const LONGEST: usize = 65_000;

impl<T: Scalar> MissionPlan<'_, T> {
    pub(super) fn check(&self) -> Result<(), PlanError> {
        if self.waypoints.is_empty() {
            return Err(PlanError::Empty);
        }
        if self.waypoints.len() > LONGEST {
            return Err(PlanError::TooLong(self.waypoints.len()));
        }
        for (name, number) in [
            ("altitude_m", self.altitude_m),
            ("speed_mps", self.speed_mps),
        ] {
            if !(number.finite() && number > T::zero()) {
                let value = number.to_f64();
                return Err(PlanError::NotPositive { name, value });
            }
        }
        let bad = |p: &Position<T>| !(p.x.finite() && p.y.finite());
        match self.waypoints.iter().position(bad) {
            Some(index) => Err(PlanError::NotFinite(index)),
            None => Ok(()),
        }
    }

    /// Returns the number of items before the first waypoint: home where there is one, take-off,
    /// speed.
    pub(super) fn lead(&self) -> u16 {
        2 + u16::from(self.firmware.mission_begins_with_home())
    }

    /// Returns the number of items.
    pub fn count(&self) -> u16 {
        // At most 65 004 by `check`.
        self.lead() + self.waypoints.len() as u16 + 1
    }

    /// Returns whether an item is number 0 of an autopilot that puts its home position there.
    pub(super) fn is_home(&self, sequence: u16) -> bool {
        sequence == 0 && self.firmware.mission_begins_with_home()
    }

    /// Returns item `sequence`, addressed to `to`, or `None` past the end.
    ///
    /// Places are sent in the frame GLOBAL_RELATIVE_ALT; commands without a place in the frame
    /// MISSION, with zero coordinates: PX4 refuses them in any other frame
    /// (MAV_MISSION_UNSUPPORTED).
    pub fn item(&self, sequence: u16, to: Address) -> Option<MISSION_ITEM_INT_DATA> {
        use MavCmd as C;
        let lead = self.lead();
        let last = self.waypoints.last()?;
        let waypoint = self
            .waypoints
            .get(usize::from(sequence.saturating_sub(lead)));
        let mut parameters = [0.0; 4];
        let command = if self.is_home(sequence) {
            C::MAV_CMD_NAV_WAYPOINT
        } else if lead.checked_sub(sequence) == Some(2) {
            C::MAV_CMD_NAV_TAKEOFF
        } else if lead.checked_sub(sequence) == Some(1) {
            // Ground speed; the throttle is not changed.
            parameters = [1.0, self.speed_mps.to_f64() as f32, -1.0, 0.0];
            C::MAV_CMD_DO_CHANGE_SPEED
        } else if waypoint.is_some() {
            C::MAV_CMD_NAV_WAYPOINT
        } else if self.count().checked_sub(sequence) == Some(1) {
            match self.ending {
                Ending::Land => C::MAV_CMD_NAV_LAND,
                Ending::Return => C::MAV_CMD_NAV_RETURN_TO_LAUNCH,
            }
        } else {
            return None;
        };
        let has_place = !matches!(
            command,
            C::MAV_CMD_DO_CHANGE_SPEED | C::MAV_CMD_NAV_RETURN_TO_LAUNCH
        );
        let place = if has_place {
            self.map.to_geodetic(*waypoint.unwrap_or(last))
        } else {
            Geodetic::default()
        };
        let z = match command {
            C::MAV_CMD_NAV_LAND => 0.0,
            _ if self.is_home(sequence) || !has_place => 0.0,
            _ => self.altitude_m.to_f64() as f32,
        };
        let [param1, param2, param3, param4] = parameters;
        Some(MISSION_ITEM_INT_DATA {
            param1,
            param2,
            param3,
            param4,
            x: place.latitude_e7,
            y: place.longitude_e7,
            z,
            seq: sequence,
            command,
            target_system: to.system,
            target_component: to.component,
            frame: if has_place {
                MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT
            } else {
                MavFrame::MAV_FRAME_MISSION
            },
            current: 0,
            autocontinue: 1,
            mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
        })
    }

    /// Returns whether an item that was read back is the one that was sent. Places may differ by
    /// rounding, and an autopilot may fill in the places of commands that have none.
    pub(super) fn is_same(&self, got: &MISSION_ITEM_INT_DATA, to: Address) -> bool {
        let Some(meant) = self.item(got.seq, to) else {
            return false;
        };
        if self.is_home(got.seq) {
            return true;
        }
        let near = |a: i32, b: i32| a.abs_diff(b) <= 2;
        let placed = matches!(meant.command, MavCmd::MAV_CMD_NAV_WAYPOINT);
        let place =
            near(got.x, meant.x) && near(got.y, meant.y) && libm::fabsf(got.z - meant.z) <= 0.02;
        let speed = meant.command != MavCmd::MAV_CMD_DO_CHANGE_SPEED || got.param2 == meant.param2;
        got.command == meant.command && speed && (place || !placed)
    }
}
