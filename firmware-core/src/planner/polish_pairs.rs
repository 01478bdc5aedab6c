// SPDX-License-Identifier: MIT OR Apache-2.0
//! Continuous improvement of a path for a vehicle with inertia, for a fixed order of service.
//!
//! As [`super::polish`], with a stencil of 3 x 3 places. A change of velocity depends on three places
//! in a row, so the dynamic programme runs over pairs of places.

use super::{
    inertia::Inertia,
    memory::{PLACES, PathMut},
    place_rates::PlaceRates,
    polish::stencil_place,
    route::Route,
};
use crate::scalar::{Position, Scalar};

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
        chains.before = [inertia.before(); PLACES];
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
                    let value = value - inertia.turn_loss(before, here, place);
                    if value > best.0 {
                        best = (value, first);
                    }
                }
                let late = inertia.late_loss(here, place, index + 1);
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
