//! The set of admissible waypoints of a slot.

use super::{
    agility::{ARRIVAL_FRACTION, Agility},
    geometry::{Disc, Rectangle},
};
use crate::{
    mission::{Area, Mission, rounding_m},
    scalar::{Displacement, Position, Scalar},
};

/// The fraction of `V_max delta` by which a vehicle with inertia keeps away from the border of the
/// area, for the same reason.
const BORDER_FRACTION: f64 = 0.25;

/// The fraction of the acceleration that is used to brake before a border.
const BORDER_BRAKING_FRACTION: f64 = 0.4;

/// `F_n`: the set of places where the vehicle may be at the end of the slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReachableSet<T: Scalar> {
    pub(super) area: Rectangle<T>,
    /// The places within reach in one slot (eq:traj1).
    pub(super) step: Disc<T>,
    /// The places from which the destination can be reached in the slots that remain (eq:traj2).
    pub(super) arrival: Disc<T>,
    /// [`rounding_m`] of the whole area.
    pub(super) rounding_m: T,
}

impl<T: Scalar> ReachableSet<T> {
    /// Creates the set for a step from `from` of at most `step_m` that ends at most `home_m` from
    /// `destination`. Distances are in metres and not negative.
    pub fn new(
        area: Area<T>,
        from: Position<T>,
        step_m: T,
        destination: Position<T>,
        home_m: T,
    ) -> Self {
        Self {
            area: Rectangle {
                south_west: Position::origin(),
                north_east: Position::new(area.east_m, area.north_m),
            },
            step: Disc {
                center: from,
                radius_m: step_m,
            },
            arrival: Disc {
                center: destination,
                radius_m: home_m,
            },
            rounding_m: rounding_m(&area, step_m),
        }
    }

    /// Returns `F_n` of a mission: slot `n` (1 to `N`) from `from`.
    pub fn of_slot<const M: usize, const J: usize>(
        mission: &Mission<T, M, J>,
        slot: u32,
        from: Position<T>,
    ) -> Self {
        let p = mission.parameters();
        let slots_left = mission.slots().saturating_sub(slot) + 1;
        Self::new(
            p.area,
            from,
            mission.reach_m(),
            p.destination,
            T::count(slots_left as usize) * mission.reach_m(),
        )
    }

