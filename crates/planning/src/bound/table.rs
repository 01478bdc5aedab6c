//! The rate bounds of the cells of one size, shared by all leaves.

use firmware_core::inner::Workspace;
use rayon::prelude::*;

use super::{
    grid::Grid,
    rates::RateBound,
    tube::Tube,
    window::{CELLS_PER_TASK, Window},
};

/// The rate bounds of cells of one size: `users` numbers per cell, computed when a leaf first needs
/// the cell.
#[derive(Clone, Debug)]
pub(crate) struct RateTable {
    hull: Window,
    /// The number of each cell of the hull among those computed, or [`UNKNOWN`].
    number: Vec<u32>,
    /// The bounds, cell by cell and user by user.
    rates: Vec<f32>,
    users: usize,
}

const UNKNOWN: u32 = u32::MAX;

/// A cell that is alive in some slot of a leaf.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LiveCell {
    /// The index in the hull of the leaf.
    pub(crate) index: u32,
    /// The number of the cell in the [`RateTable`].
    number: u32,
}

impl RateTable {
    /// Returns an empty table for cells of a window. Cells outside it cannot be entered.
    pub(crate) fn new(hull: Window, users: usize) -> Self {
        Self {
            hull,
            number: vec![UNKNOWN; hull.cells()],
            rates: Vec::new(),
            users,
        }
    }

    /// Computes the bounds of the cells of `tube` that are not known yet. Returns how many.
    pub(crate) fn extend<const M: usize, const J: usize>(
        &mut self,
        bound: &RateBound<'_, M, J>,
        grid: &Grid,
        tube: &Tube,
    ) -> usize {
        let mut cells: Vec<(i32, i32)> = Vec::new();
        let known = self.rates.len() / self.users;
        for layer in &tube.layers {
            for index in layer.living() {
                let (column, row) = layer.window.place(index);
                if let Some(index) = self.hull.index(column, row)
                    && self.number[index] == UNKNOWN
                {
                    self.number[index] = (known + cells.len()) as u32;
                    cells.push((column, row));
                }
            }
        }
        self.rates.resize((known + cells.len()) * self.users, 0.0);
        self.rates[known * self.users..]
            .par_chunks_mut(self.users)
            .zip(&cells)
            .with_min_len(64)
            .for_each_init(Workspace::default, |workspace, (rates, &(column, row))| {
                bound.over(&grid.cell(column, row), workspace, rates);
            });
        cells.len()
    }

    /// Returns the bounds of a cell.
    pub(crate) fn of_cell(&self, column: i32, row: i32) -> Option<&[f32]> {
        let number = self.number[self.hull.index(column, row)?];
        (number != UNKNOWN).then(|| self.of_number(number))
    }

    fn of_number(&self, number: u32) -> &[f32] {
        &self.rates[number as usize * self.users..][..self.users]
    }

    /// Returns the cells of `hull` that are alive in some slot of `tube`.
    pub(crate) fn live_cells(&self, hull: &Window, tube: &Tube) -> Vec<LiveCell> {
        let mut alive = vec![false; hull.cells()];
        for layer in &tube.layers {
            let (width, window) = (layer.window.width, layer.window);
            for row in 0..window.height {
                let start = hull.index(window.column, window.row + row as i32);
                let hull_row = &mut alive[start.unwrap_or(0)..][..width];
                let own = &layer.alive[row * width..][..width];
                for (alive, own) in hull_row.iter_mut().zip(own) {
                    *alive |= own;
                }
            }
        }
        let live = (0..alive.len()).filter(|&index| alive[index]);
        let numbered = live.map(|index| {
            let (column, row) = hull.place(index);
            let number = self.hull.index(column, row);
            LiveCell {
                index: index as u32,
                number: number.map_or(UNKNOWN, |index| self.number[index]),
            }
        });
        numbered.collect()
    }

    /// Returns the value of each of these cells at the given prices: the largest rate plus price.
    /// That of a cell that was not entered is infinite, so a bound never misses a cell.
    pub(crate) fn worth(&self, cells: &[LiveCell], prices: &[f32]) -> Vec<f32> {
        let worth = cells.par_iter().with_min_len(CELLS_PER_TASK / 8);
        let worth = worth.map(|cell| {
            if cell.number == UNKNOWN {
                return f32::INFINITY;
            }
            let rates = self.of_number(cell.number);
            let user = best_user(rates, prices);
            rates[user] + prices[user]
        });
        worth.collect()
    }
}

/// Returns the user with the largest rate plus price, and the first of them in a tie.
pub(crate) fn best_user(rates: &[f32], prices: &[f32]) -> usize {
    let priced = |user: usize| rates[user] + prices[user];
    (1..rates.len()).fold(0, |best, user| {
        if priced(user) > priced(best) {
            user
        } else {
            best
        }
    })
}
