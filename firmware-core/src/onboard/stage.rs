// SPDX-License-Identifier: MIT OR Apache-2.0
//! The stages of a mission, and the reasons to abort it.

use serde::{Deserialize, Serialize};

use crate::{autopilot::LegError, controller::ControllerError};

/// The stage of the mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stage {
    /// Before slot 1: connecting, checking, taking off, flying to the start.
    Preparing,
    /// On the way to the waypoint of a slot.
    Flying,
    /// At a slot's end, waiting for its channel state.
    Measuring,
    /// All slots done; landing.
    Landing,
    /// On the ground after a complete mission.
    Completed,
    /// The mission was aborted; the autopilot's phase, fault and events give the reason.
    Aborted,
}

/// Error that made the onboard computer, and not the autopilot client, abort a mission.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// The controller returned an error.
    #[error("controller: {0}")]
    Controller(#[from] ControllerError),
    /// A leg could not be flown.
    #[error("leg: {0}")]
    Leg(#[from] LegError),
    /// The autopilot client has no measured position.
    #[error("no measured position")]
    NoPosition,
}
