// SPDX-License-Identifier: MIT OR Apache-2.0
//! Changes of the order of service, each evaluated with its best path.
//!
//! Improving path and assignment in turn stops where each is best for the other. Here both change
//! together: two slots swap their users, or the user of one slot is moved to another time and those
//! in between shift. The best chain of places for the new order, within a stencil of 3 x 3 around
//! each waypoint, gives the value of the change.

use super::{
    memory::{PLACES, PathMut},
    place_rates::PlaceRates,
    polish::stencil_place,
    route::Route,
};
use crate::scalar::{Position, Scalar};

const SIDE: usize = 3;
/// The largest number of slots that a change may span.
pub(super) const SPAN: usize = 20;

/// The totals of the chains that end, or begin, at the places of a slot.
pub(super) type Totals<T> = [T; PLACES];

/// Returns the length of the table of one slot: rates per user and place, which places of the slot
/// before connect to which (0, or minus infinity), totals before and after.
pub(super) const fn row_len(users: usize) -> usize {
    users * PLACES + PLACES * PLACES + 2 * PLACES
}

/// A change of the order of service between two slots, the first one earlier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// The two slots swap their users.
    Swap,
    /// The first slot's user is served in the second slot, those in between one slot earlier.
    Later,
    /// The second slot's user is served in the first slot, those in between one slot later.
    Earlier,
}

impl Change {
    pub(super) const ALL: [Self; 3] = [Self::Swap, Self::Later, Self::Earlier];

    /// Returns the slot whose user is served in slot `index` once slots `a` to `b` are changed.
    fn source(self, a: usize, b: usize, index: usize) -> usize {
        match self {
            Self::Swap if index == a => b,
            Self::Swap if index == b => a,
            Self::Swap => index,
            Self::Later if index == b => a,
            Self::Later => index + 1,
            Self::Earlier if index == a => b,
            Self::Earlier => index - 1,
        }
    }

    /// Applies the change.
    pub(super) fn apply(self, users: &mut [u8], a: usize, b: usize) {
        let Some(between) = users.get_mut(a..=b) else {
            return;
        };
        match self {
            Self::Swap => {
                if let [first, .., last] = between {
                    core::mem::swap(first, last);
                }
            }
            _ if between.is_empty() => {}
            Self::Later => between.rotate_left(1),
            Self::Earlier => between.rotate_right(1),
        }
    }

    /// Returns whether the change alters anything.
    pub(super) fn alters(self, users: &[u8], a: usize, b: usize) -> bool {
        let user = |index: usize| users.get(index);
        match self {
            Self::Swap => user(a) != user(b),
            Self::Later => b > a + 1 && user(a) != user(a + 1),
            Self::Earlier => b > a + 1 && user(b) != user(b - 1),
        }
    }
}

/// The tables of all slots.
pub(super) struct Tables<'a, T> {
    pub(super) rows: &'a mut [T],
    pub(super) users: usize,
}

/// Returns the totals before the first slot: every chain begins at its first place.
fn beginning<T: Scalar>() -> Totals<T> {
    let mut totals = [T::of(f64::NEG_INFINITY); PLACES];
    if let Some(first) = totals.first_mut() {
        *first = T::zero();
    }
    totals
}

