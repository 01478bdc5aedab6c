// SPDX-License-Identifier: MIT OR Apache-2.0
//! The flight of one slot and its end.

use thiserror::Error;

use super::phase::Phase;
use super::telemetry::Sample;
use crate::scalar::{Position, Scalar};
use crate::time::{Instant, Tick};

/// The flight of one slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg<T: Scalar> {
    /// The place to be at by the end, m.
    pub waypoint: Position<T>,
    /// The slot's end, in vehicle time.
    pub end: Instant,
}

/// The end of a leg.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegEnd<T: Scalar> {
    /// The state of the vehicle at the tick.
    pub sample: Sample<T>,
    /// The distance from there to the waypoint, m.
    pub missed_m: T,
    /// The time of the end, and how it was determined.
    pub tick: Tick,
}

/// Error returned when a leg cannot be flown.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LegError {
    /// The vehicle is not ready for legs.
    #[error("no leg can start while {0}")]
    Phase(Phase),
    /// The waypoint has a coordinate that is not finite.
    #[error("the waypoint is not finite")]
    NotFinite,
    /// The waypoint is outside the geofence.
    #[error("the waypoint ({x}, {y}) m is outside the geofence")]
    OutsideFence {
        /// East, m.
        x: f64,
        /// North, m.
        y: f64,
    },
    /// The vehicle's clock is not known yet.
    #[error("the vehicle's clock is not known")]
    NoClock,
}
