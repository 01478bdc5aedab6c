// SPDX-License-Identifier: MIT OR Apache-2.0
//! The start of a leg: the reference that reaches the waypoint at the slot's end.

use super::client::Autopilot;
use super::guidance::Motion;
use super::leg::{Leg, LegError};
use super::phase::Phase;
use super::state::{ActiveLeg, PhaseState};
use crate::limits::MotionLimits;
use crate::scalar::Scalar;
use crate::time::Instant;

/// The largest fraction of the mission's speed that the reference of a leg has: a vehicle that is
/// behind catches up by getting closer to it, not by flying further in a slot than allowed.
const LEG_SPEED: f64 = 0.985;

impl<T: Scalar> Autopilot<T> {
    /// Starts a leg, which arrives at `leg.waypoint` at `leg.end`.
    ///
    /// # Errors
    /// Returns an error if the vehicle is not ready for a leg, if the waypoint is not finite or
    /// outside the geofence, or if the vehicle's clock is not known.
    pub fn fly_leg(&mut self, now: Instant, leg: Leg<T>) -> Result<(), LegError> {
        self.advance(now);
        if !matches!(self.phase(), Phase::Ready | Phase::LegEnded) {
            return Err(LegError::Phase(self.phase()));
        }
        let Some((sample, stream)) = self.telemetry.sample.zip(self.stream.as_mut()) else {
            return Err(LegError::Phase(self.phase()));
        };
        if !(leg.waypoint.x.finite() && leg.waypoint.y.finite()) {
            return Err(LegError::NotFinite);
        }
        let (x, y) = (leg.waypoint.x.to_f64(), leg.waypoint.y.to_f64());
        if let Some(fence) = &self.settings.geofence
            && !fence.contains(&leg.waypoint, T::zero())
        {
            return Err(LegError::OutsideFence { x, y });
        }
        let Some(vehicle_now) = self.telemetry.clock.vehicle_time(now) else {
            return Err(LegError::NoClock);
        };
        // A leg that is over, or nearly, when it is decided cannot be flown any more: the vehicle
        // continues its motion, and the slot still ends at its tick. An ideal vehicle reaches its
        // waypoint at once, so it is never too late.
        let mut reference_end = None;
        let flyable = leg.end > vehicle_now + self.settings.setpoint_interval / 2;
        if flyable || self.limits.is_ideal() {
            // A sample is some time old: the vehicle has flown on since.
            let measured = sample.extrapolated(vehicle_now);
            let measured = Motion {
                velocity: sample.velocity,
                ..Motion::at_rest(measured.position)
            };
            let tolerance = self.settings.lag_tolerance_m;
            // A vehicle that follows late reaches the waypoint in time if the reference is ahead.
            let way = leg.waypoint - sample.position;
            let slot_s = T::of((leg.end - sample.time).as_secs_f64());
            let aim = leg.waypoint + way * (self.lag.time_s / slot_s.max(self.lag.time_s.abs()));
            if !self.limits.is_ideal() {
                let speed_mps = self.settings.transit_speed_mps * T::of(LEG_SPEED);
                stream.guide.set_limits(MotionLimits {
                    speed_mps: self.limits.speed_mps.min(speed_mps),
                    ..self.limits
                });
            }
            stream
                .guide
                .fly_leg(vehicle_now, leg.end, aim, measured, tolerance);
            stream.due = now;
            reference_end = Some(stream.guide.target());
        }
        // The ground link is supervised from the first leg on.
        self.ground_heard.get_or_insert(now);
        self.leg = Some(ActiveLeg {
            waypoint: leg.waypoint,
            end: leg.end,
            from: sample.position,
            reference_end,
            final_sent: !flyable && !self.limits.is_ideal(),
            confirmed: None,
            ended: None,
        });
        self.enter(now, PhaseState::Leg);
        Ok(())
    }
}
