// SPDX-License-Identifier: MIT OR Apache-2.0
//! The phases of a flight, and the conditions that the checks wait for.

use core::fmt;

use serde::{Deserialize, Serialize};

/// The phase of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Phase {
    /// No autopilot has been heard yet.
    Connecting,
    /// The client waits for a position estimate and the autopilot's own pre-arm checks.
    Checking,
    /// All checks passed; the client waits for [`Autopilot::launch`](super::Autopilot::launch).
    Standby,
    /// The client requests the mode that follows setpoints.
    TakingControl,
    /// The client requests that the motors are armed.
    Arming,
    /// The vehicle climbs to the mission's altitude.
    TakingOff,
    /// The vehicle flies to the mission's start.
    Transit,
    /// The vehicle flies towards the destination and back, to measure what speed the airframe
    /// reaches.
    Trial,
    /// The vehicle holds at the start; the client accepts legs.
    Ready,
    /// The vehicle flies a leg.
    Leg,
    /// A leg has ended; the client accepts the next one.
    LegEnded,
    /// The vehicle lands.
    Landing,
    /// The motors are stopped after a start that was aborted on the ground.
    Disarming,
    /// The vehicle is on the ground with motors off: the end of a flight.
    Landed,
    /// The pilot or the autopilot itself has taken control. Nothing is sent any more that moves the
    /// vehicle.
    Released,
    /// The flight has failed; nothing more can be done.
    Failed,
}

impl Phase {
    /// Returns whether the vehicle is in the air and follows our setpoints.
    pub fn is_flying(self) -> bool {
        matches!(
            self,
            Self::Transit | Self::Trial | Self::Ready | Self::Leg | Self::LegEnded
        )
    }

    /// Returns whether the phase is final.
    pub fn is_final(self) -> bool {
        matches!(self, Self::Landed | Self::Released | Self::Failed)
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Connecting => "connecting",
            Self::Checking => "checking",
            Self::Standby => "standing by",
            Self::TakingControl => "taking control",
            Self::Arming => "arming",
            Self::TakingOff => "taking off",
            Self::Transit => "flying to the start",
            Self::Trial => "trying what speed the airframe reaches",
            Self::Ready => "ready",
            Self::Leg => "flying a leg",
            Self::LegEnded => "leg ended",
            Self::Landing => "landing",
            Self::Disarming => "disarming",
            Self::Landed => "landed",
            Self::Released => "control released",
            Self::Failed => "failed",
        })
    }
}

/// A condition that the checks wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Obstacle {
    /// No position sample yet.
    NoPosition,
    /// The estimator has no absolute position yet.
    NoEstimate,
    /// The autopilot has not reported the origin of its local frame.
    NoOrigin,
    /// The autopilot's pre-arm checks do not pass; its texts give the reason.
    PreArm,
    /// The vehicle is already armed, but not by this client.
    AlreadyArmed,
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoPosition => "no position yet",
            Self::NoEstimate => "the estimator has no absolute position yet",
            Self::NoOrigin => "the origin of the autopilot's local frame is not known yet",
            Self::PreArm => "the autopilot's pre-arm checks do not pass",
            Self::AlreadyArmed => "the vehicle is already armed",
        })
    }
}
