// SPDX-License-Identifier: MIT OR Apache-2.0
//! The grid of nodes that the dynamic programme works on, and one step of it.
//!
//! The grid covers the places that a mission can still visit: the box around the ellipse whose
//! foci are the vehicle and the destination, cut to the area. A move goes from every node by the
//! same displacement; its value is interpolated between the four nodes around its end, with the
//! same four weights for all nodes. One step for one move is therefore a weighted sum of four
//! shifted arrays.

use heapless::Vec;

use crate::scalar::{Displacement, Position, Scalar};

/// The number of directions of the moves.
const DIRECTIONS: usize = 16;
/// The number of step lengths of the moves, each half of the one before.
const RINGS_MAX: usize = 5;
/// The largest number of moves: directions times step lengths, and staying.
pub(super) const MOVES_MAX: usize = DIRECTIONS * RINGS_MAX + 1;
/// The smallest number of columns and rows.
const SIDE_MIN: usize = 2;

/// A rectangular grid of nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice<T: Scalar> {
    south_west: Position<T>,
    spacing: Displacement<T>,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

/// A displacement in units of nodes: whole steps, and the fractions beyond them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Move<T> {
    columns: isize,
    rows: isize,
    east: T,
    north: T,
}

impl<T: Scalar> Lattice<T> {
    /// Creates a grid of at most `nodes` nodes (at least 4) over the box from `low` to `high`, with
    /// nodes no closer than `least_m`.
    pub(super) fn new(low: Position<T>, high: Position<T>, nodes: usize, least_m: T) -> Self {
        let extent = high - low;
        let least = T::of(1e-9);
        let wished = (T::count(nodes) * extent.x.max(least) / extent.y.max(least)).sqrt();
        let most = (nodes / SIDE_MIN).max(SIDE_MIN);
        let columns = wished.whole().clamp(SIDE_MIN, most);
        let rows = (nodes / columns).clamp(SIDE_MIN, most);
        let spacing = |extent: T, count: usize| (extent / T::count(count - 1)).max(least_m);
        Self {
            south_west: low,
            spacing: Displacement::new(spacing(extent.x, columns), spacing(extent.y, rows)),
            columns,
            rows,
        }
    }

    /// Returns the number of nodes.
    pub(super) fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Returns the position of a node, metres.
    pub(super) fn node(&self, index: usize) -> Position<T> {
        // There are at least `SIDE_MIN`.
        let columns = self.columns.max(SIDE_MIN);
        let (column, row) = (index % columns, index / columns);
        Position::new(
            self.south_west.x + self.spacing.x * T::count(column),
            self.south_west.y + self.spacing.y * T::count(row),
        )
    }

    /// Returns the moves of length `step_m` and its halves, down to half the spacing, and staying.
    pub(super) fn moves(&self, step_m: T) -> Vec<Move<T>, MOVES_MAX> {
        let mut moves = Vec::new();
        let mut add = |by: Displacement<T>| {
            let (columns, east) = split(by.x / self.spacing.x, self.columns);
            let (rows, north) = split(by.y / self.spacing.y, self.rows);
            // The capacity is that of all moves.
            let _ = moves.push(Move {
                columns,
                rows,
                east,
                north,
            });
        };
        add(Displacement::zeros());
        for ring in self.rings(step_m) {
            for direction in 0..DIRECTIONS {
                add(unit(direction, DIRECTIONS) * ring);
            }
        }
        moves
    }

    fn rings(&self, step_m: T) -> impl Iterator<Item = T> + use<T> {
        let least_m = self.spacing.x.min(self.spacing.y);
        let across_m = self.across_m();
        let half = T::of(0.5);
        let mut length_m = step_m;
        while length_m > across_m {
            length_m *= half;
        }
        (0..RINGS_MAX).map_while(move |ring| {
            let this_m = length_m;
            length_m *= half;
            (ring < 2 || this_m >= least_m * half).then_some(this_m)
        })
    }

    /// Returns the diagonal of the grid, metres.
    pub(super) fn across_m(&self) -> T {
        let east = self.spacing.x * T::count(self.columns - 1);
        let north = self.spacing.y * T::count(self.rows - 1);
        (east * east + north * north).sqrt()
    }

