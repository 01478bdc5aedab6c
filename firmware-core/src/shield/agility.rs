// SPDX-License-Identifier: MIT OR Apache-2.0
//! The capabilities of a vehicle with inertia, and the steps from which it can still stop.

use serde::{Deserialize, Serialize};

use crate::{
    mission::Mission,
    scalar::{Displacement, Scalar},
};

/// The fraction of `V_max delta` within which a vehicle with inertia is to arrive. If it turns back
/// as late as possible, every inaccuracy of its flight adds to the distance that remains.
pub(crate) const ARRIVAL_FRACTION: f64 = 0.3;

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

    /// Returns capabilities that a policy can rely on: steps of at most `V_max delta`. A step or
    /// change of velocity that is not above 0 counts as no limit of its own, a drift that is not
    /// finite as rest.
    #[cfg(feature = "policy")]
    pub(crate) fn sound<const M: usize, const J: usize>(&self, mission: &Mission<T, M, J>) -> Self {
        let ideal = Self::ideal(mission);
        // NaN is not above 0 either.
        let or = |value: T, otherwise: T| {
            if value > T::zero() {
                value.min(otherwise)
            } else {
                otherwise
            }
        };
        let velocity_change_m = or(self.velocity_change_m, ideal.velocity_change_m);
        let matters = velocity_change_m.finite() && self.drift_m.iter().all(|drift| drift.finite());
        Self {
            step_m: or(self.step_m, ideal.step_m),
            reach_m: or(self.reach_m, ideal.reach_m),
            velocity_change_m,
            drift_m: if matters { self.drift_m } else { ideal.drift_m },
        }
    }

    /// As [`allowed_m`](Self::allowed_m), where the mission ends before the vehicle would be at
    /// rest: after `slots_after` more slots, each of which may reduce the step by `gain`.
    pub(super) fn ended_m(&self, last_m: T, available_m: T, slots_after: u32) -> T {
        let slots = T::count(slots_after as usize);
        let braked_m =
            self.velocity_change_m * slots * (slots - T::one()).max(T::zero()) / T::of(2.0);
        // The next slot still covers the distance that this one ends with.
        let step_m = (available_m + braked_m) / (slots + T::one());
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
        let available_m = away_m + arrival_m * T::of(PASSING_FRACTION);
        let stoppable_m = self.largest_m(T::of(1.5), available_m);
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

    /// Returns the largest step `s` from which the vehicle can still come to rest within `available_m`:
    /// `s + s^2 / (2 gain) = available`.
    pub(super) fn stoppable_m(&self, available_m: T) -> T {
        self.largest_m(T::one(), available_m)
    }

    /// Returns the positive root of `times s + s^2 / (2 gain) = available`, in a form that also holds
    /// for an infinite gain; returns `available` itself where that is not above zero.
    pub(super) fn largest_m(&self, times: T, available_m: T) -> T {
        if available_m <= T::zero() {
            return available_m;
        }
        let two = T::of(2.0);
        two * available_m
            / (times + (times * times + two * available_m / self.velocity_change_m).sqrt())
    }

    /// Returns the largest step of the coming slot in a direction in which all remaining slots
    /// together may cover `available_m`, where the last slot covered `last_m`. The slot covers at least
    /// as much as the last one, and the next covers once more what it ends with; then the vehicle
    /// needs `s^2 / (2 gain)` to come to rest in that direction. Returns `None` where that takes
    /// more than the vehicle can lose in a slot.
    pub(super) fn allowed_m(&self, last_m: T, available_m: T) -> Option<T> {
        let turning_m = self.stoppable_m(available_m - last_m);
        if turning_m > last_m {
            return Some(self.largest_m(T::of(2.0), available_m));
        }
        (turning_m >= last_m - self.velocity_change_m).then(|| turning_m.max(T::zero()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vehicle(velocity_change_m: f64) -> Agility<f64> {
        Agility {
            step_m: 100.0,
            reach_m: 30.0,
            velocity_change_m,
            drift_m: [0.0; 2],
        }
    }

    fn equal(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-9 * (1.0 + b.abs())
    }

    /// All gains, available distances and last steps of a grid, to the border and past it.
    fn grid(mut visit: impl FnMut(f64, f64, f64)) {
        for gain_m in [0.3, 1.0, 4.0, 17.0, 250.0] {
            for available_m in [-5.0, 0.0, 0.2, 3.0, 11.0, 40.0, 333.0, 2000.0] {
                for last_m in [0.0, 0.1, 2.0, 9.0, 29.0] {
                    visit(gain_m, available_m, last_m);
                }
            }
        }
    }

    #[test]
    fn the_largest_step_takes_the_whole_distance() {
        grid(|gain_m, available_m, _| {
            for times in [1.0, 1.5, 2.0] {
                let step_m = vehicle(gain_m).largest_m(times, available_m);
                if available_m <= 0.0 {
                    assert_eq!(step_m, available_m);
                    continue;
                }
                assert!(step_m > 0.0);
                let taken_m = times * step_m + step_m * step_m / (2.0 * gain_m);
                assert!(equal(taken_m, available_m), "{taken_m} of {available_m}");
                let ideal_m = vehicle(f64::INFINITY).largest_m(times, available_m);
                assert!(equal(times * ideal_m, available_m));
            }
        });
    }

    /// The slot, the next one and the braking take the whole available distance. Nothing is allowed where they take
    /// more although the vehicle loses in the slot what it can.
    #[test]
    fn an_allowed_step_leaves_the_way_to_stop() {
        let (mut allowed, mut refused) = (0, 0);
        grid(|gain_m, available_m, last_m| {
            let taken_m =
                |step_m: f64| step_m.max(last_m) + step_m + step_m * step_m / (2.0 * gain_m);
            let slowest_m = last_m - gain_m;
            match vehicle(gain_m).allowed_m(last_m, available_m) {
                Some(step_m) => {
                    allowed += 1;
                    assert!(step_m >= slowest_m);
                    if step_m > 0.0 {
                        assert!(
                            equal(taken_m(step_m), available_m),
                            "{step_m} in {available_m}"
                        );
                    } else {
                        assert!(available_m <= last_m);
                    }
                }
                None => {
                    refused += 1;
                    let too_long = slowest_m > 0.0 && taken_m(slowest_m) > available_m;
                    let none_left = available_m - last_m < slowest_m;
                    assert!(too_long || none_left, "{slowest_m} in {available_m}");
                }
            }
        });
        assert!(allowed > 100 && refused > 20, "{allowed} {refused}");
    }

    /// Each of the remaining slots covers what the one before it ends with, and brakes: together
    /// they take the whole available distance. Zero where the vehicle would be at rest before the end, or cannot
    /// slow down to the step.
    #[test]
    fn the_end_of_the_mission_ends_the_way() {
        let (mut moving, mut zero) = (0, 0);
        grid(|gain_m, available_m, last_m| {
            for slots_after in 0..6_u32 {
                let covered_m = |step_m: f64| {
                    let later = (0..slots_after).map(|slot| step_m - gain_m * f64::from(slot));
                    step_m + later.sum::<f64>()
                };
                // It is linear in the step.
                let fixed_m = covered_m(0.0);
                let full_m = (available_m - fixed_m) / (covered_m(1.0) - fixed_m);
                let at_rest_before = full_m < gain_m * f64::from(slots_after);
                let step_m = vehicle(gain_m).ended_m(last_m, available_m, slots_after);
                if at_rest_before || last_m > full_m + gain_m {
                    zero += 1;
                    assert_eq!(step_m, 0.0);
                } else {
                    moving += 1;
                    assert!(equal(step_m, full_m), "{step_m} {full_m}");
                }
            }
        });
        assert!(moving > 200 && zero > 200, "{moving} {zero}");
        // At rest exactly at the end, and exactly slowed down to the step: 2 + 2 + 1 = 5.
        assert_eq!(vehicle(1.0).ended_m(3.0, 5.0, 2), 2.0);
        assert_eq!(vehicle(1.0).ended_m(3.1, 5.0, 2), 0.0);
    }

    /// The longest step is limited by stopping past the destination, and extended to what the
    /// slots left need and to the destination itself.
    #[test]
    fn a_step_stops_in_time_or_is_needed() {
        let step_m =
            |vehicle: Agility<f64>, east_m: f64, north_m: f64, slots_left: u32, arrival_m: f64| {
                vehicle.step_beside(Displacement::new(east_m, north_m), slots_left, arrival_m)
            };
        // 3/2 s + s^2 / 2 = 10 + 4 / 2.
        let stoppable_m = step_m(vehicle(1.0), 6.0, 8.0, 50, 4.0);
        let taken_m = 1.5 * stoppable_m + stoppable_m * stoppable_m / 2.0;
        assert!(equal(taken_m, 12.0), "{taken_m}");
        // (10 - 0.3 * 4) / 2.
        assert!(equal(step_m(vehicle(1.0), 6.0, 8.0, 2, 4.0), 4.4));
        // The destination is within its own circle.
        assert!(equal(step_m(vehicle(0.01), 1.8, 2.4, 50, 4.0), 3.0));
        assert!(equal(step_m(vehicle(0.01), 2.4, 3.2, 50, 4.0), 4.0));
        let short = Agility {
            step_m: 2.0,
            ..vehicle(1.0)
        };
        assert_eq!(step_m(short, 6.0, 8.0, 2, 4.0), 2.0);
    }
}
