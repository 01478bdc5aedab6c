// SPDX-License-Identifier: MIT OR Apache-2.0
//! The dynamic programme over (stage, node), and the path that follows its values.
//!
//! The slots that remain are divided into stages of equal length. During a stage the vehicle moves
//! in a straight line from one place to another, and each slot counts a mean of its values at the
//! two ends, weighted by where in the stage the slot ends. Going backward,
//!
//! ```text
//! U_s(b) = V_s(b) + sum_n f_n w_n(b)          V_{s-1}(a) = max_b U_s(b) + sum_n (1 - f_n) w_n(a)
//! ```
//!
//! where `f_n` in (0, 1] is the fraction of stage `s` at which its slot `n` ends, and `w_n` is the
//! value of the slot: the largest priced rate `max_m (R + lambda_m)`, or the rate of the user that
//! a given order of service has in the slot.

use core::num::NonZeroUsize;

use heapless::Vec;

use super::{
    lattice::{Lattice, MOVES_MAX, Move, unit},
    memory::{Parts, place, set_place},
    route::Route,
};
use crate::scalar::{Position, Scalar};

/// The number of directions of the forward pass.
const LOOKS: usize = 32;
/// Step lengths of the forward pass, as fractions of the longest.
const LOOK_FRACTIONS: [f64; 6] = [1.0, 0.75, 0.5, 0.25, 0.125, 0.0625];

/// The value of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Worth {
    /// The largest priced rate.
    Priced,
    /// The rate of the user that the current plan serves.
    Ordered,
}

/// The division of the rest of a mission into stages, the grid and the moves.
#[derive(Clone, Debug)]
pub(super) struct Stages<T: Scalar> {
    pub(super) lattice: Lattice<T>,
    moves: Vec<Move<T>, MOVES_MAX>,
    /// The number of stages.
    pub(super) count: NonZeroUsize,
    slots: NonZeroUsize,
    /// The longest distance in a stage, metres.
    step_m: T,
}

impl<T: Scalar> Stages<T> {
    /// Creates the stages for a route, with at most `nodes` nodes and `stages_max` stages.
    pub(super) fn new(route: &Route<T>, nodes: usize, stages_max: usize) -> Self {
        let (low, high) = route.extent();
        let lattice = Lattice::new(low, high, nodes, route.step_m * T::of(0.02));
        let mut stages = Self {
            lattice,
            moves: Vec::new(),
            count: NonZeroUsize::MIN,
            slots: at_least_one(route.slots),
            step_m: T::zero(),
        };
        stages.divide(route, stages_max);
        stages
    }

    /// Divides the same grid into another number of stages, at most as many as slots.
    pub(super) fn divide(&mut self, route: &Route<T>, stages_max: usize) {
        self.count = self.slots.min(at_least_one(stages_max));
        let slots_per_stage = T::count(self.slots.get()) / T::count(self.count.get());
        let step_m = route.step_m * slots_per_stage;
        // Points at that distance are connected in spite of rounding.
        self.step_m = step_m * (T::one() - T::EPSILON * T::of(8.0));
        self.moves = self.lattice.moves(self.step_m);
    }

    /// Returns the operations of one [`backward`](Self::backward).
    pub(super) fn backward_operations(&self) -> u64 {
        let per_stage = self.slots.get().div_ceil(self.count.get());
        (self.lattice.len() * (3 * self.moves.len() + 2 * per_stage)) as u64
    }

    /// Returns the operations of one [`forward`](Self::forward).
    pub(super) fn forward_operations(&self) -> u64 {
        (LOOKS * LOOK_FRACTIONS.len() * 40) as u64
    }

    /// Returns the slots (from 0) that end in stage `stage` (from 0), with the fraction of the
    /// stage at which each ends.
    fn slots_of(&self, stage: usize) -> impl Iterator<Item = (usize, T)> + use<T> {
        let (slots, count) = (self.slots.get(), self.count);
        let first = stage * slots / count;
        let end = (stage + 1) * slots / count;
        (first..end).map(move |slot| {
            let ended = (slot + 1) * count.get() - stage * slots;
            (slot, T::count(ended) / T::count(slots))
        })
    }

    /// Writes the values after the last stage: zero where the mission has arrived, negative
    /// elsewhere, in proportion to the distance.
    pub(super) fn finish(&self, route: &Route<T>, loss_per_m: T, value: &mut [T]) {
        for (index, value) in value.iter_mut().enumerate().take(self.lattice.len()) {
            let distance_m = (self.lattice.node(index) - route.destination).norm();
            *value = -loss_per_m * (distance_m - route.arrival_m).max(T::zero());
        }
    }

