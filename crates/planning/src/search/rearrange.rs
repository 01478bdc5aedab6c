//! Changes the order in which users are served and adapts the path at the same time.
//!
//! Improving path and assignment in turn stops where each is optimal for the other. Here both
//! change together: two slots swap their users, or one slot's user is moved to another time and the
//! users in between shift. The value of a change is that of the best chain of positions for the new
//! order, within a stencil around each waypoint.

use firmware_core::Position;
use rayon::prelude::*;

/// A change of the order of service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    /// Two slots swap their users.
    Swap(usize, usize),
    /// The first slot's user is served in the second slot, and those in between are served one slot
    /// earlier.
    Later(usize, usize),
    /// The second slot's user is served in the first slot, and those in between are served one slot
    /// later.
    Earlier(usize, usize),
}

impl Change {
    fn apply(self, users: &mut [usize]) {
        match self {
            Self::Swap(a, b) => users.swap(a, b),
            Self::Later(a, b) => users[a..=b].rotate_left(1),
            Self::Earlier(a, b) => users[a..=b].rotate_right(1),
        }
    }

    fn range(self) -> (usize, usize) {
        let (Self::Swap(a, b) | Self::Later(a, b) | Self::Earlier(a, b)) = self;
        (a, b)
    }
}

/// The candidate positions of every slot, the rate of each user there, and the positions that the
/// flight of a slot connects.
#[derive(Clone, Debug)]
pub(crate) struct CandidateGraph {
    pub(crate) places: Vec<Vec<Position<f64>>>,
    /// The rates, by slot, user and position.
    pub(crate) rates: Vec<Vec<Vec<f64>>>,
    /// For each slot and position, the reachable positions of the slot before, as bits. For the
    /// first slot, whether the start is connected to the position.
    pub(crate) predecessors: Vec<Vec<u128>>,
    /// The positions of the last slot from which the destination can be reached in one more slot.
    pub(crate) reaches_destination: Vec<bool>,
}

const UNREACHABLE: f64 = f64::NEG_INFINITY;

impl CandidateGraph {
    /// Computes the totals after a slot from those before it.
    fn advance_totals(&self, slot: usize, user: usize, before: &[f64], after: &mut Vec<f64>) {
        let rates = &self.rates[slot][user];
        after.clear();
        after.extend(
            self.predecessors[slot]
                .iter()
                .zip(rates)
                .map(|(&predecessors, rate)| {
                    let mut best = UNREACHABLE;
                    for (index, &total) in before.iter().enumerate() {
                        let total = if predecessors >> index & 1 == 1 {
                            total
                        } else {
                            UNREACHABLE
                        };
                        best = if total > best { total } else { best };
                    }
                    best + rate
                }),
        );
    }

    /// Returns two values for every position of every slot with this order of users: the value
    /// earned up to it, and the value that can still be earned after it.
    fn tables(&self, users: &[usize]) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
        let slots = users.len();
        let mut earned: Vec<Vec<f64>> = Vec::with_capacity(slots);
        for (slot, &user) in users.iter().enumerate() {
            let mut after = Vec::new();
            let before = earned.last().map_or(&[0.0][..], Vec::as_slice);
            self.advance_totals(slot, user, before, &mut after);
            earned.push(after);
        }
        let last = self.reaches_destination.iter().map(|&reaches_destination| {
            if reaches_destination {
                0.0
            } else {
                UNREACHABLE
            }
        });
        let mut ahead = vec![last.collect::<Vec<f64>>()];
        for slot in (1..slots).rev() {
            let next = &ahead[ahead.len() - 1];
            let mut here = vec![UNREACHABLE; self.places[slot - 1].len()];
            for (place, &predecessors) in self.predecessors[slot].iter().enumerate() {
                let total = next[place] + self.rates[slot][users[slot]][place];
                for (index, here) in here.iter_mut().enumerate() {
                    if predecessors >> index & 1 == 1 && total > *here {
                        *here = total;
                    }
                }
            }
            ahead.push(here);
        }
        ahead.reverse();
        (earned, ahead)
    }

    /// Returns the best chain of positions for an order of users, with its value.
    pub(crate) fn best_chain(&self, users: &[usize]) -> (f64, Vec<Position<f64>>) {
        let (earned, ahead) = self.tables(users);
        let slots = users.len();
        let mut path = Vec::with_capacity(slots);
        let first_best = |values: &mut dyn Iterator<Item = (usize, f64)>| {
            values.fold((0, UNREACHABLE), |best, (index, value)| {
                if value > best.1 { (index, value) } else { best }
            })
        };
        let mut through = (0..earned[slots - 1].len())
            .map(|index| (index, earned[slots - 1][index] + ahead[slots - 1][index]));
        let (mut index, value) = first_best(&mut through);
        for slot in (0..slots).rev() {
            path.push(self.places[slot][index]);
            if slot > 0 {
                let predecessors = self.predecessors[slot][index];
                let mut before = earned[slot - 1]
                    .iter()
                    .copied()
                    .enumerate()
                    .filter(|(index, _)| predecessors >> index & 1 == 1);
                index = first_best(&mut before).0;
            }
        }
        path.reverse();
        (value, path)
    }

    /// Returns the order of users, one change away, whose best chain has the largest value, or
    /// `None` if no value exceeds `least`. Changes span at most `span` slots.
    pub(crate) fn best_change(
        &self,
        users: &[usize],
        span: usize,
        least: f64,
    ) -> Option<Vec<usize>> {
        let (earned, ahead) = self.tables(users);
        let mut changes = Vec::new();
        for a in 0..users.len() {
            for b in a + 1..users.len().min(a + span + 1) {
                if users[a] != users[b] {
                    changes.push(Change::Swap(a, b));
                }
                if b > a + 1 {
                    if users[a] != users[a + 1] {
                        changes.push(Change::Later(a, b));
                    }
                    if users[b] != users[b - 1] {
                        changes.push(Change::Earlier(a, b));
                    }
                }
            }
        }
        let values: Vec<f64> = changes
            .par_iter()
            .map_init(
                || (users.to_vec(), Vec::new(), Vec::new()),
                |(order, before, after), &change| {
                    order.copy_from_slice(users);
                    change.apply(order);
                    let (a, b) = change.range();
                    before.clear();
                    match a.checked_sub(1) {
                        Some(previous) => before.extend_from_slice(&earned[previous]),
                        None => before.push(0.0),
                    }
                    for (slot, &user) in order.iter().enumerate().take(b + 1).skip(a) {
                        self.advance_totals(slot, user, before, after);
                        std::mem::swap(before, after);
                    }
                    let through = before.iter().zip(&ahead[b]).map(|(a, b)| a + b);
                    through.fold(UNREACHABLE, f64::max)
                },
            )
            .collect();
        let best = (0..changes.len()).fold(None, |best: Option<usize>, index| match best {
            Some(best) if values[best] >= values[index] => Some(best),
            _ => Some(index),
        })?;
        (values[best] > least).then(|| {
            let mut order = users.to_vec();
            changes[best].apply(&mut order);
            order
        })
    }
}