    /// Returns the larger spacing of nodes, metres.
    pub(super) fn spacing_m(&self) -> T {
        self.spacing.x.max(self.spacing.y)
    }

    /// Returns the interpolated value at a place; outside the grid the value of the nearest place
    /// in it.
    pub(super) fn value(&self, layer: &[T], place: &Position<T>) -> T {
        let locate = |value: T, spacing: T, count: usize| {
            let x = (value / spacing).max(T::zero());
            let index = x.whole().min(count - 2);
            (index, (x - T::count(index)).min(T::one()))
        };
        let offset = place - self.south_west;
        let (column, east) = locate(offset.x, self.spacing.x, self.columns);
        let (row, north) = locate(offset.y, self.spacing.y, self.rows);
        let south = row * self.columns + column;
        let along = |start: usize| match layer.get(start..start + 2) {
            Some(&[a, b]) => a + (b - a) * east,
            _ => T::zero(),
        };
        let (a, b) = (along(south), along(south + self.columns));
        a + (b - a) * north
    }

    /// Raises every entry of `to` to the value, in `from`, of the place that a move leads to. Moves
    /// that leave the grid are skipped.
    pub(super) fn improve(&self, from: &[T], way: &Move<T>, to: &mut [T]) {
        let (zero, one) = (T::zero(), T::one());
        let width = isize::from(way.east > zero);
        let height = isize::from(way.north > zero);
        let columns = range(way.columns, width, self.columns);
        let rows = range(way.rows, height, self.rows);
        if columns.is_empty() {
            return;
        }
        let count = columns.len();
        let weights = [
            (one - way.east) * (one - way.north),
            way.east * (one - way.north),
            (one - way.east) * way.north,
            way.east * way.north,
        ];
        for row in rows {
            let target_row = row.wrapping_add_signed(way.rows);
            let first = target_row * self.columns + columns.start.wrapping_add_signed(way.columns);
            let slice = |start: usize| from.get(start..start + count).unwrap_or(&[]);
            let start = row * self.columns + columns.start;
            let Some(to) = to.get_mut(start..start + count) else {
                return;
            };
            let (right, up) = (first + width as usize, height as usize * self.columns);
            if height == 0 {
                let pairs = slice(first).iter().zip(slice(right));
                for (to, (&a, &b)) in to.iter_mut().zip(pairs) {
                    let value = weights[0] * a + weights[1] * b;
                    *to = if value > *to { value } else { *to };
                }
                continue;
            }
            let south = slice(first).iter().zip(slice(right));
            let north = slice(first + up).iter().zip(slice(right + up));
            for (to, ((&a, &b), (&c, &d))) in to.iter_mut().zip(south.zip(north)) {
                let value = weights[0] * a + weights[1] * b + (weights[2] * c + weights[3] * d);
                *to = if value > *to { value } else { *to };
            }
        }
    }
}

/// Returns a unit vector: direction `index` of `count`.
pub(super) fn unit<T: Scalar>(index: usize, count: usize) -> Displacement<T> {
    let angle = T::two_pi() * T::count(index) / T::count(count);
    let (sine, cosine) = angle.sin_cos();
    Displacement::new(cosine, sine)
}

/// Splits a distance into whole steps and the fraction beyond them, clamped to a little more than
/// the grid.
fn split<T: Scalar>(nodes: T, count: usize) -> (isize, T) {
    let limit = T::count(2 * count);
    let held = nodes.max(-limit).min(limit);
    let below = held.floor();
    let fraction = held - below;
    let whole = if below < T::zero() {
        -((-below).whole() as isize)
    } else {
        below.whole() as isize
    };
    // A very small fraction of a node is rounding.
    if fraction < T::of(1e-6) {
        (whole, T::zero())
    } else if fraction > T::of(1.0 - 1e-6) {
        (whole + 1, T::zero())
    } else {
        (whole, fraction)
    }
}

/// Returns the indices from which a shift by `by` stays within `count`, with `extra` nodes beyond
/// it.
fn range(by: isize, extra: isize, count: usize) -> core::ops::Range<usize> {
    let count = count as isize;
    let start = (-by).min(count).max(0);
    let end = (count - by - extra).min(count).max(start);
    start as usize..end as usize
}
