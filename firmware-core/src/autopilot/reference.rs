// SPDX-License-Identifier: MIT OR Apache-2.0
//! The reference outside of legs: it holds a place, or moves to one and comes to rest there.

use super::client::Autopilot;
use super::guidance::{Guide, Motion};
use super::state::Stream;
use crate::scalar::{Position, Scalar};
use crate::time::Instant;

impl<T: Scalar> Autopilot<T> {
    /// Starts to stream a setpoint at the vehicle's present position.
    pub(super) fn hold_here(&mut self, now: Instant, on_ground: bool) {
        let Some(sample) = self.telemetry.sample else {
            return;
        };
        let Some(vehicle_now) = self.vehicle_time(now) else {
            return;
        };
        let (place, height_m) = (sample.position, self.height_m(&sample));
        let grace = self.settings.coast;
        self.stream = Some(Stream {
            guide: Guide::new(vehicle_now, place, self.limits, grace),
            due: now,
            last: Motion::at_rest(place),
            // Until the climb begins, it has begun in the far future.
            climb: on_ground.then_some((Instant::from_micros(u64::MAX), height_m)),
        });
    }

    /// Starts a transit of the reference to a place, where it comes to rest. Returns false where no
    /// setpoints are streamed.
    pub(super) fn start_transit(&mut self, now: Instant, place: Position<T>) -> bool {
        let vehicle_now = self.vehicle_time(now);
        let Some((stream, vehicle_now)) = self.stream.as_mut().zip(vehicle_now) else {
            return false;
        };
        stream.guide.set_limits(self.limits);
        let speed_mps = self.settings.transit_speed_mps;
        stream.guide.transit(vehicle_now, place, speed_mps);
        stream.due = now;
        true
    }

    /// Returns whether the reference has come to rest and the vehicle is at the place.
    pub(super) fn has_arrived_at(&self, now: Instant, place: Position<T>) -> bool {
        let vehicle_now = self.vehicle_time(now);
        let over = |s: &Stream<T>| vehicle_now.is_some_and(|now| now >= s.guide.end());
        self.stream.as_ref().is_some_and(over)
            && self.telemetry.sample.is_some_and(|sample| {
                (sample.position - place).norm() <= self.settings.arrival_radius_m
            })
    }
}
