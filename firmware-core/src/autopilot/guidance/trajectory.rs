// SPDX-License-Identifier: MIT OR Apache-2.0
//! Trajectories: polynomials in time that keep the limits of the vehicle.

use nalgebra::Vector2;

use super::motion::Motion;
use crate::limits::MotionLimits;
use crate::scalar::{Displacement, Position, Scalar};
use crate::time::{Duration, Instant};

/// A polynomial of degree five in time, per axis, between two [`Motion`]s.
#[derive(Clone, Copy, Debug)]
pub struct Trajectory<T: Scalar> {
    start: Instant,
    span: Duration,
    from: Motion<T>,
    to: Motion<T>,
    /// Coefficients of t^3, t^4, t^5 with t in units of the span.
    high: [Displacement<T>; 3],
}

/// The number of points of a trajectory at which limits are checked.
const CHECKED: usize = 12;

/// The number of halvings in the search for the largest fraction that the limits allow: to 1/512.
const HALVINGS: usize = 9;

/// Weights for following a waypoint that cannot be passed through: the fraction of the waypoints'
/// own velocity, the rest being the velocity that would reach the waypoint, and the fraction of the
/// remaining distance that is corrected within a slot.
///
/// Every waypoint is planned from the vehicle's present position. Perpendicular to the direction of
/// the waypoints, the velocity then satisfies
///
/// ```text
/// v_n = (FEEDFORWARD / 2) (v_{n-1} + v_{n-2}) - CORRECTION v_{n-1}
/// ```
///
/// and about a place to hover at, with the error `e`,
///
/// ```text
/// v_n = (1 - FEEDFORWARD + CORRECTION) e - CORRECTION v_{n-1}
/// ```
///
/// Both decay by a factor of two or more a slot. (With 1 and 1 the first has the root -1 and
/// oscillates without end. Without feedforward a fast vehicle overshoots a place to hover at
/// repeatedly.)
const FEEDFORWARD: f64 = 0.3;
const CORRECTION: f64 = 0.35;

/// The number of durations that are tried for a stop, and the factor between them.
const STOPS: usize = 20;
const STOP_GROWTH: f64 = 1.04;

impl<T: Scalar> Trajectory<T> {
    /// Creates a trajectory from one motion to another in `span`. With a span of zero it is at `to`
    /// at once.
    pub fn new(start: Instant, span: Duration, from: Motion<T>, to: Motion<T>) -> Self {
        let t = T::of(span.as_secs_f64());
        let half = T::of(0.5);
        // In units of the span: the differences that a constant acceleration would leave at the
        // end.
        let (v0, a0) = (from.velocity * t, from.acceleration * (t * t));
        let (v1, a1) = (to.velocity * t, to.acceleration * (t * t));
        let p = to.position - from.position - v0 - a0 * half;
        let v = v1 - v0 - a0;
        let a = a1 - a0;
        let of = T::of;
        let high = [
            p * of(10.0) - v * of(4.0) + a * half,
            p * of(-15.0) + v * of(7.0) - a,
            p * of(6.0) - v * of(3.0) + a * half,
        ];
        Self {
            start,
            span,
            from,
            to,
            high,
        }
    }

    /// Creates a trajectory that rests at a place.
    pub fn rest(now: Instant, position: Position<T>) -> Self {
        let still = Motion::at_rest(position);
        Self::new(now, Duration::ZERO, still, still)
    }

    /// Returns when it ends.
    pub fn end(&self) -> Instant {
        self.start + self.span
    }

    /// Returns the motion at its end.
    pub fn target(&self) -> Motion<T> {
        self.to
    }

    /// Returns the motion at `now`; exactly [`Trajectory::target`] from its end on.
    pub fn at(&self, now: Instant) -> Motion<T> {
        if now >= self.end() {
            return self.to;
        }
        let span = self.span.as_secs_f64();
        self.at_fraction(T::of((now - self.start).as_secs_f64() / span), T::of(span))
    }

    pub(super) fn at_fraction(&self, s: T, span: T) -> Motion<T> {
        let [c3, c4, c5] = self.high;
        let of = T::of;
        let (v0, a0) = (
            self.from.velocity * span,
            self.from.acceleration * (span * span),
        );
        let position =
            self.from.position + (v0 + (a0 * of(0.5) + (c3 + (c4 + c5 * s) * s) * s) * s) * s;
        let velocity = v0 + (a0 + (c3 * of(3.0) + (c4 * of(4.0) + c5 * (of(5.0) * s)) * s) * s) * s;
        let acceleration = a0 + (c3 * of(6.0) + (c4 * of(12.0) + c5 * (of(20.0) * s)) * s) * s;
        Motion {
            position,
            velocity: velocity / span,
            acceleration: acceleration / (span * span),
        }
    }

