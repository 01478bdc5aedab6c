//! Rectangles of cells, and the cells of one slot that may still contain its waypoint.

use rayon::prelude::*;

/// The number of cells below which a computation is not divided among threads: handing over a
/// smaller piece takes longer than computing it.
pub(crate) const CELLS_PER_TASK: usize = 1 << 14;

/// Returns the number of rows that one task takes, for rows of `width` cells.
pub(crate) fn rows_per_task(width: usize) -> usize {
    CELLS_PER_TASK.div_ceil(width.max(1))
}

/// A rectangle of cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Window {
    pub(crate) column: i32,
    pub(crate) row: i32,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

impl Window {
    pub(crate) fn index(&self, column: i32, row: i32) -> Option<usize> {
        let (x, y) = (column - self.column, row - self.row);
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        inside.then(|| y as usize * self.width + x as usize)
    }

    /// Returns the smallest window that contains all of these. Empty windows do not count.
    pub(crate) fn hull(windows: impl Iterator<Item = Window>) -> Self {
        let (mut low, mut high) = ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN));
        for window in windows.filter(|window| window.cells() > 0) {
            low = (low.0.min(window.column), low.1.min(window.row));
            high = (
                high.0.max(window.column + window.width as i32),
                high.1.max(window.row + window.height as i32),
            );
        }
        if low.0 > high.0 {
            return Self::default();
        }
        Self {
            column: low.0,
            row: low.1,
            width: (high.0 - low.0) as usize,
            height: (high.1 - low.1) as usize,
        }
    }

    /// Returns the window's columns that are at most `half` away from `column`.
    pub(crate) fn columns_within(&self, column: i32, half: i32) -> std::ops::Range<i32> {
        let end = self.column + self.width as i32;
        (column - half).max(self.column)..(column + half + 1).min(end)
    }

    /// Returns the window over cells that were halved this many times.
    pub(crate) fn split(&self, halvings: usize) -> Self {
        Self {
            column: self.column << halvings,
            row: self.row << halvings,
            width: self.width << halvings,
            height: self.height << halvings,
        }
    }

    pub(crate) fn cells(&self) -> usize {
        self.width * self.height
    }

    /// Returns the column and row of an index.
    pub(crate) fn place(&self, index: usize) -> (i32, i32) {
        (
            self.column + (index % self.width) as i32,
            self.row + (index / self.width) as i32,
        )
    }
}

/// The cells of one slot.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    pub(crate) window: Window,
    pub(crate) alive: Vec<bool>,
}

impl Layer {
    /// Returns the cells of a window for which `keep` is true, in the smallest window that contains
    /// them.
    pub(crate) fn new(window: Window, keep: impl Fn(i32, i32) -> bool + Sync) -> Self {
        let alive = (0..window.cells())
            .into_par_iter()
            .with_min_len(CELLS_PER_TASK)
            .map(|index| {
                let (column, row) = window.place(index);
                keep(column, row)
            })
            .collect();
        Self { window, alive }.shrunk()
    }

    pub(crate) fn living(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.alive.len()).filter(|&index| self.alive[index])
    }

    pub(crate) fn shrunk(self) -> Self {
        let (mut low, mut high) = ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN));
        for index in self.living() {
            let (column, row) = self.window.place(index);
            low = (low.0.min(column), low.1.min(row));
            high = (high.0.max(column), high.1.max(row));
        }
        if low.0 > high.0 {
            return Self::default();
        }
        let window = Window {
            column: low.0,
            row: low.1,
            width: (high.0 - low.0 + 1) as usize,
            height: (high.1 - low.1 + 1) as usize,
        };
        if window == self.window {
            return self;
        }
        let mut alive = Vec::with_capacity(window.cells());
        for row in 0..window.height {
            let from = self
                .window
                .index(window.column, window.row + row as i32)
                .unwrap_or(0);
            alive.extend_from_slice(&self.alive[from..from + window.width]);
        }
        Self { window, alive }
    }
}
