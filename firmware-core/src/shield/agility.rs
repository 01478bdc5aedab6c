//! The capabilities of a vehicle with inertia, and the steps from which it can still stop.

use serde::{Deserialize, Serialize};

use crate::{
    mission::Mission,
    scalar::{Displacement, Scalar},
};

/// The fraction of `V_max delta` within which a vehicle with inertia is to arrive. If it turns back
/// as late as possible, every inaccuracy of its flight adds to the distance that remains.
pub(super) const ARRIVAL_FRACTION: f64 = 0.3;

/// The fraction of `V_max delta` past the destination within which a vehicle with inertia must be
/// able to stop.
const PASSING_FRACTION: f64 = 0.5;

/// The capabilities of a vehicle, where they are less than the mission's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Agility<T> {
    /// The longest step that is asked for, metres: `V_max delta` less a margin, so that no slot is
    /// flown further than `V_max delta`.
    pub step_m: T,
    /// The distance that the vehicle covers in a slot at the speed that it has shown it can hold,
    /// metres.
    pub reach_m: T,
    /// The largest change of velocity in a slot, metres a slot: acceleration times `delta^2`.
    /// Infinite for the paper's kinematics. Called `gain` in the formulas below.
    pub velocity_change_m: T,
    /// The displacement in the last slot, metres east and north. A slot passes before a change of
    /// velocity has an effect.
    pub drift_m: [T; 2],
}

impl<T: Scalar> Agility<T> {
    /// Returns the capabilities of the paper's kinematics: `V_max` in any direction at once.
    pub fn ideal<const M: usize, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        Self {
            step_m: mission.reach_m(),
            reach_m: mission.reach_m(),
            velocity_change_m: T::of(f64::INFINITY),
            drift_m: [T::zero(); 2],
        }
    }

    /// As [`allowed_m`](Self::allowed_m), where the mission ends before the vehicle would be at
    /// rest: after `slots_after` more slots, each of which may reduce the step by `gain`.
    pub(super) fn ended_m(&self, last_m: T, room_m: T, slots_after: u32) -> T {
        let slots = T::count(slots_after as usize);
        let braked_m =
            self.velocity_change_m * slots * (slots - T::one()).max(T::zero()) / T::of(2.0);
        // The next slot still covers the distance that this one ends with.
        let step_m = (room_m + braked_m) / (slots + T::one());
        let at_rest_before = step_m < self.velocity_change_m * slots;
        // A slot continues the last one's motion before it changes.
        if at_rest_before || last_m > step_m + self.velocity_change_m {
            T::zero()
        } else {
            step_m
        }
    }

    /// Returns the longest step that is asked for on the way to the destination, `way`, with
    /// `slots_left` slots left, this one included. From no such step would the vehicle fly past the
    /// destination and out of the circle of `V_max delta = arrival_m` around it, as far as the
    /// distance to the destination leaves a choice. A step `s` continues for half a slot before
    /// braking has an effect: `3/2 s + s^2 / (2 gain)`.
    pub(super) fn step_beside(&self, way: Displacement<T>, slots_left: u32, arrival_m: T) -> T {
        let away_m = way.norm();
        let room_m = away_m + arrival_m * T::of(PASSING_FRACTION);
        let stoppable_m = self.largest_m(T::of(1.5), room_m);
        let needed_m =
            (away_m - arrival_m * T::of(ARRIVAL_FRACTION)) / T::count(slots_left as usize);
        // A step to the destination itself is never too long.
        let there_m = if away_m <= arrival_m {
            away_m
        } else {
            T::zero()
        };
        self.step_m.min(stoppable_m.max(needed_m).max(there_m))
    }

    /// Returns the largest step `s` from which the vehicle can still come to rest within `room_m`:
    /// `s + s^2 / (2 gain) = room`.
    pub(super) fn stoppable_m(&self, room_m: T) -> T {
        self.largest_m(T::one(), room_m)
    }

    /// Returns the positive root of `times s + s^2 / (2 gain) = room`, in a form that also holds
    /// for an infinite gain; returns `room` itself where that is not above zero.
    pub(super) fn largest_m(&self, times: T, room_m: T) -> T {
        if room_m <= T::zero() {
            return room_m;
        }
        let two = T::of(2.0);
        two * room_m / (times + (times * times + two * room_m / self.velocity_change_m).sqrt())
    }

    /// Returns the largest step of the coming slot in a direction in which all remaining slots
    /// together may cover `room_m`, where the last slot covered `last_m`. The slot covers at least
    /// as much as the last one, and the next covers once more what it ends with; then the vehicle
    /// needs `s^2 / (2 gain)` to come to rest in that direction. Returns `None` where that takes
    /// more than the vehicle can lose in a slot.
    pub(super) fn allowed_m(&self, last_m: T, room_m: T) -> Option<T> {
        let turning_m = self.stoppable_m(room_m - last_m);
        if turning_m > last_m {
            return Some(self.largest_m(T::of(2.0), room_m));
        }
        (turning_m >= last_m - self.velocity_change_m).then(|| turning_m.max(T::zero()))
    }
}
