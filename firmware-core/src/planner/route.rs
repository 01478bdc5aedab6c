// SPDX-License-Identifier: MIT OR Apache-2.0
//! The constraints that make a path feasible from the present state: speed, area and arrival
//! (eq:traj1, eq:traj2).

use super::{inertia::Inertia, memory::PathMut};
use crate::{
    mission::{Area, Mission, rounding_m},
    scalar::{Position, Scalar},
    shield::{Agility, ReachableSet},
};

/// The constraints on the rest of a mission.
#[derive(Clone, Copy, Debug)]
pub(super) struct Route<T: Scalar> {
    /// The position of the vehicle, or the nearest place in the area.
    pub(super) from: Position<T>,
    pub(super) destination: Position<T>,
    pub(super) area: Area<T>,
    /// The number of slots that remain, the coming one included.
    pub(super) slots: usize,
    /// The longest step of a plan, metres: the reach less the margin for rounding.
    pub(super) step_m: T,
    /// The longest step that counts as feasible: between `step_m` and the reach.
    longest_m: T,
    /// The largest distance from the destination at which a plan may end, metres.
    pub(super) arrival_m: T,
    /// The vehicle's inertia; none in the paper's kinematics.
    pub(super) inertia: Option<Inertia<T>>,
}

impl<T: Scalar> Route<T> {
    /// Creates the constraints for `slots` slots from `position`.
    pub(super) fn new<const M: usize, const J: usize>(
        mission: &Mission<T, M, J>,
        position: Position<T>,
        slots: usize,
        agility: &Agility<T>,
    ) -> Self {
        let p = mission.parameters();
        let reach_m = agility.step_m;
        let rounding = rounding_m(&p.area, reach_m);
        let least_m = reach_m * T::of(0.5);
        let from = p.area.nearest(&position);
        Self {
            from,
            inertia: Inertia::of_vehicle(mission, (from, slots), agility),
            destination: p.destination,
            area: p.area,
            slots,
            step_m: (reach_m - rounding * T::of(3.0)).max(least_m),
            longest_m: (reach_m - rounding * T::of(2.0)).max(least_m),
            arrival_m: (mission.reach_m() - rounding * T::of(2.0))
                .max(mission.reach_m() * T::of(0.5)),
        }
    }

    /// Returns whether the destination can be reached with the margins kept. Where it cannot, the
    /// only plan is the straight line.
    pub(super) fn has_choice(&self) -> bool {
        let limit_m = T::count(self.slots) * self.step_m + self.arrival_m;
        (self.destination - self.from).norm() <= limit_m && self.slots > 0
    }

    /// Returns whether a vehicle can fly from one place to the other in a slot.
    pub(super) fn joins(&self, from: &Position<T>, to: &Position<T>) -> bool {
        (to - from).norm_squared() <= self.longest_m * self.longest_m
    }

    /// Returns whether the destination can be reached after `done` slots that end at `place`.
    pub(super) fn leads_home(&self, place: &Position<T>, done: usize) -> bool {
        let left = self.slots.saturating_sub(done);
        let limit_m = T::count(left) * self.step_m + self.arrival_m;
        // The same tolerance as for a step.
        let slack_m = self.longest_m - self.step_m;
        (place - self.destination).norm() <= limit_m + slack_m
    }

    /// Returns waypoint `index` of the straight line to the destination at constant speed.
    pub(super) fn straight(&self, index: usize) -> Position<T> {
        let way = self.destination - self.from;
        let steps = T::count(index + 1);
        let distance_m = way.norm();
        let even = steps / T::count(self.slots.max(1));
        let fraction = if distance_m > T::zero() {
            even.min(steps * self.step_m / distance_m)
        } else {
            even
        };
        self.inside(&(self.from + way * fraction.min(T::one())))
    }

    /// Returns the nearest place in the area.
    pub(super) fn inside(&self, place: &Position<T>) -> Position<T> {
        Position::new(
            place.x.max(T::zero()).min(self.area.east_m),
            place.y.max(T::zero()).min(self.area.north_m),
        )
    }

    /// Replaces each waypoint that the vehicle cannot reach by the nearest point that it can reach.
    /// Returns the largest distance between a waypoint and its replacement, in metres. Worst case: 29
    /// candidates per waypoint.
    pub(super) fn anchor(&self, path: &mut PathMut<'_, T>) -> T {
        let mut from = self.from;
        let mut moved_m = T::zero();
        for index in 0..self.slots {
            let wish = self.inside(&path.place(index));
            let done = index + 1;
            if self.joins(&from, &wish) && self.leads_home(&wish, done) {
                from = wish;
            } else {
                let home_m = T::count(self.slots - done) * self.step_m + self.arrival_m;
                let set = ReachableSet::new(self.area, from, self.step_m, self.destination, home_m);
                from = set.nearest(&wish).unwrap_or_else(|| self.towards(&from));
                moved_m = moved_m.max((from - wish).norm());
            }
            path.set_place(index, from);
        }
        moved_m
    }

    /// Returns the end of one step straight to the destination.
    fn towards(&self, from: &Position<T>) -> Position<T> {
        let way = self.destination - from;
        let distance_m = way.norm();
        if distance_m <= self.step_m {
            return self.destination;
        }
        self.inside(&(from + way * (self.step_m / distance_m)))
    }

    /// Returns the box around all places that a mission can still visit: south-west and north-east
    /// corner.
    pub(super) fn extent(&self) -> (Position<T>, Position<T>) {
        let half = T::of(0.5);
        let way = self.destination - self.from;
        let distance_m = way.norm();
        let total_m = (T::count(self.slots) * self.step_m + self.arrival_m).max(distance_m);
        let middle = self.from + way * half;
        let (a, c) = (total_m * half, distance_m * half);
        let b_squared = (a * a - c * c).max(T::zero());
        let along = |component: T| {
            let cosine = if distance_m > T::zero() {
                component / distance_m
            } else {
                T::one()
            };
            let square = cosine * cosine;
            (a * a * square + b_squared * (T::one() - square).max(T::zero())).sqrt()
        };
        let (east_m, north_m) = (along(way.x), along(way.y));
        (
            self.inside(&Position::new(middle.x - east_m, middle.y - north_m)),
            self.inside(&Position::new(middle.x + east_m, middle.y + north_m)),
        )
    }
}
