//! State of the client that exists only in a part of a flight.

use super::guidance::{Guide, Motion};
use super::leg::LegEnd;
use crate::scalar::{Position, Scalar};
use crate::time::Instant;

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
