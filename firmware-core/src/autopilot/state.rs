// SPDX-License-Identifier: MIT OR Apache-2.0
//! State of the client that exists only in a part of a flight.

use super::command::Request;
use super::guidance::{Guide, Motion};
use super::leg::LegEnd;
use super::phase::Phase;
use crate::scalar::{Position, Scalar};
use crate::time::Instant;

/// The phase of a flight, with the state that exists in that phase only.
#[derive(Clone, Copy, Debug)]
pub(super) enum PhaseState<T: Scalar> {
    Connecting,
    Checking,
    Standby,
    /// The command is the change to the mode that follows setpoints.
    TakingControl(PhaseCommand),
    Arming(PhaseCommand),
    /// The command is the take-off. A climb by setpoints needs none and counts as accepted.
    TakingOff(PhaseCommand),
    Transit,
    Trial(Trial<T>),
    Ready,
    Leg,
    LegEnded,
    Landing {
        /// The command that starts the landing: [`Request::Land`] or [`Request::Return`].
        by: Request,
        command: PhaseCommand,
    },
    Disarming(PhaseCommand),
    Landed,
    Released,
    Failed,
}

impl<T: Scalar> PhaseState<T> {
    /// Returns the phase alone.
    pub(super) fn phase(&self) -> Phase {
        match self {
            Self::Connecting => Phase::Connecting,
            Self::Checking => Phase::Checking,
            Self::Standby => Phase::Standby,
            Self::TakingControl(_) => Phase::TakingControl,
            Self::Arming(_) => Phase::Arming,
            Self::TakingOff(_) => Phase::TakingOff,
            Self::Transit => Phase::Transit,
            Self::Trial(_) => Phase::Trial,
            Self::Ready => Phase::Ready,
            Self::Leg => Phase::Leg,
            Self::LegEnded => Phase::LegEnded,
            Self::Landing { .. } => Phase::Landing,
            Self::Disarming(_) => Phase::Disarming,
            Self::Landed => Phase::Landed,
            Self::Released => Phase::Released,
            Self::Failed => Phase::Failed,
        }
    }

    /// Returns the command of the phase, or `None` in a phase without one.
    pub(super) fn command_mut(&mut self) -> Option<&mut PhaseCommand> {
        match self {
            Self::TakingControl(command)
            | Self::Arming(command)
            | Self::TakingOff(command)
            | Self::Landing { command, .. }
            | Self::Disarming(command) => Some(command),
            Self::Connecting
            | Self::Checking
            | Self::Standby
            | Self::Transit
            | Self::Trial(_)
            | Self::Ready
            | Self::Leg
            | Self::LegEnded
            | Self::Landed
            | Self::Released
            | Self::Failed => None,
        }
    }
}

/// The progress of the command by which a phase moves on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PhaseCommand {
    /// The command was not requested in this phase.
    NotRequested,
    /// The command was requested, and no acceptance was received.
    Requested,
    /// The command was accepted.
    Accepted {
        /// The time of the acceptance.
        at: Instant,
    },
}

/// The present leg.
#[derive(Clone, Copy, Debug)]
pub(super) struct ActiveLeg<T: Scalar> {
    pub(super) waypoint: Position<T>,
    pub(super) end: Instant,
    pub(super) from: Position<T>,
    /// The state of the reference at its end; `None` where the leg came too late to be flown.
    pub(super) reference_end: Option<Motion<T>>,
    /// The setpoint of the leg's end was sent.
    pub(super) final_sent: bool,
    /// The time at which it was echoed, on the autopilot's clock as MAVLink counts it.
    pub(super) confirmed: Option<u32>,
    pub(super) ended: Option<LegEnd<T>>,
}

/// The state of the setpoint stream: timing and the last setpoint sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stream<T: Scalar> {
    pub(super) guide: Guide<T>,
    pub(super) due: Instant,
    pub(super) last: Motion<T>,
    /// Time and altitude at the start of a climb by setpoints.
    pub(super) climb: Option<(Instant, T)>,
}

/// The state of a trial leg.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial<T: Scalar> {
    /// The turning point, m.
    pub(super) turn: Position<T>,
    /// The vehicle is on its way back.
    pub(super) returns: bool,
    /// The largest speed of the reference on the way there, m/s.
    pub(super) asked_mps: T,
    /// The largest measured speed, m/s.
    pub(super) reached_mps: T,
}

/// The requests for telemetry of [`Phase::Checking`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TelemetryRequests {
    /// The next step: the telemetry to request next.
    pub(super) step: u8,
    /// Telemetry that the autopilot refused for good: one bit for each step.
    pub(super) refused: u8,
    /// The time of the last request.
    pub(super) sent_at: Instant,
    /// The time at which the origin of the local frame is requested next.
    pub(super) origin_due: Instant,
}

/// The place of take-off, recorded before the motors are armed.
#[derive(Clone, Copy, Debug)]
pub(super) struct TakeoffSite<T: Scalar> {
    /// The height of the place of take-off above the origin of the autopilot's local frame, which
    /// may be elsewhere, for example where the estimator started.
    pub(super) altitude_m: T,
    /// The distance of the vehicle to the geofence before take-off where it stood outside, m.
    pub(super) outside_fence_m: T,
}

impl<T: Scalar> TakeoffSite<T> {
    /// Returns a place at the origin of the local frame, inside the geofence.
    pub(super) fn new() -> Self {
        Self {
            altitude_m: T::zero(),
            outside_fence_m: T::zero(),
        }
    }
}

/// The lag of the vehicle behind the reference.
#[derive(Clone, Copy, Debug)]
pub(super) struct LagEstimate<T: Scalar> {
    /// The time by which the vehicle follows the reference late, s; negative where it is early. It
    /// is estimated from tick to tick, and the reference is moved ahead by it.
    pub(super) time_s: T,
    /// The last leg neither gained nor lost speed.
    pub(super) cruised: bool,
}

impl<T: Scalar> LagEstimate<T> {
    /// Returns the estimate before the first leg.
    pub(super) fn new() -> Self {
        Self {
            time_s: T::zero(),
            cruised: false,
        }
    }
}