    /// Computes one stage backward: from the values after it to those before it. Keeps `U_s` as the
    /// layer of the stage. Worst case: `nodes (moves + slots per stage)` weighted sums.
    pub(super) fn backward(&self, worth: Worth, stage: usize, parts: &mut Parts<'_, T>) {
        let nodes = self.lattice.len();
        let Some(value) = parts.value.get_mut(..nodes) else {
            return;
        };
        let Some(layer) = parts.shared.get_mut(stage * nodes..(stage + 1) * nodes) else {
            return;
        };
        let earned = |values: &mut [T], part: fn(T) -> T| match worth {
            Worth::Priced => {
                let fractions = self.slots_of(stage).map(|(_, fraction)| part(fraction));
                let weight = fractions.fold(T::zero(), |sum, fraction| sum + fraction);
                add_weighted(values, parts.worth, weight);
            }
            Worth::Ordered => {
                for (slot, fraction) in self.slots_of(stage) {
                    let user = parts.current.user(slot);
                    let rates = parts.rates.get(user * nodes..(user + 1) * nodes);
                    add_weighted(values, rates.unwrap_or(&[]), part(fraction));
                }
            }
        };
        layer.copy_from_slice(value);
        earned(layer, |fraction| fraction);
        // The first move, staying, is always possible.
        value.copy_from_slice(layer);
        for way in self.moves.iter().skip(1) {
            self.lattice.improve(layer, way, value);
        }
        earned(value, |fraction| T::one() - fraction);
    }

    /// Computes one stage forward: writes point `stage + 1` of the path that follows the layers.
    pub(super) fn forward(&self, route: &Route<T>, stage: usize, parts: &mut Parts<'_, T>) {
        let nodes = self.lattice.len();
        if stage == 0 {
            set_place(parts.points, 0, route.from);
        }
        let here = place(parts.points, stage);
        let Some(layer) = parts.shared.get(stage * nodes..(stage + 1) * nodes) else {
            return;
        };
        let stages_left = T::count(self.count.get().saturating_sub(stage + 1));
        let home_m = stages_left * self.step_m + route.arrival_m;
        // Straight to the destination is always possible.
        let way = route.destination - here;
        let distance_m = way.norm();
        let straight = if distance_m > self.step_m {
            here + way * (self.step_m / distance_m)
        } else {
            route.destination
        };
        let mut best = (straight, self.lattice.value(layer, &straight));
        let mut look = |target: Position<T>| {
            if route.area.contains(&target) && (target - route.destination).norm() <= home_m {
                let value = self.lattice.value(layer, &target);
                if value > best.1 {
                    best = (target, value);
                }
            }
        };
        look(here);
        let longest_m = self.step_m.min(self.lattice.across_m());
        let least_m = self.lattice.spacing_m() * T::of(0.1);
        for direction in 0..LOOKS {
            let direction = unit::<T>(direction, LOOKS);
            for fraction in LOOK_FRACTIONS {
                let length_m = longest_m * T::of(fraction);
                if length_m >= least_m || fraction > 0.5 {
                    look(here + direction * length_m);
                }
            }
        }
        set_place(parts.points, stage + 1, route.inside(&best.0));
    }

    /// Returns the waypoint of slot `slot` (from 0) on the path through the points.
    pub(super) fn waypoint(&self, points: &[T], slot: usize) -> Position<T> {
        let ended = (slot + 1) * self.count.get();
        let (stage, beyond) = (ended / self.slots, ended % self.slots);
        let from = place(points, stage);
        if beyond == 0 {
            return from;
        }
        let to = place(points, stage + 1);
        from + (to - from) * (T::count(beyond) / T::count(self.slots.get()))
    }

    /// Returns the value of the whole rest of the mission from `position`, once all stages have
    /// been computed backward.
    pub(super) fn value(&self, parts: &Parts<'_, T>, position: &Position<T>) -> T {
        self.lattice.value(parts.value, position)
    }
}

fn add_weighted<T: Scalar>(values: &mut [T], terms: &[T], weight: T) {
    for (value, &term) in values.iter_mut().zip(terms) {
        *value += weight * term;
    }
}

fn at_least_one(count: usize) -> NonZeroUsize {
    NonZeroUsize::new(count).unwrap_or(NonZeroUsize::MIN)
}