    pub(super) fn jerk(&self, s: T, span: T) -> Displacement<T> {
        let [c3, c4, c5] = self.high;
        let of = T::of;
        (c3 * of(6.0) + (c4 * of(24.0) + c5 * (of(60.0) * s)) * s) / (span * span * span)
    }

    /// Returns the largest factor by which it exceeds the limits; 1 or less where it keeps them. A
    /// limit that is already exceeded at its start is replaced by the value there.
    pub(super) fn limit_ratio(&self, limits: &MotionLimits<T>) -> T {
        let span = T::of(self.span.as_secs_f64());
        let speed = limits.speed_mps.max(self.from.velocity.norm());
        let acceleration = limits.acceleration_mps2.max(self.from.acceleration.norm());
        let mut worst = T::zero();
        for i in 0..=CHECKED {
            let s = T::count(i) / T::count(CHECKED);
            let motion = self.at_fraction(s, span);
            worst = worst
                .max(motion.velocity.norm() / speed)
                .max(motion.acceleration.norm() / acceleration)
                .max(self.jerk(s, span).norm() / limits.jerk_mps3);
        }
        worst
    }

    /// Creates a leg from `from` to `waypoint` at `end`, which passes through the waypoint with the
    /// leg's mean velocity if `limits` allow it, and follows it if not. `feedforward` is the
    /// velocity of the waypoints themselves, from one slot to the next.
    ///
    /// Worst case: 11 candidates of 26 points.
    pub fn leg(
        now: Instant,
        end: Instant,
        from: Motion<T>,
        waypoint: Position<T>,
        feedforward: Displacement<T>,
        limits: &MotionLimits<T>,
    ) -> Self {
        let span = end - now;
        let t = T::of(span.as_secs_f64());
        let ahead = waypoint - from.position;
        let mean = if t > T::zero() {
            ahead / t
        } else {
            Vector2::zeros()
        };
        let to = Motion {
            position: waypoint,
            velocity: mean,
            acceleration: Vector2::zeros(),
        };
        let through = Self::new(now, span, from, to);
        if t <= T::zero() || through.limit_ratio(limits) <= T::one() {
            return through;
        }
        Self::chase(now, span, from, waypoint, feedforward, limits)
    }

    /// Creates a leg that follows a waypoint which it cannot pass through. The acceleration changes
    /// linearly to a final one that the limits allow: the largest fraction, between a final
    /// acceleration of zero and the wanted one, that keeps them.
    pub(super) fn chase(
        now: Instant,
        span: Duration,
        from: Motion<T>,
        waypoint: Position<T>,
        feedforward: Displacement<T>,
        limits: &MotionLimits<T>,
    ) -> Self {
        let t = T::of(span.as_secs_f64());
        let (half, third) = (T::of(0.5), T::of(1.0 / 3.0));
        // The position that a final acceleration of zero would lead to.
        let coast_position = from.position + (from.velocity + from.acceleration * (t * third)) * t;
        // Beside the waypoints' own velocity, no more than can be braked with half of the
        // acceleration over the remaining distance.
        let left = waypoint - coast_position;
        let brakable = (limits.acceleration_mps2 * left.norm()).sqrt();
        let behind = (waypoint - from.position) / t - feedforward;
        let correction = behind * T::of(1.0 - FEEDFORWARD) + left * (T::of(CORRECTION) / t);
        let velocity = shorten(
            feedforward + shorten(correction, brakable),
            limits.speed_mps,
        );
        let change = (velocity - from.velocity) / t;
        let wanted = shorten(change, limits.acceleration_mps2);
        let let_go = from.acceleration * half;
        // With a fraction of zero the acceleration fades linearly. Otherwise it is a parabola over
        // the leg, with the wanted mean, and ends with what is still to be changed.
        let toward = |fraction: T| {
            let mean = let_go + (wanted - let_go) * fraction;
            let acceleration = shorten(change - mean, limits.acceleration_mps2) * fraction;
            let bend = (from.acceleration + acceleration) * T::of(3.0) - mean * T::of(6.0);
            let slope = acceleration - from.acceleration - bend;
            let moved =
                from.acceleration * half + slope * T::of(1.0 / 6.0) + bend * T::of(1.0 / 12.0);
            let to = Motion {
                position: from.position + from.velocity * t + moved * (t * t),
                velocity: from.velocity + mean * t,
                acceleration,
            };
            // The limits must hold while that acceleration fades, too.
            let fading = Self::new(now + span, span, to, to.faded(t));
            let leg = Self::new(now, span, from, to);
            (leg, leg.limit_ratio(limits).max(fading.limit_ratio(limits)))
        };
        let (all, limit_ratio) = toward(T::one());
        if limit_ratio <= T::one() {
            return all;
        }
        // Everything is linear in the fraction and the limits are convex, so the fractions that
        // keep them are those up to a largest one.
        let (mut kept, mut broken) = (T::zero(), T::one());
        for _ in 0..HALVINGS {
            let middle = (kept + broken) * half;
            if toward(middle).1 <= T::one() {
                kept = middle;
            } else {
                broken = middle;
            }
        }
        toward(kept).0
    }