    /// Returns `F_n` for a vehicle with inertia: as [`of_slot`](Self::of_slot), but from every
    /// waypoint in the set the vehicle can brake before the border of the area, and turn back to
    /// the destination in time.
    ///
    /// Towards a border, a step `s` must leave the distance that stopping from it takes: `s + s^2 /
    /// (2 gain) <= room`, after a slot that continues the last one's motion. On the way to the
    /// destination the same holds for the difference, as a vector, between the step and full speed
    /// straight to the destination: that difference is lost, and regaining it costs `s^2 / (2
    /// gain)` more, out of the distance that the remaining slots have to spare.
    ///
    /// The disc for the destination is therefore one around the place ahead on the way to the
    /// destination, within that of `F_n`; where it would need more distance than there is to spare
    /// it is that of `F_n`. No constraint is added around the destination where stopping stays
    /// within `V_max delta` of it: there the vehicle has arrived. The two discs intersect wherever
    /// those of `F_n` do. Where braking before a border excludes the intersection, the waypoint is
    /// straight towards the destination.
    pub fn of_slot_with<const M: usize, const J: usize>(
        mission: &Mission<T, M, J>,
        slot: u32,
        from: Position<T>,
        agility: &Agility<T>,
    ) -> Self {
        let mut set = Self::of_slot(mission, slot, from);
        if !agility.velocity_change_m.finite() && agility.reach_m >= mission.reach_m() {
            return set;
        }
        set.step.radius_m = agility.step_beside(
            set.arrival.center - from,
            mission.slots().saturating_sub(slot) + 1,
            mission.reach_m(),
        );
        let Rectangle {
            south_west,
            north_east,
        } = &mut set.area;
        let slots_after = mission.slots().saturating_sub(slot);
        // A vehicle that turns round also brakes along the border.
        let beside_border = Agility {
            velocity_change_m: agility.velocity_change_m * T::of(BORDER_BRAKING_FRACTION),
            ..*agility
        };
        for axis in 0..2 {
            let (low, high) = (south_west[axis], north_east[axis]);
            let margin_m = agility.reach_m * T::of(BORDER_FRACTION);
            let margin_m = margin_m.min((high - low) / T::of(4.0));
            let (low, high) = (low + margin_m, high - margin_m);
            let here = from[axis];
            // Outside already: back to the border and no further out.
            let inside = here.max(low).min(high);
            let drift_m = agility.drift_m[axis];
            let step_m = |last_m: T, room_m: T| {
                let last_m = last_m.max(T::zero());
                // Too late for normal braking: brake with more than can be relied on.
                let braked_m =
                    (last_m - beside_border.velocity_change_m * T::of(2.0)).max(T::zero());
                let allowed_m = beside_border.allowed_m(last_m, room_m).unwrap_or(braked_m);
                allowed_m.max(beside_border.ended_m(last_m, room_m, slots_after))
            };
            south_west[axis] = (inside - step_m(-drift_m, inside - low)).max(low);
            north_east[axis] = (inside + step_m(drift_m, high - inside)).min(high);
        }
        let arrival = set.arrival.center - from;
        let away_m = arrival.norm();
        let slots_left = T::count((mission.slots().saturating_sub(slot) + 1) as usize);
        let spare_m = (slots_left + T::of(ARRIVAL_FRACTION)) * agility.reach_m - away_m;
        let toward = arrival / away_m.max(set.rounding_m);
        let [east_m, north_m] = agility.drift_m;
        let last_short_m = (toward * agility.reach_m - Displacement::new(east_m, north_m)).norm();
        let short_m = agility.allowed_m(last_short_m, spare_m);
        let short_m = short_m.unwrap_or(T::zero());
        // From one side of the destination to the other is twice the radius.
        let arrived_m = agility.stoppable_m(mission.reach_m()) / T::of(2.0);
        let ahead_m = set.step.radius_m.min(away_m);
        if away_m - agility.reach_m + short_m <= arrived_m {
            set.arrival.radius_m = set.arrival.radius_m.min(arrived_m);
        } else if away_m - ahead_m + short_m <= set.arrival.radius_m {
            // Inside the disc of `F_n` around the destination.
            set.arrival = Disc {
                center: from + toward * ahead_m,
                radius_m: short_m,
            };
        }
        // The two discs must intersect, however short the step should be.
        let gap_m = (set.arrival.center - from).norm() - set.arrival.radius_m;
        set.step.radius_m = set.step.radius_m.max(gap_m.min(agility.step_m));
        set
    }

    /// Returns whether a place is in the set, up to half of [`rounding_m`].
    pub fn contains(&self, place: &Position<T>) -> bool {
        let slack = self.rounding_m / T::of(2.0);
        let inside = |disc: &Disc<T>| (place - disc.center).norm() <= disc.radius_m + slack;
        self.area.contains(place) && inside(&self.step) && inside(&self.arrival)
    }

    /// Returns the point of the set that is nearest to `wish`, or `None` if the set is empty.
    pub fn nearest(&self, wish: &Position<T>) -> Option<Position<T>> {
        let mut best: Option<(T, Position<T>)> = None;
        self.each_candidate(wish, |candidate| {
            // Corners are computed; the border of the area is kept exactly.
            let candidate = self.area.clamp(&candidate);
            let distance = (candidate - wish).norm_squared();
            if self.contains(&candidate) && best.is_none_or(|(least, _)| distance < least) {
                best = Some((distance, candidate));
            }
        });
        best.map(|(_, place)| place)
    }

    /// Visits every point that can be nearest to `wish`: itself, its projection on each border, and
    /// the corners where two borders meet.
    fn each_candidate(&self, wish: &Position<T>, mut visit: impl FnMut(Position<T>)) {
        let Rectangle {
            south_west,
            north_east,
        } = self.area;
        let (lines_x, lines_y) = ([south_west.x, north_east.x], [south_west.y, north_east.y]);
        visit(*wish);
        visit(self.area.clamp(wish));
        for disc in [&self.step, &self.arrival] {
            visit(disc.border_towards(wish));
            // Degenerate sets (a disc of radius 0, discs that touch) have their centres.
            visit(disc.center);
            for x in lines_x {
                disc.meet_line(0, x, &mut visit);
            }
            for y in lines_y {
                disc.meet_line(1, y, &mut visit);
            }
        }
        self.step.meet_disc(&self.arrival, &mut visit);
        for x in lines_x {
            for y in lines_y {
                visit(Position::new(x, y));
            }
        }
    }
}
