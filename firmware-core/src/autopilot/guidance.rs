//! Where the vehicle should be *now*: trajectories between waypoints.
//!
//! Autopilots treat a bare position as a place to stop at; flown at the mission's speed the vehicle
//! lags by a hundred metres. The client therefore streams position, velocity and acceleration of a
//! moving reference. A [`Trajectory`] is a polynomial of degree five per axis, defined by position,
//! velocity and acceleration at both ends; the acceleration at its end is zero.
//!
//! [`Guide`] connects trajectories:
//!
//! * a **leg** reaches its waypoint at the slot's end, passing through it with the mean velocity of
//!   the leg. Where [`Limits`] do not allow that (from rest, round a sharp corner, to a place
//!   behind the vehicle) the acceleration changes, linearly over the leg, to the one that follows
//!   the waypoints best: their own velocity, plus a correction no faster than can be braked.
//! * a **transit** goes from rest to rest, in the least time that the limits allow.
//! * a **coast** follows a leg until the next one is known: the vehicle flies on with the leg's
//!   final velocity while its position is measured and the next waypoint is decided.
//! * a **stop** follows a trajectory that was not continued: the reference decelerates to rest. A
//!   stream never ends with a velocity in it.
//!
//! All times in this module are on the vehicle's clock.

use nalgebra::Vector2;

use crate::scalar::{Displacement, Position, Scalar};
use crate::time::{Duration, Instant};

/// The limits of the vehicle. Infinite for the paper's kinematics.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Limits<T> {
    /// Largest horizontal speed, m/s.
    pub speed_mps: T,
    /// Largest horizontal acceleration, m/s^2.
    pub acceleration_mps2: T,
    /// Largest change of acceleration, m/s^3.
    pub jerk_mps3: T,
}

impl<T: Scalar> Limits<T> {
    /// Returns no limits but the mission's own: every waypoint is reached at the slot's end.
    pub fn ideal() -> Self {
        let infinity = T::of(f64::INFINITY);
        Self {
            speed_mps: infinity,
            acceleration_mps2: infinity,
            jerk_mps3: infinity,
        }
    }

    /// Returns whether only the mission limits the vehicle.
    pub fn is_ideal(&self) -> bool {
        !self.acceleration_mps2.finite()
    }

    /// Returns whether each limit is above zero (infinity included).
    pub fn is_valid(&self) -> bool {
        [self.speed_mps, self.acceleration_mps2, self.jerk_mps3]
            .iter()
            .all(|&limit| limit > T::zero())
    }
}

/// Position, velocity and acceleration at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<T: Scalar> {
    /// Place on the map, m.
    pub position: Position<T>,
    /// Velocity over ground, m/s.
    pub velocity: Displacement<T>,
    /// Acceleration, m/s^2.
    pub acceleration: Displacement<T>,
}

impl<T: Scalar> Motion<T> {
    /// Returns the motion of a vehicle at rest.
    pub fn at_rest(position: Position<T>) -> Self {
        Self {
            position,
            velocity: Vector2::zeros(),
            acceleration: Vector2::zeros(),
        }
    }

    /// Returns the motion after `seconds` in which the acceleration fades to zero.
    fn faded(&self, seconds: T) -> Self {
        let gained = self.acceleration * (seconds * T::of(0.5));
        let moved = (self.velocity + self.acceleration * (seconds * T::of(1.0 / 3.0))) * seconds;
        Self {
            position: self.position + moved,
            velocity: self.velocity + gained,
            acceleration: Vector2::zeros(),
        }
    }