impl<T: Scalar> Tables<'_, T> {
    fn part(&self, slot: usize, start: usize, len: usize) -> &[T] {
        let start = slot * row_len(self.users) + start;
        self.rows.get(start..start + len).unwrap_or(&[])
    }

    fn part_mut(&mut self, slot: usize, start: usize, len: usize) -> &mut [T] {
        let start = slot * row_len(self.users) + start;
        self.rows.get_mut(start..start + len).unwrap_or(&mut [])
    }

    fn joined_at(&self) -> usize {
        self.users * PLACES
    }

    fn earned_at(&self) -> usize {
        self.joined_at() + PLACES * PLACES
    }

    fn ahead_at(&self) -> usize {
        self.earned_at() + PLACES
    }

    /// Returns the totals after slot `slot` from those before it, with `user` served. Worst case:
    /// 81 additions and comparisons.
    fn onward(&self, slot: usize, user: usize, before: &Totals<T>) -> Totals<T> {
        let mut after = [T::of(f64::NEG_INFINITY); PLACES];
        let joined = self.part(slot, self.joined_at(), PLACES * PLACES);
        let rates = self.part(slot, user * PLACES, PLACES);
        let rows = joined.chunks_exact(PLACES).zip(rates);
        for (after, (joined, &rate)) in after.iter_mut().zip(rows) {
            let mut best = T::of(f64::NEG_INFINITY);
            for (&join, &total) in joined.iter().zip(before) {
                let total = total + join;
                best = if total > best { total } else { best };
            }
            *after = best + rate;
        }
        after
    }

    /// Returns the totals before slot `slot`.
    pub(super) fn before(&self, slot: usize) -> Totals<T> {
        let mut totals = beginning();
        if let Some(previous) = slot.checked_sub(1) {
            let earned = self.part(previous, self.earned_at(), PLACES);
            for (total, &earned) in totals.iter_mut().zip(earned) {
                *total = earned;
            }
        }
        totals
    }

    /// Fills the table of slot `slot`, in ascending order of slots.
    pub(super) fn fill<const M: usize, const J: usize>(
        &mut self,
        route: &Route<T>,
        place_rates: &mut PlaceRates<'_, T, M, J>,
        path: &PathMut<'_, T>,
        slot: usize,
        spacing_m: T,
    ) {
        let (zero, never) = (T::zero(), T::of(f64::NEG_INFINITY));
        let place =
            |slot: usize, index: usize| stencil_place(&path.place(slot), index, SIDE, spacing_m);
        let (users, joined_at) = (self.users, self.joined_at());
        for index in 0..PLACES {
            let here = place(slot, index);
            let inside = route.area.contains(&here) && route.leads_home(&here, slot + 1);
            let row = self.part_mut(slot, 0, row_len(users));
            place_rates.each(&here, 0..users, |user, rate| {
                if let Some(entry) = row.get_mut(user * PLACES + index) {
                    *entry = rate;
                }
            });
            let joined = row.get_mut(joined_at + index * PLACES..).unwrap_or(&mut []);
            for (from, joined) in joined.iter_mut().enumerate().take(PLACES) {
                let before: Position<T> = match slot.checked_sub(1) {
                    Some(previous) => place(previous, from),
                    None => route.from,
                };
                *joined = if inside && route.joins(&before, &here) {
                    zero
                } else {
                    never
                };
            }
        }
        let earned = self.onward(slot, path.user(slot), &self.before(slot));
        let earned_at = self.earned_at();
        self.part_mut(slot, earned_at, PLACES)
            .copy_from_slice_checked(&earned);
    }

    /// Fills in the value of the rest of the mission after slot `slot`, in descending order.
    pub(super) fn fill_ahead(&mut self, route: &Route<T>, path: &PathMut<'_, T>, slot: usize) {
        let mut ahead = [T::zero(); PLACES];
        if slot + 1 < route.slots {
            ahead = [T::of(f64::NEG_INFINITY); PLACES];
            let next = slot + 1;
            let joined = self.part(next, self.joined_at(), PLACES * PLACES);
            let rates = self.part(next, path.user(next) * PLACES, PLACES);
            let onward = self.part(next, self.ahead_at(), PLACES);
            for (joined, (&rate, &onward)) in
                joined.chunks_exact(PLACES).zip(rates.iter().zip(onward))
            {
                for (ahead, &join) in ahead.iter_mut().zip(joined) {
                    let total = onward + rate + join;
                    *ahead = if total > *ahead { total } else { *ahead };
                }
            }
        }
        let ahead_at = self.ahead_at();
        self.part_mut(slot, ahead_at, PLACES)
            .copy_from_slice_checked(&ahead);
    }

    /// Returns the value of the mission with slots `a` to `b` changed: the best chain.
    pub(super) fn changed(&self, change: Change, users: &[u8], a: usize, b: usize) -> T {
        let mut totals = self.before(a);
        for slot in a..=b {
            let source = change.source(a, b, slot);
            let user = users.get(source).copied().unwrap_or(0).into();
            totals = self.onward(slot, user, &totals);
        }
        let mut best = T::of(f64::NEG_INFINITY);
        let ahead = self.part(b, self.ahead_at(), PLACES);
        for (&total, &ahead) in totals.iter().zip(ahead) {
            let total = total + ahead;
            best = if total > best { total } else { best };
        }
        best
    }

    /// Writes the totals after slot `slot` in the order of service of `path`, replacing older ones.
    pub(super) fn earn(&mut self, path: &PathMut<'_, T>, slot: usize) {
        let earned = self.onward(slot, path.user(slot), &self.before(slot));
        let earned_at = self.earned_at();
        self.part_mut(slot, earned_at, PLACES)
            .copy_from_slice_checked(&earned);
    }

    /// Moves the waypoints of `path` along the best chain, whose totals [`earn`](Self::earn)
    /// has written for all slots. Returns false if there is none.
    pub(super) fn trace(&self, route: &Route<T>, path: &mut PathMut<'_, T>, spacing_m: T) -> bool {
        let mut after = [T::zero(); PLACES];
        for slot in (0..route.slots).rev() {
            let earned = self.part(slot, self.earned_at(), PLACES);
            let mut best = (0, T::of(f64::NEG_INFINITY));
            for (index, (&earned, &join)) in earned.iter().zip(&after).enumerate() {
                if earned + join > best.1 {
                    best = (index, earned + join);
                }
            }
            if !best.1.finite() {
                return false;
            }
            let joined = self.part(slot, self.joined_at() + best.0 * PLACES, PLACES);
            for (after, &join) in after.iter_mut().zip(joined) {
                *after = join;
            }
            let place = stencil_place(&path.place(slot), best.0, SIDE, spacing_m);
            path.set_place(slot, place);
        }
        true
    }
}

/// A copy that is limited to the shorter of the two slices, so that it cannot fail.
trait CopyChecked<T> {
    fn copy_from_slice_checked(&mut self, from: &[T]);
}

impl<T: Copy> CopyChecked<T> for [T] {
    fn copy_from_slice_checked(&mut self, from: &[T]) {
        for (to, from) in self.iter_mut().zip(from) {
            *to = *from;
        }
    }
}
