// SPDX-License-Identifier: MIT OR Apache-2.0
//! Paths for a vehicle with inertia: what they lose, and their continuous improvement for a fixed
//! order of service.
//!
//! A plan is still a path that keeps the speed limit. Where it turns faster than the vehicle can, or
//! leaves too little way to turn back to the destination, an estimate of the rate that is thereby lost
//! is subtracted from its value: paths that were made without regard to inertia become flyable step
//! by step. Improvement is as in [`super::polish`], with a stencil of 3 x 3 places. A change of
//! velocity depends on three places in a row, so the dynamic programme runs over pairs of places.

use super::{
    memory::{PLACES, PathMut},
    place_rates::PlaceRates,
    polish::stencil_place,
    route::Route,
};
use crate::{
    mission::Mission,
    scalar::{Displacement, Position, Scalar},
    shield::Agility,
};

/// The changes of velocity that cost nothing, in units of what the vehicle can do in a slot. The
/// guidance smooths the way between waypoints, so a vehicle turns faster if it is asked for more.
/// Of 1, 1.5, 2.5, 4 and 6, four was the best on random missions
/// (`host-sim benchmark --profile arducopter`).
const FREE_TURNS: f64 = 4.0;
/// The loss for turning by one more unit, in slots at the rate limit.
const TURN_LOSS: f64 = 2.0;
/// The loss for each `V_max delta` by which the way home is too short, in slots at the rate limit.
const LATE_LOSS: f64 = 0.3;
/// The fraction of `V_max delta` within which a vehicle with inertia is to arrive, as in the shield.
const ARRIVAL_FRACTION: f64 = 0.3;
/// The least change of velocity that is counted with, as a fraction of the longest step.
const LEAST_CHANGE: f64 = 0.01;

/// The inertia of a vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inertia<T: Scalar> {
    /// The place of the vehicle a slot ago.
    before: Position<T>,
    /// The largest change of velocity from slot to slot, metres a slot.
    change_m: T,
    /// The losses for a metre of [`bent_m`](Self::bent_m) and of [`late_m`](Self::late_m),
    /// bit/s/Hz.
    turn_loss: T,
    late_loss: T,
}

impl<T: Scalar> Inertia<T> {
    /// Returns the inertia of a vehicle that is at `from`, or `None` for the paper's kinematics.
    pub(super) fn of_vehicle<const M: usize, const J: usize>(
        mission: &Mission<T, M, J>,
        from: Position<T>,
        agility: &Agility<T>,
    ) -> Option<Self> {
        let change_m = agility.velocity_change_m;
        if !change_m.finite() {
            return None;
        }
        let change_m = change_m.max(agility.step_m * T::of(LEAST_CHANGE));
        let rate_limit = mission.slot_rate_limit();
        Some(Self {
            before: from - Displacement::from(agility.drift_m),
            change_m,
            turn_loss: rate_limit * T::of(TURN_LOSS) / change_m,
            late_loss: rate_limit * T::of(LATE_LOSS) / agility.step_m,
        })
    }

    /// Returns by how much the change of velocity at `here` exceeds what is free, metres a slot.
    fn bent_m(&self, before: &Position<T>, here: &Position<T>, next: &Position<T>) -> T {
        let change = (next - here) - (here - before);
        (change.norm() - self.change_m * T::of(FREE_TURNS)).max(T::zero())
    }

    /// Returns how much way is missing for the turn back to the destination after `done` slots, the
    /// last of which leads from `before` to `here`, metres. The way that the turn takes is that of
    /// [`crate::shield::ReachableSet::of_slot_with`].
    fn late_m(&self, route: &Route<T>, before: &Position<T>, here: &Position<T>, done: usize) -> T {
        let margin = T::of(ARRIVAL_FRACTION);
        let way = route.destination - here;
        let away_m = way.norm();
        let toward = way / away_m.max(route.step_m * T::of(1e-6));
        let short_m = (toward * route.step_m - (here - before)).norm();
        if away_m - route.step_m + short_m <= route.arrival_m * margin {
            return T::zero();
        }
        let left = T::count(route.slots.saturating_sub(done));
        let spare_m = (left + margin) * route.step_m - away_m;
        let turn_m = short_m * (T::of(2.0) + short_m / (self.change_m * T::of(2.0)));
        (turn_m - spare_m).max(T::zero())
    }

    /// Returns what a path loses, bit/s/Hz.
    pub(super) fn loss(&self, route: &Route<T>, path: &PathMut<'_, T>) -> T {
        let (mut before, mut here) = (self.before, route.from);
        let mut loss = T::zero();
        for index in 0..route.slots {
            let next = path.place(index);
            loss += self.bent_m(&before, &here, &next) * self.turn_loss
                + self.late_m(route, &here, &next, index + 1) * self.late_loss;
            (before, here) = (here, next);
        }
        loss
    }
}