    /// Returns whether every number is finite.
    pub fn is_finite(&self) -> bool {
        let finite = |v: &Vector2<T>| v.x.finite() && v.y.finite();
        finite(&self.position.coords) && finite(&self.velocity) && finite(&self.acceleration)
    }
}

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
/// the waypoints, the velocity then satisfies `v_n = (FEEDFORWARD / 2) (v_{n-1} + v_{n-2}) -
/// CORRECTION v_{n-1}`, and about a place to hover at, with the error `e`, `v_n = (1 - FEEDFORWARD
/// + CORRECTION) e - CORRECTION v_{n-1}`: both decay by a factor of two or more a slot. (With 1 and
/// 1 the first has the root -1 and oscillates for ever. Without feedforward a fast vehicle
/// overshoots a place to hover at repeatedly.)
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

    fn at_fraction(&self, s: T, span: T) -> Motion<T> {
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

    fn jerk(&self, s: T, span: T) -> Displacement<T> {
        let [c3, c4, c5] = self.high;
        let of = T::of;
        (c3 * of(6.0) + (c4 * of(24.0) + c5 * (of(60.0) * s)) * s) / (span * span * span)
    }

    /// Returns the largest factor by which it exceeds the limits; 1 or less where it keeps them. A
    /// limit that is already exceeded at its start is replaced by the value there.
    fn limit_ratio(&self, limits: &Limits<T>) -> T {
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
        limits: &Limits<T>,
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
    fn chase(
        now: Instant,
        span: Duration,
        from: Motion<T>,
        waypoint: Position<T>,
        feedforward: Displacement<T>,
        limits: &Limits<T>,
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
    pub fn run_up_m(speed_mps: T, limits: &Limits<T>) -> T {
        let speed_mps = speed_mps.min(limits.speed_mps);
        let square = speed_mps * speed_mps;
        let by_acceleration = square / limits.acceleration_mps2 * T::of(1.6424);
        let by_jerk = (square * speed_mps / limits.jerk_mps3).sqrt() * T::of(3.0172);
        by_acceleration.max(by_jerk)
    }

    /// Creates a straight trajectory to `place` that ends at rest, in the least time for which a
    /// start from rest keeps the limits.
    pub fn transit(now: Instant, from: Motion<T>, place: Position<T>, limits: &Limits<T>) -> Self {
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
    pub fn stop(now: Instant, from: Motion<T>, limits: &Limits<T>) -> Self {
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
    fn coast(now: Instant, from: Motion<T>, span: Duration) -> Self {
        let to = from.faded(T::of(span.as_secs_f64()));
        Self::new(now, span, from, to)
    }

    fn stop_in(now: Instant, seconds: f64, from: Motion<T>) -> Self {
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

/// The reference over time: one trajectory after another, with a coast after a leg, and a stop
/// after a trajectory that was not continued.
#[derive(Clone, Copy, Debug)]
pub struct Guide<T: Scalar> {
    limits: Limits<T>,
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
    pub fn new(now: Instant, place: Position<T>, limits: Limits<T>, grace: Duration) -> Self {
        Self {
            limits,
            current: Trajectory::rest(now, place),
            coasting: None,
            last: (place, now),
            grace,
        }
    }

    /// Replaces the limits. The next trajectory is the first that keeps the new ones.
    pub(super) fn set_limits(&mut self, limits: Limits<T>) {
        self.limits = limits;
    }

    /// Returns the limits of the vehicle.
    pub fn limits(&self) -> &Limits<T> {
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
        let limits = Limits {
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

/// Returns `vector`, shortened to at most `longest`.
fn shorten<T: Scalar>(vector: Displacement<T>, longest: T) -> Displacement<T> {
    let length = vector.norm();
    if length > longest {
        vector * (longest / length)
    } else {
        vector
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LIMITS: Limits<f64> = Limits {
        speed_mps: 32.0,
        acceleration_mps2: 9.0,
        jerk_mps3: 40.0,
    };
    const SECOND: Duration = Duration::from_secs(1);

    fn at(seconds: f64) -> Instant {
        Instant::ZERO + Duration::from_secs_f64(seconds)
    }

    #[test]
    fn an_ideal_leg_ends_exactly_at_its_waypoint() {
        let waypoint = Position::new(31.7_f32, -12.03);
        let from = Motion::at_rest(Position::new(3.0_f32, 4.0));
        let leg = Trajectory::leg(
            at(2.0),
            at(3.0),
            from,
            waypoint,
            Vector2::zeros(),
            &Limits::ideal(),
        );
        assert_eq!(leg.at(at(3.0)).position, waypoint);
        assert_eq!(leg.at(at(2.0)).position, from.position);
        // Straight on the way.
        let half = leg.at(at(2.5)).position;
        let cross = (half - from.position).perp(&(waypoint - from.position));
        assert!(cross.abs() < 1e-3, "{half}");
    }

    #[test]
    fn a_straight_flight_gathers_speed_and_keeps_it() {
        // 28 m per slot from rest, planned again each slot from the reference.
        let mut guide = Guide::new(at(0.0), Position::origin(), LIMITS, SECOND);
        let mut missed = std::vec::Vec::new();
        for slot in 0..20 {
            let now = guide.at(at(slot as f64));
            let waypoint = now.position + Vector2::new(28.0, 0.0);
            guide.fly_leg(at(slot as f64), at(slot as f64 + 1.0), waypoint, now, 1.0);
            missed.push((guide.target().position - waypoint).norm());
        }
        assert!(missed[0] > 15.0, "from rest: {missed:?}");
        assert!(missed[10..].iter().all(|&m| m < 0.5), "{missed:?}");
    }

    #[test]
    fn what_is_not_continued_comes_to_rest() {
        let mut guide = Guide::new(at(0.0), Position::origin(), LIMITS, SECOND / 10);
        let moving = Motion {
            velocity: Vector2::new(20.0, 0.0),
            ..Motion::at_rest(Position::origin())
        };
        guide.fly_leg(at(0.0), at(1.0), Position::new(20.0, 0.0), moving, -1.0);
        assert!(guide.at(at(1.05)).velocity.norm() > 19.0, "grace");
        let after = guide.at(at(1.2));
        assert!(
            after.velocity.norm() < 20.0 && after.position.x > 20.0,
            "{after:?}"
        );
        let rest = guide.at(at(20.0));
        assert_eq!(rest.velocity, Vector2::zeros());
        assert!((40.0..70.0).contains(&rest.position.x), "{rest:?}");
        assert_eq!(guide.at(at(21.0)), rest);
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: proptest::test_runner::RngSeed::Fixed(1),
            ..ProptestConfig::with_cases(2000)
        })]

        /// From any motion within the limits, to any waypoint: finite, and between the points
        /// that are checked the limits hold to 3 %. Where letting go overshoots the speed while
        /// the acceleration fades, nothing that is flown overshoots it more.
        #[test]
        fn legs_keep_the_limits(
            v in (0.0..32.0, 0.0..6.3), a in (0.0..9.0, 0.0..6.3),
            d in (0.0..60.0, 0.0..6.3), span in 0.5f64..3.0,
        ) {
            let polar = |(r, phi): (f64, f64)| Vector2::new(r * phi.cos(), r * phi.sin());
            let from = Motion {
                position: Position::new(100.0, -50.0),
                velocity: polar(v),
                acceleration: polar(a),
            };
            let waypoint = from.position + polar(d);
            let leg = Trajectory::leg(at(0.0), at(span), from, waypoint, Vector2::zeros(), &LIMITS);
            for i in 0..=100 {
                let motion = leg.at(at(span * f64::from(i) / 100.0));
                prop_assert!(motion.is_finite());
                prop_assert!(motion.acceleration.norm() <= 9.0 * 1.03, "{motion:?}");
                let let_go_mps = v.0 + a.0 * span / 2.0;
                let speed_mps = motion.velocity.norm();
                prop_assert!(speed_mps <= let_go_mps.max(32.0) * 1.03, "{motion:?}");
                let jerk_mps3 = leg.jerk(f64::from(i) / 100.0, span).norm();
                prop_assert!(jerk_mps3 <= 40.0 * 1.03, "{jerk_mps3} {leg:?}");
            }
        }

        /// A stop from any motion that a leg of a second can have: see [`Trajectory::stop`].
        #[test]
        fn stops_keep_the_limits(
            v in (0.0..1.0, 0.0..6.3), a in (0.0..9.0, 0.0..6.3),
        ) {
            let polar = |(r, phi): (f64, f64)| Vector2::new(r * phi.cos(), r * phi.sin());
            let from = Motion {
                position: Position::origin(),
                velocity: polar((v.0 * (32.0 - a.0 / 2.0), v.1)),
                acceleration: polar(a),
            };
            let stop = Trajectory::stop(at(0.0), from, &LIMITS);
            let span = (stop.end() - at(0.0)).as_secs_f64();
            for i in 0..=100 {
                let fraction = f64::from(i) / 100.0;
                let motion = stop.at_fraction(fraction, span);
                prop_assert!(motion.is_finite());
                prop_assert!(motion.velocity.norm() <= 32.0 * 1.03, "{motion:?}");
                prop_assert!(motion.acceleration.norm() <= 9.0 * 1.03, "{motion:?}");
                let jerk_mps3 = stop.jerk(fraction, span).norm();
                prop_assert!(jerk_mps3 <= 40.0 * 1.03, "{jerk_mps3} {stop:?}");
            }
            prop_assert_eq!(stop.at(stop.end()).velocity, Vector2::zeros());
        }

        /// Transits and stops keep the limits and end at rest.
        #[test]
        fn transits_keep_the_limits(d in 0.0f64..2000.0, v in 0.0f64..30.0) {
            let from = Motion::at_rest(Position::origin());
            let place = Position::new(d, 0.0);
            let moving = Motion { velocity: Vector2::new(0.0, v), ..from };
            for path in [
                Trajectory::transit(at(0.0), from, place, &LIMITS),
                Trajectory::stop(at(0.0), moving, &LIMITS),
            ] {
                let span = (path.end() - at(0.0)).as_secs_f64();
                for i in 0..=100 {
                    let motion = path.at(at(span * f64::from(i) / 100.0));
                    prop_assert!(motion.is_finite());
                    prop_assert!(motion.velocity.norm() <= 32.0 * 1.001);
                    prop_assert!(motion.acceleration.norm() <= 9.0 * 1.001);
                }
                prop_assert_eq!(path.at(path.end()).velocity, Vector2::zeros());
            }
        }
    }
}
