// SPDX-License-Identifier: MIT OR Apache-2.0
//! The planner's memory, which the caller provides.

use crate::{mission::Mission, scalar::Scalar};

/// Error returned when a planner cannot be created for a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PlannerError {
    /// The mission exceeds the capacity.
    #[error("the mission has {got} {what}, but the planner holds at most {capacity}")]
    TooLarge {
        /// `slots` or `users`.
        what: &'static str,
        /// How many the mission has.
        got: usize,
        /// The capacity of the planner.
        capacity: usize,
    },
    /// The memory is smaller than the capacity needs.
    #[error("the planner needs {needed} {what} of memory, but was given {got}")]
    TooLittleMemory {
        /// `numbers` or `bytes`.
        what: &'static str,
        /// How many the capacity needs.
        needed: usize,
        /// How many there are.
        got: usize,
    },
}

/// How large a mission may be, and how fine the planner works.
///
/// ```
/// use firmware_core::planner::Capacity;
///
/// // The default mission in single precision.
/// assert_eq!(Capacity::new(60, 15).memory_bytes::<f32>(), 113_820);
/// // Even 33 x 33 nodes with a stage for every two slots need less than 256 KiB.
/// let fine = Capacity { slots: 60, users: 16, nodes: 33 * 33, stages: 30 };
/// assert!(fine.memory_bytes::<f32>() < 256 * 1024);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capacity {
    /// The largest number of slots of a mission.
    pub slots: usize,
    /// The largest number of users.
    pub users: usize,
    /// The number of nodes of the grid, at least 4.
    pub nodes: usize,
    /// The number of stages of the dynamic programme, at least 1. The slots that remain are divided
    /// into this many stages of equal length, or into one per slot where that is fewer.
    pub stages: usize,
}

/// The number of candidate places of a waypoint while the order of service is changed: 3 x 3.
pub(super) const PLACES: usize = 9;

impl Capacity {
    /// Returns the usual capacity for a mission of `slots` slots and `users` users: 25 x 25 nodes
    /// and at most 24 stages. Finer grids and more stages were not better on random missions
    /// (`host-sim benchmark`): values are interpolated at every stage, which blurs them.
    pub const fn new(slots: usize, users: usize) -> Self {
        let stages = if slots > 24 { 24 } else { slots };
        Self {
            slots,
            users,
            nodes: 25 * 25,
            stages: if stages < 1 { 1 } else { stages },
        }
    }

    /// Checks whether a mission fits.
    ///
    /// # Errors
    /// Returns an error if the mission has more slots or users than the capacity.
    pub fn check<T: Scalar, const M: usize, const J: usize>(
        &self,
        mission: &Mission<T, M, J>,
    ) -> Result<(), PlannerError> {
        for (what, got, capacity) in [
            ("slots", mission.slots() as usize, self.slots),
            // Users are stored as bytes.
            ("users", mission.user_count(), self.users.min(256)),
        ] {
            if got > capacity {
                return Err(PlannerError::TooLarge {
                    what,
                    got,
                    capacity,
                });
            }
        }
        Ok(())
    }

    /// Returns how many numbers the planner needs.
    pub const fn values(&self) -> usize {
        let rates = (self.users + 2) * self.nodes;
        let points = 2 * (self.stages + 1);
        let paths = 3 * 2 * self.slots + self.slots * self.users;
        super::place_rates::GAIN_ENTRIES + rates + self.shared() + points + paths
    }

    /// Returns how many bytes the planner needs beside the numbers.
    pub const fn indices(&self) -> usize {
        3 * self.slots + self.slots * super::polish_pairs::PAIRS
    }

    /// Returns the whole size in bytes, for numbers of type `T`.
    pub const fn memory_bytes<T>(&self) -> usize {
        self.values() * core::mem::size_of::<T>() + self.indices()
    }

    /// Returns how many numbers the part has that the value layers and the tables of
    /// [`super::order`] share.
    const fn shared(&self) -> usize {
        let layers = self.stages * self.nodes;
        let tables = self.slots * super::order::row_len(self.users);
        if layers > tables { layers } else { tables }
    }
}

/// The memory of a planner: numbers and bytes, at least as many as [`Capacity::values`] and
/// [`Capacity::indices`] return. Implemented for pairs of anything that gives slices: arrays,
/// vectors, mutable references.
pub trait Memory<T> {
    /// Returns both parts.
    fn parts(&mut self) -> (&mut [T], &mut [u8]);
}