    /// Returns the length of a [`transit`](Self::transit) from rest that reaches `speed_mps`, m.
    pub fn run_up_m(speed_mps: T, limits: &MotionLimits<T>) -> T {
        let speed_mps = speed_mps.min(limits.speed_mps);
        let square = speed_mps * speed_mps;
        let by_acceleration = square / limits.acceleration_mps2 * T::of(1.6424);
        let by_jerk = (square * speed_mps / limits.jerk_mps3).sqrt() * T::of(3.0172);
        by_acceleration.max(by_jerk)
    }

    /// Creates a straight trajectory to `place` that ends at rest, in the least time for which a
    /// start from rest keeps the limits.
    pub fn transit(
        now: Instant,
        from: Motion<T>,
        place: Position<T>,
        limits: &MotionLimits<T>,
    ) -> Self {
        let distance = (place - from.position).norm().to_f64();
        // Peaks of a rest-to-rest polynomial of degree five over unit distance and time.
        let by_speed = 1.875 * distance / limits.speed_mps.to_f64();
        let by_acceleration = libm::sqrt(5.774 * distance / limits.acceleration_mps2.to_f64());
        let by_jerk = libm::cbrt(60.0 * distance / limits.jerk_mps3.to_f64());
        let brake = Self::stop(now, from, limits).span.as_secs_f64() * 2.0;
        let seconds = by_speed.max(by_acceleration).max(by_jerk).max(brake);
        Self::new(
            now,
            Duration::from_secs_f64(seconds),
            from,
            Motion::at_rest(place),
        )
    }

    /// Creates a trajectory to rest, at any place, in the least time for which the limits are kept.
    /// While an acceleration fades first, the speed still grows; where no time keeps all limits,
    /// the one that exceeds them least is used: by 3 % at most if the speed stays within them while
    /// the acceleration fades within a second, which legs of a second ensure.
    ///
    /// Worst case: 20 candidates of 13 points.
    pub fn stop(now: Instant, from: Motion<T>, limits: &MotionLimits<T>) -> Self {
        let speed = from.velocity.norm().to_f64();
        let acceleration = from.acceleration.norm().to_f64();
        let seconds = (1.5 * speed / limits.acceleration_mps2.to_f64())
            .max(libm::sqrt(6.0 * speed / limits.jerk_mps3.to_f64()))
            .max(4.0 * acceleration / limits.jerk_mps3.to_f64());
        let mut best = Self::stop_in(now, seconds, from);
        if best.span.is_zero() || acceleration <= 0.0 {
            return best;
        }
        let mut least = best.limit_ratio(limits);
        let mut longer = seconds;
        for _ in 1..STOPS {
            if least <= T::of(1.001) {
                break;
            }
            longer *= STOP_GROWTH;
            let stop = Self::stop_in(now, longer, from);
            let limit_ratio = stop.limit_ratio(limits);
            if limit_ratio < least {
                (best, least) = (stop, limit_ratio);
            }
        }
        best
    }

    /// Creates a trajectory that continues `from` for `span`, while the acceleration fades to zero.
    pub(super) fn coast(now: Instant, from: Motion<T>, span: Duration) -> Self {
        let to = from.faded(T::of(span.as_secs_f64()));
        Self::new(now, span, from, to)
    }

    pub(super) fn stop_in(now: Instant, seconds: f64, from: Motion<T>) -> Self {
        let t = T::of(seconds);
        let place = from.position
            + from.velocity * (t * T::of(0.5))
            + from.acceleration * (t * t * T::of(1.0 / 12.0));
        Self::new(
            now,
            Duration::from_secs_f64(seconds),
            from,
            Motion::at_rest(place),
        )
    }
}

/// Returns `vector`, shortened to at most `longest`.
pub(super) fn shorten<T: Scalar>(vector: Displacement<T>, longest: T) -> Displacement<T> {
    let length = vector.norm();
    if length > longest {
        vector * (longest / length)
    } else {
        vector
    }
}
