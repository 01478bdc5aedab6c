// SPDX-License-Identifier: MIT OR Apache-2.0
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
/// area: if it brakes as late as possible, every inaccuracy of its flight takes it further out.
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
    /// Creates the set for a step from `from` of at most `step_m` that ends at most `arrival_m` from
    /// `destination`. Distances are in metres and not negative.
    pub fn new(
        area: Area<T>,
        from: Position<T>,
        step_m: T,
        destination: Position<T>,
        arrival_m: T,
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
                radius_m: arrival_m,
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
    /// (2 gain) <= available`, after a slot that continues the last one's motion. On the way to the
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
            let step_m = |last_m: T, available_m: T| {
                let last_m = last_m.max(T::zero());
                // Too late for normal braking: brake with more than can be relied on.
                let braked_m =
                    (last_m - beside_border.velocity_change_m * T::of(2.0)).max(T::zero());
                let allowed_m = beside_border
                    .allowed_m(last_m, available_m)
                    .unwrap_or(braked_m);
                allowed_m.max(beside_border.ended_m(last_m, available_m, slots_after))
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

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::test_missions::{table_one, table_one_parameters};

    /// The distance that a motion takes until it has ended: the slot that continues the last one,
    /// the next, and braking.
    fn taken_m(step_m: f64, last_m: f64, gain_m: f64) -> f64 {
        step_m.max(last_m) + step_m + step_m * step_m / (2.0 * gain_m)
    }

    fn equal(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-9 * (1.0 + b.abs())
    }

    /// Towards each border a step leaves the distance that stopping takes with 0.4 of the
    /// acceleration, up to 0.25 of `V_max delta` before the border. A vehicle that is too fast for
    /// that brakes with twice as much. Before the end of the mission only the slots left count.
    #[test]
    fn a_vehicle_can_brake_before_every_border() {
        let mission = table_one::<f64>();
        let mut random = Pcg64Mcg::seed_from_u64(41);
        let (mut stopping, mut braking, mut ending, mut free) = (0, 0, 0, 0);
        for _ in 0..4_000 {
            let mut along = |low: f64, high: f64| random.random_range(low..high);
            let from = Position::new(along(0.0, 1000.0), along(0.0, 1000.0));
            let agility = Agility {
                step_m: 29.0,
                reach_m: along(15.0, 30.0),
                velocity_change_m: along(0.0, 5.0).exp() / 3.0,
                drift_m: [along(-29.0, 29.0), along(-29.0, 29.0)],
            };
            let slot = random.random_range(1..=60);
            let set = ReachableSet::of_slot_with(&mission, slot, from, &agility);
            let gain_m = 0.4 * agility.velocity_change_m;
            let braking_agility = Agility {
                velocity_change_m: gain_m,
                ..agility
            };
            let margin_m = 0.25 * agility.reach_m;
            let (low_m, high_m) = (margin_m, 1000.0 - margin_m);
            for axis in 0..2 {
                let here_m = from[axis].clamp(low_m, high_m);
                let drift_m = agility.drift_m[axis];
                let (south_west_m, north_east_m) =
                    (set.area.south_west[axis], set.area.north_east[axis]);
                for (available_m, last_m, step_m) in [
                    (here_m - low_m, -drift_m, here_m - south_west_m),
                    (high_m - here_m, drift_m, north_east_m - here_m),
                ] {
                    let last_m = last_m.max(0.0);
                    assert!((-1e-9..=available_m + 1e-9).contains(&step_m), "{step_m}");
                    let ended_m = braking_agility.ended_m(last_m, available_m, 60 - slot);
                    if step_m >= available_m - 1e-9 {
                        // The border limits the step, or braking comes too late to matter.
                        free += 1;
                        let braked_m = (last_m - 2.0 * gain_m).max(ended_m);
                        assert!(
                            available_m <= braked_m + 1e-9 || available_m < 1e-6,
                            "{available_m}"
                        );
                    } else if ended_m > 0.0 && equal(step_m, ended_m) {
                        ending += 1;
                        assert!(
                            step_m > 0.0 && taken_m(step_m, last_m, gain_m) >= available_m - 1e-9
                        );
                    } else if step_m > 1e-9 && equal(taken_m(step_m, last_m, gain_m), available_m) {
                        stopping += 1;
                    } else {
                        braking += 1;
                        assert!(equal(step_m, (last_m - 2.0 * gain_m).max(0.0)), "{step_m}");
                        // No distance is left after this slot, or braking as assumed is too late.
                        let slowest_m = last_m - gain_m;
                        let too_late = taken_m(slowest_m, last_m, gain_m) > available_m - 1e-9;
                        assert!(available_m <= last_m + 1e-9 || too_late);
                    }
                }
            }
        }
        assert!(
            stopping > 5_000 && braking > 500 && ending > 100 && free > 50,
            "{stopping} {braking} {ending} {free}"
        );
    }

    /// In an area that is narrower than its margins half of it remains.
    #[test]
    fn a_strip_keeps_half_of_its_width() {
        let mut parameters = table_one_parameters::<f64>();
        parameters.area.north_m = 20.0;
        let inside = |place: &mut Position<f64>| place.y = place.y.min(20.0);
        parameters.users.iter_mut().for_each(inside);
        parameters.sensors.iter_mut().for_each(inside);
        parameters.start.y = 10.0;
        parameters.destination.y = 10.0;
        let mission = Mission::new(parameters).expect("valid");
        let agility = Agility {
            velocity_change_m: 1e6,
            ..Agility::ideal(&mission)
        };
        let at = |north_m: f64| {
            let from = Position::new(500.0, north_m);
            let area = ReachableSet::of_slot_with(&mission, 1, from, &agility).area;
            (area.south_west.y, area.north_east.y)
        };
        assert_eq!(at(0.0).0, 5.0);
        assert_eq!(at(20.0).1, 15.0);
    }

    /// What a step falls short of full speed towards the destination can be regained out of the
    /// distance to spare: that is the radius of the disc around the place ahead. Where the vehicle
    /// arrives in any case, the disc is the one in which it can stop; where there is nothing to
    /// spare, it is that of `F_n`.
    #[test]
    fn a_vehicle_can_turn_back_to_the_destination() {
        let mission = table_one::<f64>();
        let destination = mission.parameters().destination;
        let reach_m = mission.reach_m();
        let mut random = Pcg64Mcg::seed_from_u64(42);
        let (mut ahead, mut arrived, mut plain) = (0, 0, 0);
        for _ in 0..10_000 {
            let mut along = |low: f64, high: f64| random.random_range(low..high);
            let agility = Agility {
                step_m: along(20.0, 29.0),
                reach_m: along(15.0, 30.0),
                velocity_change_m: along(0.0, 5.0).exp() / 3.0,
                drift_m: [along(-29.0, 29.0), along(-29.0, 29.0)],
            };
            let angle = along(0.0, 1.5);
            let way = Displacement::new(angle.cos(), angle.sin());
            let slot = random.random_range(1..=60_u32);
            let slots_left = 61 - slot;
            let farthest_m = (f64::from(slots_left + 1) * reach_m).min(900.0);
            let away_m = farthest_m * random.random_range(0.01..1.0_f64);
            let from = destination - way * away_m;
            let set = ReachableSet::of_slot_with(&mission, slot, from, &agility);
            let ideal = ReachableSet::of_slot(&mission, slot, from);
            assert_eq!(ideal.arrival.radius_m, f64::from(slots_left) * reach_m);

            let spare_m = (f64::from(slots_left) + 0.3) * agility.reach_m - away_m;
            let [east_m, north_m] = agility.drift_m;
            let last_m = (way * agility.reach_m - Displacement::new(east_m, north_m)).norm();
            let short_m = agility.allowed_m(last_m, spare_m).unwrap_or(0.0);
            // `s + s^2 / (2 gain) = V_max delta`, from one side of the circle to the other.
            let root = (1.0 + 2.0 * reach_m / agility.velocity_change_m).sqrt();
            let stop_m = 2.0 * reach_m / (1.0 + root);
            let step_m = agility.step_beside(way * away_m, slots_left, reach_m);
            let gap_m = (set.arrival.center - from).norm() - set.arrival.radius_m;
            assert!(equal(
                set.step.radius_m,
                step_m.max(gap_m.min(agility.step_m))
            ));
            let ahead_m = step_m.min(away_m);
            let expected = if away_m - agility.reach_m + short_m <= stop_m / 2.0 {
                arrived += 1;
                Disc {
                    center: destination,
                    radius_m: ideal.arrival.radius_m.min(stop_m / 2.0),
                }
            } else if away_m - ahead_m + short_m <= ideal.arrival.radius_m {
                ahead += 1;
                Disc {
                    center: from + way * ahead_m,
                    radius_m: short_m,
                }
            } else {
                plain += 1;
                ideal.arrival
            };
            assert!((set.arrival.center - expected.center).norm() < 1e-9);
            assert!(equal(set.arrival.radius_m, expected.radius_m));
        }
        assert!(
            ahead > 1_000 && arrived > 100 && plain > 20,
            "{ahead} {arrived} {plain}"
        );
    }
}