impl<T, A: AsMut<[T]>, B: AsMut<[u8]>> Memory<T> for (A, B) {
    fn parts(&mut self) -> (&mut [T], &mut [u8]) {
        (self.0.as_mut(), self.1.as_mut())
    }
}

/// A path and the users that are served on it.
pub(super) struct PathMut<'a, T> {
    /// East and north of every waypoint, metres.
    pub(super) places: &'a mut [T],
    /// The served user of every slot.
    pub(super) users: &'a mut [u8],
}

/// The memory, divided into its parts.
pub(super) struct Parts<'a, T> {
    /// The table of amplitude gains.
    pub(super) gains: &'a mut [T],
    /// Rates at the nodes: per user, per node.
    pub(super) rates: &'a mut [T],
    /// The largest priced rate of every node.
    pub(super) worth: &'a mut [T],
    /// The value of every node before a stage.
    pub(super) value: &'a mut [T],
    /// Value layers, or the tables of `order`.
    pub(super) shared: &'a mut [T],
    /// The path at the ends of the stages.
    pub(super) points: &'a mut [T],
    /// Rates along the trial path: per slot, per user.
    pub(super) slot_rates: &'a mut [T],
    /// The plan that is given out.
    pub(super) best: PathMut<'a, T>,
    /// The plan that is being improved.
    pub(super) current: PathMut<'a, T>,
    /// The plan that is being tried.
    pub(super) trial: PathMut<'a, T>,
    /// Back pointers of the polish.
    pub(super) back: &'a mut [u8],
}

/// Returns the next `count` entries, or as many as there are.
fn take<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let all = core::mem::take(rest);
    let (taken, left) = all.split_at_mut(count.min(all.len()));
    *rest = left;
    taken
}

impl<'a, T> Parts<'a, T> {
    pub(super) fn carve(
        capacity: &Capacity,
        (mut values, mut bytes): (&'a mut [T], &'a mut [u8]),
    ) -> Self {
        let (values, bytes) = (&mut values, &mut bytes);
        let c = capacity;
        let path = |values: &mut &'a mut [T], bytes: &mut &'a mut [u8]| PathMut {
            places: take(values, 2 * c.slots),
            users: take(bytes, c.slots),
        };
        Self {
            gains: take(values, super::place_rates::GAIN_ENTRIES),
            rates: take(values, c.users * c.nodes),
            worth: take(values, c.nodes),
            value: take(values, c.nodes),
            shared: take(values, c.shared()),
            points: take(values, 2 * (c.stages + 1)),
            slot_rates: take(values, c.slots * c.users),
            best: path(values, bytes),
            current: path(values, bytes),
            trial: path(values, bytes),
            back: take(bytes, c.slots * super::polish_pairs::PAIRS),
        }
    }
}

impl<T: crate::Scalar> PathMut<'_, T> {
    /// Returns waypoint `index`, or the origin where there is none.
    pub(super) fn place(&self, index: usize) -> crate::Position<T> {
        place(self.places, index)
    }

    /// Replaces waypoint `index`.
    pub(super) fn set_place(&mut self, index: usize, place: crate::Position<T>) {
        set_place(self.places, index, place);
    }

    /// Returns the served user of a slot.
    pub(super) fn user(&self, index: usize) -> usize {
        self.users.get(index).copied().unwrap_or(0).into()
    }

    /// Copies another path into this one.
    pub(super) fn copy_from(&mut self, other: &PathMut<'_, T>) {
        for (to, from) in self.places.iter_mut().zip(other.places.iter()) {
            *to = *from;
        }
        for (to, from) in self.users.iter_mut().zip(other.users.iter()) {
            *to = *from;
        }
    }

    /// Drops the first `count` slots.
    pub(super) fn drop_first(&mut self, count: usize) {
        if count <= self.users.len() && 2 * count <= self.places.len() {
            self.users.copy_within(count.., 0);
            self.places.copy_within(2 * count.., 0);
        }
    }
}

/// Returns place `index` of a list of east and north, or the origin where there is none.
pub(super) fn place<T: crate::Scalar>(places: &[T], index: usize) -> crate::Position<T> {
    match places.get(2 * index..2 * index + 2) {
        Some(&[east, north]) => crate::Position::new(east, north),
        _ => crate::Position::origin(),
    }
}

/// Replaces place `index` of a list of east and north.
pub(super) fn set_place<T: crate::Scalar>(
    places: &mut [T],
    index: usize,
    place: crate::Position<T>,
) {
    if let Some([east, north]) = places.get_mut(2 * index..2 * index + 2) {
        (*east, *north) = (place.x, place.y);
    }
}
