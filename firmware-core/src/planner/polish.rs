// SPDX-License-Identifier: MIT OR Apache-2.0
//! Continuous improvement of a path for a fixed order of service.
//!
//! A stencil of 5 x 5 candidate places surrounds each waypoint; dynamic programming finds the best
//! feasible chain through them. The old path is among the candidates, so the path never gets worse.
//! A path stretched to the speed limit, on which no single waypoint can move, can still move as a
//! whole.

use super::{memory::PathMut, place_rates::PlaceRates, route::Route};
use crate::scalar::{Displacement, Position, Scalar};

const SIDE: usize = 5;
/// The number of candidate places of a waypoint.
pub(super) const PLACES: usize = SIDE * SIDE;

/// The best totals of the chains that end at the places of a slot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chains<T: Scalar> {
    totals: [T; PLACES],
    places: [Position<T>; PLACES],
}

impl<T: Scalar> Chains<T> {
    /// Returns the chain without a slot, at the vehicle.
    pub(super) fn start(route: &Route<T>) -> Self {
        let mut totals = [T::of(f64::NEG_INFINITY); PLACES];
        if let Some(first) = totals.first_mut() {
            *first = T::zero();
        }
        Self {
            totals,
            places: [route.from; PLACES],
        }
    }

    /// The operations of [`extend`](Self::extend) beside those of 25 place rates.
    pub(super) const OPERATIONS: u64 = (8 * PLACES * PLACES) as u64;

    /// Continues the chains through the stencil of slot `index`, with `spacing_m` between its
    /// places. `back` takes the predecessor of each place.
    pub(super) fn extend<const M: usize, const J: usize>(
        &mut self,
        route: &Route<T>,
        rates: &mut PlaceRates<'_, T, M, J>,
        path: &PathMut<'_, T>,
        (index, spacing_m): (usize, T),
        back: &mut [u8],
    ) {
        let user = path.user(index);
        let mut totals = [T::of(f64::NEG_INFINITY); PLACES];
        let mut places = [route.from; PLACES];
        for (candidate, (total, place)) in totals.iter_mut().zip(&mut places).enumerate() {
            *place = stencil_place(&path.place(index), candidate, SIDE, spacing_m);
            if !(route.area.contains(place) && route.leads_home(place, index + 1)) {
                continue;
            }
            let mut best = (T::of(f64::NEG_INFINITY), 0);
            for (before, (from, &value)) in self.places.iter().zip(&self.totals).enumerate() {
                if value > best.0 && route.joins(from, place) {
                    best = (value, before);
                }
            }
            if !best.0.finite() {
                continue;
            }
            *total = best.0 + rates.of_user(place, user);
            if let Some(back) = back.get_mut(index * PLACES + candidate) {
                *back = best.1 as u8;
            }
        }
        *self = Self { totals, places };
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
        let mut best = (0, T::of(f64::NEG_INFINITY));
        for (candidate, &total) in self.totals.iter().enumerate() {
            if total > best.1 {
                best = (candidate, total);
            }
        }
        if !best.1.finite() {
            return false;
        }
        let mut candidate = best.0;
        for index in (0..route.slots).rev() {
            let place = stencil_place(&path.place(index), candidate, SIDE, spacing_m);
            trial.set_place(index, place);
            let previous = back.get(index * PLACES + candidate).copied();
            candidate = previous.unwrap_or(0).into();
        }
        true
    }
}

/// Returns candidate `index` of a square stencil with `side` places a side (odd): the centre first,
/// so that it wins ties, then row by row.
pub(super) fn stencil_place<T: Scalar>(
    center: &Position<T>,
    index: usize,
    side: usize,
    spacing_m: T,
) -> Position<T> {
    let middle = side * side / 2;
    let index = match index {
        0 => return *center,
        index if index <= middle => index - 1,
        index => index,
    };
    let (column, row) = (index % side, index / side);
    let along = |count: usize| (T::count(count) - T::count(side / 2)) * spacing_m;
    center + Displacement::new(along(column), along(row))
}
