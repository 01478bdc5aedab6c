// SPDX-License-Identifier: MIT OR Apache-2.0
//! The projection of a displacement onto the set of admissible waypoints.

use super::{intervention::Intervention, reachable::ReachableSet};
use crate::{
    mission::MEASUREMENT_M,
    scalar::{Displacement, Position, Scalar},
};

/// Returns whether a policy's displacement is finite.
pub fn displacement_is_sound<T: Scalar>(displacement: &Displacement<T>) -> bool {
    displacement.x.finite() && displacement.y.finite()
}

/// Returns the admissible waypoint for a [finite](displacement_is_sound) displacement, and records
/// in `changed` what had to change.
pub fn admissible_waypoint<T: Scalar>(
    set: &ReachableSet<T>,
    displacement: &Displacement<T>,
    changed: &mut Intervention,
) -> Position<T> {
    let from = set.step.center;
    // A very long displacement is shortened first, so that the squares below stay finite.
    let extent = set.area.north_east.x.abs() + set.area.north_east.y.abs();
    let far = (extent + set.step.radius_m) * T::of(4.0);
    let longest = displacement.x.abs().max(displacement.y.abs());
    let wish = if longest > far {
        from + displacement * (far / longest)
    } else {
        from + displacement
    };
    match set.nearest(&wish) {
        Some(waypoint) => {
            // Rounding alone is not an intervention.
            let moved = (waypoint - wish).norm() > set.rounding_m;
            changed.displacement |= moved;
            waypoint
        }
        None => {
            let (arrival, reach_m) = (&set.arrival, set.step.radius_m);
            let towards = arrival.center - from;
            let distance = towards.norm();
            let gap = distance - reach_m - arrival.radius_m;
            let outside = !set.area.contains(&from);
            // A gap between the discs smaller than the accuracy of a measurement is not reported.
            changed.out_of_reach = gap > set.rounding_m.max(T::of(MEASUREMENT_M)) || outside;
            changed.displacement |= !changed.out_of_reach;
            let waypoint = if gap <= set.rounding_m && !outside {
                // On a mission without any spare distance the discs only touch, and rounding
                // separates them. A waypoint on the border itself prevents the rounding from
                // accumulating.
                arrival.border_towards(&from)
            } else if distance <= reach_m {
                arrival.center
            } else {
                from + towards * (reach_m / distance)
            };
            set.area.clamp(&waypoint)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mission::Area;

    const AREA: Area<f64> = Area {
        east_m: 1000.0,
        north_m: 800.0,
    };

    #[test]
    fn a_sound_displacement_is_finite_in_both_coordinates() {
        assert!(displacement_is_sound(&Displacement::new(3.0, -1e38)));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(!displacement_is_sound(&Displacement::new(bad, 0.0)));
            assert!(!displacement_is_sound(&Displacement::new(0.0, bad)));
        }
    }

    /// A displacement of any length is cut to a step in its direction, also where its square leaves
    /// the number type.
    #[test]
    fn however_long_a_displacement_its_direction_holds() {
        let area = Area {
            east_m: 1000.0_f32,
            north_m: 800.0,
        };
        let from = Position::new(400.0, 300.0);
        let set = ReachableSet::new(area, from, 30.0, from, 500.0);
        for length_m in [29.0, 31.0, 1e3, 1e6, 1e19, 1e30, 3e38_f32] {
            let mut changed = Intervention::default();
            let displacement = Displacement::new(-0.8, 0.6) * length_m;
            let waypoint = admissible_waypoint(&set, &displacement, &mut changed);
            let step_m = length_m.min(30.0);
            let expected = from + Displacement::new(-0.8, 0.6) * step_m;
            assert!((waypoint - expected).norm() < 1e-3, "{length_m} {waypoint}");
            assert_eq!(changed.displacement, length_m > 30.0);
            assert!(!changed.out_of_reach);
        }
    }

    /// Where `F_n` is empty: the way towards the destination, inside the area, and what is recorded.
    #[test]
    fn without_admissible_places_the_way_is_towards_the_destination() {
        let destination = Position::new(600.0, 500.0);
        let from = |gap_m: f64| destination - Displacement::new(0.6, 0.8) * (50.0 + gap_m);
        let waypoint = |from, destination, step_m, arrival_m, before| {
            let set = ReachableSet::new(AREA, from, step_m, destination, arrival_m);
            assert_eq!(set.nearest(&from), None, "not empty");
            let mut changed = Intervention {
                displacement: before,
                ..Intervention::default()
            };
            let waypoint = admissible_waypoint(&set, &Displacement::zeros(), &mut changed);
            (waypoint, changed.displacement, changed.out_of_reach)
        };
        let near = |a: Position<f64>, b: Position<f64>| (a - b).norm() < 1e-9;
        // Two discs of 30 m and 20 m: a gap that is reported, and one below the accuracy of a
        // measurement. A full step is flown.
        for (gap_m, reported) in [(100.0, true), (MEASUREMENT_M / 2.0, false)] {
            for before in [false, true] {
                let start = from(gap_m);
                let (place, moved, out) = waypoint(start, destination, 30.0, 20.0, before);
                let expected = start + Displacement::new(0.6, 0.8) * 30.0;
                assert!(near(place, expected), "{place} {expected}");
                assert_eq!((moved, out), (before || !reported, reported));
            }
        }
        // Discs that only touch: the waypoint is on the border of the one around the destination.
        let rounding_m = crate::mission::rounding_m(&AREA, 30.0);
        let (place, moved, out) = waypoint(from(0.9 * rounding_m), destination, 30.0, 20.0, false);
        assert!(((place - destination).norm() - 20.0).abs() < 0.2 * rounding_m);
        assert!(moved && !out);
        // Outside the area, with the destination within a step: to it, as far as the area goes.
        let (outside, beside) = (Position::new(-5.0, 50.0), Position::new(-4.0, 52.0));
        let (place, moved, out) = waypoint(outside, beside, 3.0, 1.0, false);
        assert!(near(place, Position::new(0.0, 52.0)), "{place}");
        assert!(!moved && out);
    }
}
