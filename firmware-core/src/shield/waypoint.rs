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
