//! The vehicle's end of the MAVLink link: built in, or elsewhere.

use std::{io, time::Duration as WallDuration};

use firmware_core::{Position, time::Instant};

use crate::vehicle::Vehicle;

/// The vehicle at the other end of the MAVLink link.
#[derive(Debug)]
pub enum Peer {
    /// The vehicle of this process, in simulated time.
    BuiltIn(Box<Vehicle>),
}

impl Peer {
    pub(super) fn is_built_in(&self) -> bool {
        matches!(self, Self::BuiltIn(_))
    }

    /// Lets time pass where it is simulated.
    pub(super) fn step(&mut self, now: Instant) {
        match self {
            Self::BuiltIn(vehicle) => vehicle.step(now),
        }
    }

    /// A datagram from the vehicle, if there is one.
    pub(super) fn receive(&mut self, _now: Instant) -> io::Result<Option<Vec<u8>>> {
        match self {
            Self::BuiltIn(vehicle) => Ok(vehicle.next_frame()),
        }
    }

    /// A frame to the vehicle.
    pub(super) fn send(&mut self, now: Instant, frame: &[u8]) -> io::Result<()> {
        match self {
            Self::BuiltIn(vehicle) => vehicle.receive(now, frame),
        }
        Ok(())
    }

    /// Waits for something to come, at most so long.
    pub(super) fn wait(&mut self, _longest: WallDuration) -> io::Result<()> {
        Ok(())
    }

    /// Where the vehicle truly is, where that is known.
    pub(super) fn true_position(&self) -> Option<Position<f64>> {
        match self {
            Self::BuiltIn(vehicle) => Some(vehicle.true_position()),
        }
    }

    /// How high it truly is, metres, where that is known.
    pub(super) fn altitude_m(&self) -> Option<f64> {
        match self {
            Self::BuiltIn(vehicle) => Some(vehicle.altitude_m()),
        }
    }
}