const SIDE: usize = 3;
/// The number of pairs of places in two successive slots.
pub(super) const PAIRS: usize = PLACES * PLACES;

/// The best totals of the chains that end with each pair of places.
#[derive(Clone, Copy, Debug)]
pub(super) struct PairChains<T: Scalar> {
    /// By the place before the last, and the last place.
    totals: [[T; PLACES]; PLACES],
    before: [Position<T>; PLACES],
    places: [Position<T>; PLACES],
}

impl<T: Scalar> PairChains<T> {
    /// Returns no chain.
    pub(super) fn new(route: &Route<T>) -> Self {
        Self {
            totals: [[T::of(f64::NEG_INFINITY); PLACES]; PLACES],
            before: [route.from; PLACES],
            places: [route.from; PLACES],
        }
    }

    /// Returns the chain without a slot, at the vehicle.
    pub(super) fn start(route: &Route<T>, inertia: &Inertia<T>) -> Self {
        let mut chains = Self::new(route);
        chains.before = [inertia.before; PLACES];
        if let Some(first) = chains.totals.first_mut().and_then(|row| row.first_mut()) {
            *first = T::zero();
        }
        chains
    }

    /// The operations of [`extend`](Self::extend) beside those of 9 place rates.
    pub(super) const OPERATIONS: u64 = (10 * PAIRS * PLACES) as u64;

    /// Continues the chains through the stencil of slot `index`, with `spacing_m` between its
    /// places. `back` takes the predecessor of each pair.
    pub(super) fn extend<const M: usize, const J: usize>(
        &mut self,
        (route, inertia): (&Route<T>, &Inertia<T>),
        rates: &mut PlaceRates<'_, T, M, J>,
        path: &PathMut<'_, T>,
        (index, spacing_m): (usize, T),
        back: &mut [u8],
    ) {
        let user = path.user(index);
        let center = path.place(index);
        let mut totals = [[T::of(f64::NEG_INFINITY); PLACES]; PLACES];
        let mut places = [route.from; PLACES];
        for (candidate, place) in places.iter_mut().enumerate() {
            *place = stencil_place(&center, candidate, SIDE, spacing_m);
            if !(route.area.contains(place) && route.leads_home(place, index + 1)) {
                continue;
            }
            let rate = rates.of_user(place, user);
            for (middle, (here, row)) in self.places.iter().zip(&mut totals).enumerate() {
                if !route.joins(here, place) {
                    continue;
                }
                let mut best = (T::of(f64::NEG_INFINITY), 0);
                for (first, (before, row)) in self.before.iter().zip(&self.totals).enumerate() {
                    let value = row.get(middle).copied().unwrap_or(T::of(f64::NEG_INFINITY));
                    if value <= best.0 {
                        continue;
                    }
                    let value = value - inertia.turn_loss * inertia.bent_m(before, here, place);
                    if value > best.0 {
                        best = (value, first);
                    }
                }
                let late = inertia.late_m(route, here, place, index + 1) * inertia.late_loss;
                if let Some(total) = row.get_mut(candidate) {
                    *total = best.0 + rate - late;
                }
                if let Some(back) = back.get_mut(index * PAIRS + middle * PLACES + candidate) {
                    *back = best.1 as u8;
                }
            }
        }
        *self = Self {
            totals,
            before: self.places,
            places,
        };
    }

    /// Writes the best chain of all `route.slots` slots into `trial`, or returns false if no
    /// chain is feasible.
    pub(super) fn trace(
        &self,
        route: &Route<T>,
        spacing_m: T,
        path: &PathMut<'_, T>,
        back: &[u8],
        trial: &mut PathMut<'_, T>,
    ) -> bool {
        let mut best = ((0, 0), T::of(f64::NEG_INFINITY));
        for (middle, row) in self.totals.iter().enumerate() {
            for (candidate, &total) in row.iter().enumerate() {
                if total > best.1 {
                    best = ((middle, candidate), total);
                }
            }
        }
        if !best.1.finite() {
            return false;
        }
        let (mut middle, mut candidate) = best.0;
        for index in (0..route.slots).rev() {
            let place = stencil_place(&path.place(index), candidate, SIDE, spacing_m);
            trial.set_place(index, place);
            let first = back.get(index * PAIRS + middle * PLACES + candidate);
            (candidate, middle) = (middle, first.copied().unwrap_or(0).into());
        }
        true
    }
}
