// SPDX-License-Identifier: MIT OR Apache-2.0
//! Laws of trajectories and of the reference.

use proptest::prelude::*;

use nalgebra::Vector2;

use super::*;
use crate::limits::MotionLimits;
use crate::scalar::Position;
use crate::time::{Duration, Instant};

const LIMITS: MotionLimits<f64> = MotionLimits {
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
        &MotionLimits::ideal(),
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
