// SPDX-License-Identifier: MIT OR Apache-2.0
//! The reference over time: a sequence of trajectories.

use nalgebra::Vector2;

use super::motion::Motion;
use super::trajectory::{Trajectory, shorten};
use crate::limits::MotionLimits;
use crate::scalar::{Position, Scalar};
use crate::time::{Duration, Instant};

/// The reference over time: one trajectory after another, with a coast after a leg, and a stop
/// after a trajectory that was not continued.
#[derive(Clone, Copy, Debug)]
pub struct Guide<T: Scalar> {
    limits: MotionLimits<T>,
    current: Trajectory<T>,
    /// The start of the present coast, if there is one.
    coasting: Option<Instant>,
    /// The waypoint of the last leg and the time at which it was due; the place of rest before the
    /// first.
    last: (Position<T>, Instant),
    /// The longest time of a coast before the stop begins.
    grace: Duration,
}

impl<T: Scalar> Guide<T> {
    /// Creates a reference that rests at a place.
    pub fn new(now: Instant, place: Position<T>, limits: MotionLimits<T>, grace: Duration) -> Self {
        Self {
            limits,
            current: Trajectory::rest(now, place),
            coasting: None,
            last: (place, now),
            grace,
        }
    }

    /// Replaces the limits. The next trajectory is the first that keeps the new ones.
    pub(in crate::autopilot) fn set_limits(&mut self, limits: MotionLimits<T>) {
        self.limits = limits;
    }

    /// Returns the limits of the vehicle.
    pub fn limits(&self) -> &MotionLimits<T> {
        &self.limits
    }

    /// Returns the reference at `now`.
    pub fn at(&mut self, now: Instant) -> Motion<T> {
        let end = self.current.end();
        let target = self.current.target();
        if self.coasting.is_none() && now > end && target.velocity != Vector2::zeros() {
            self.current = Trajectory::coast(end, target, self.grace);
            self.coasting = Some(end);
        }
        if let Some(since) = self.coasting
            && now > since + self.grace
        {
            let after = since + self.grace;
            self.replace(Trajectory::stop(
                after,
                self.current.at(after),
                &self.limits,
            ));
        }
        self.current.at(now)
    }

    fn replace(&mut self, trajectory: Trajectory<T>) {
        self.current = trajectory;
        self.coasting = None;
    }

    /// Returns when the present trajectory ends.
    pub fn end(&self) -> Instant {
        self.current.end()
    }

    /// Returns the motion at the end of the present trajectory.
    pub fn target(&self) -> Motion<T> {
        self.current.target()
    }

    /// Starts a leg. The reference continues from where it is if the vehicle, which is at
    /// `measured` now, is within `tolerance_m` of it; otherwise it starts from the vehicle itself.
    pub fn fly_leg(
        &mut self,
        now: Instant,
        end: Instant,
        waypoint: Position<T>,
        measured: Motion<T>,
        tolerance_m: T,
    ) {
        let reference = self.at(now);
        let lag = (reference.position - measured.position).norm();
        let from = if lag <= tolerance_m {
            reference
        } else {
            measured
        };
        let (last, due) = self.last;
        let between_s = T::of(end.duration_since(due).as_secs_f64());
        let feedforward = if between_s > T::zero() {
            (waypoint - last) / between_s
        } else {
            Vector2::zeros()
        };
        // A waypoint that was never reached says little about the motion of the waypoints: the
        // velocity that leads to the next one is sufficient.
        let leg_s = T::of(end.duration_since(now).as_secs_f64());
        let feedforward = if leg_s > T::zero() {
            shorten(
                feedforward,
                (waypoint - from.position).norm() * T::of(2.0) / leg_s,
            )
        } else {
            feedforward
        };
        self.last = (waypoint, end);
        let leg = Trajectory::leg(now, end, from, waypoint, feedforward, &self.limits);
        self.replace(leg);
    }

    /// Starts a transit from the present reference.
    pub fn transit(&mut self, now: Instant, place: Position<T>, speed_mps: T) {
        let limits = MotionLimits {
            speed_mps: self.limits.speed_mps.min(speed_mps),
            ..self.limits
        };
        let transit = Trajectory::transit(now, self.at(now), place, &limits);
        self.replace(transit);
        self.last = (place, self.current.end());
    }

    /// Brings the reference to rest.
    pub fn stop(&mut self, now: Instant) {
        let stop = Trajectory::stop(now, self.at(now), &self.limits);
        self.replace(stop);
    }
}
