//! The cells that each slot may still end in, and the dynamic programme over them.
//!
//! A [`Tube`] holds one [`Layer`] per slot: a window of cells, each of which is alive or dropped. A
//! *pass* in either direction computes, for every live cell, the value of the best chain up to and
//! including that cell. The best value within reach is a maximum over a disc of cells, computed row
//! by row: the maximum over a run of any length is that of two overlapping runs whose length is a
//! power of two. A pass therefore costs the number of cells times the number of rows of the disc.

use rayon::prelude::*;

use super::grid::Moves;

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
    fn columns_within(&self, column: i32, half: i32) -> std::ops::Range<i32> {
        let end = self.column + self.width as i32;
        (column - half).max(self.column)..(column + half + 1).min(end)
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

    fn shrunk(self) -> Self {
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

/// The live cells of every slot: `layers[n - 1]` for slot `n`.
#[derive(Clone, Debug)]
pub(crate) struct Tube {
    pub(crate) layers: Vec<Layer>,
}

/// The best value up to each cell, slot by slot, or minus infinity if the cell was dropped.
pub(crate) type Values = Vec<Vec<f32>>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    /// From the first slot onwards: the value earned so far.
    Forward,
    /// From the last slot backwards: the value that can still be earned.
    Backward,
}

/// The value of a slot in each cell, stored so that whole rows can be looked up.
#[derive(Clone, Debug)]
pub(crate) struct Worth {
    pub(crate) window: Window,
    pub(crate) value: Vec<f32>,
}

impl Tube {
    /// Returns the window that contains every layer.
    pub(crate) fn hull(&self) -> Window {
        Window::hull(self.layers.iter().map(|layer| layer.window))
    }

    /// Returns the number of pairs of slot and cell that are stored, live or dropped.
    pub(crate) fn stored(&self) -> usize {
        self.layers.iter().map(|layer| layer.window.cells()).sum()
    }

    /// Returns the best value from the first slot up to and including each cell.
    pub(crate) fn forward(&self, worth: &Worth, moves: &Moves) -> Values {
        self.pass(worth, moves, Direction::Forward)
    }

    /// Returns the best value from each cell, inclusive, to the last slot.
    pub(crate) fn backward(&self, worth: &Worth, moves: &Moves) -> Values {
        self.pass(worth, moves, Direction::Backward)
    }

    fn pass(&self, worth: &Worth, moves: &Moves, direction: Direction) -> Values {
        let slots = self.layers.len();
        let mut values: Values = vec![Vec::new(); slots];
        for step in 0..slots {
            let (slot, previous) = match direction {
                Direction::Forward => (step, step.checked_sub(1)),
                Direction::Backward => (slots - 1 - step, (step > 0).then(|| slots - step)),
            };
            let layer = &self.layers[slot];
            let mut value = match previous {
                Some(previous) => {
                    let from = &self.layers[previous].window;
                    disc_maximum(from, &values[previous], &layer.window, moves)
                }
                None => vec![0.0; layer.window.cells()],
            };
            layer.add_worth(worth, &mut value);
            values[slot] = value;
        }
        values
    }

    /// Returns a best chain: its live cell in each slot. `forward` must have been computed from
    /// this tube and these moves.
    pub(crate) fn best_chain(&self, forward: &Values, moves: &Moves) -> Option<Vec<(i32, i32)>> {
        let slots = self.layers.len();
        let mut chain = Vec::with_capacity(slots);
        let (value, mut index) = first_largest(forward.last()?.iter().copied().enumerate());
        if value == f32::NEG_INFINITY {
            return None;
        }
        for slot in (0..slots).rev() {
            let (column, row) = self.layers[slot].window.place(index);
            chain.push((column, row));
            if slot == 0 {
                break;
            }
            let (before, values) = (&self.layers[slot - 1].window, &forward[slot - 1]);
            // Only rows and columns of the window are searched, because a disc of moves may be much
            // larger.
            let rows = (before.row..).take(before.height);
            let reachable = rows.flat_map(|from_row| {
                let half = moves
                    .half_width
                    .get((from_row - row).unsigned_abs() as usize);
                let columns = half.map_or(0..0, |&half| before.columns_within(column, half));
                columns.filter_map(move |from_column| before.index(from_column, from_row))
            });
            index = first_largest(reachable.map(|index| (index, values[index]))).1;
        }
        chain.reverse();
        Some(chain)
    }

    /// Splits every live cell into four and keeps the children for which
    /// `inside(slot, column, row)` is true.
    pub(crate) fn split(&self, inside: impl Fn(usize, i32, i32) -> bool + Sync) -> Self {
        let layers = self.layers.par_iter().enumerate();
        let split = layers.map(|(slot, layer)| {
            let window = Window {
                column: 2 * layer.window.column,
                row: 2 * layer.window.row,
                width: 2 * layer.window.width,
                height: 2 * layer.window.height,
            };
            Layer::new(window, |column, row| {
                let parent = layer.window.index(column.div_euclid(2), row.div_euclid(2));
                parent.is_some_and(|parent| layer.alive[parent]) && inside(slot, column, row)
            })
        });
        Self {
            layers: split.collect(),
        }
    }

    /// Drops every cell whose best chain is worth less than `least`.
    pub(crate) fn prune(&mut self, worth: &Worth, forward: &Values, backward: &Values, least: f32) {
        self.layers
            .par_iter_mut()
            .enumerate()
            .for_each(|(slot, layer)| {
                let window = layer.window;
                for index in 0..window.cells() {
                    let (column, row) = window.place(index);
                    let own = worth.at(column, row);
                    let through = forward[slot][index] + (backward[slot][index] - own);
                    layer.alive[index] &= through >= least;
                }
                *layer = std::mem::take(layer).shrunk();
            });
    }
}

impl Layer {
    fn add_worth(&self, worth: &Worth, value: &mut [f32]) {
        if self.window.width == 0 {
            return;
        }
        let rows = value.par_chunks_mut(self.window.width).enumerate();
        rows.for_each(|(row, value)| {
            let alive = &self.alive[row * self.window.width..][..self.window.width];
            let start = worth
                .window
                .index(self.window.column, self.window.row + row as i32);
            let own = &worth.value[start.unwrap_or(0)..][..self.window.width];
            for ((value, &own), &alive) in value.iter_mut().zip(own).zip(alive) {
                *value = if alive {
                    *value + own
                } else {
                    f32::NEG_INFINITY
                };
            }
        });
    }
}

impl Worth {
    pub(crate) fn at(&self, column: i32, row: i32) -> f32 {
        self.window
            .index(column, row)
            .map_or(f32::NEG_INFINITY, |index| self.value[index])
    }
}

/// Returns the largest value with its index, and the first of them in a tie.
fn first_largest(values: impl Iterator<Item = (usize, f32)>) -> (f32, usize) {
    values.fold((f32::NEG_INFINITY, 0), |best, (index, value)| {
        if value > best.0 { (value, index) } else { best }
    })
}

/// Returns, for every cell of `to`, the largest value among the cells of `from` that a move
/// connects to it.
fn disc_maximum(from: &Window, values: &[f32], to: &Window, moves: &Moves) -> Vec<f32> {
    let mut result = vec![f32::NEG_INFINITY; to.cells()];
    if from.width == 0 || to.width == 0 {
        return result;
    }
    let runs = RunMaxima::new(from, values, to, moves.half_width[0]);
    result
        .par_chunks_mut(to.width)
        .enumerate()
        .for_each(|(row, result)| {
            let row = to.row + row as i32;
            for (dy, &half) in moves.half_width.iter().enumerate() {
                let dy = dy as i32;
                runs.take(row - dy, half, result);
                if dy > 0 {
                    runs.take(row + dy, half, result);
                }
            }
        });
    result
}

/// Maxima over runs of cells in a row whose lengths are powers of two.
struct RunMaxima {
    row: i32,
    rows: usize,
    /// The number of columns before the first one of the target, so that every run starts inside.
    margin: usize,
    /// The number of columns per row.
    width: usize,
    powers: usize,
    /// For each row and power of two, the maximum of the run that starts at a column.
    maxima: Vec<f32>,
}

impl RunMaxima {
    fn new(from: &Window, values: &[f32], to: &Window, widest: i32) -> Self {
        let margin = widest as usize;
        let powers = (2 * margin + 1).ilog2() as usize + 1;
        let width = to.width + 2 * margin;
        let mut maxima = vec![f32::NEG_INFINITY; from.height * powers * width];
        maxima
            .par_chunks_mut(powers * width)
            .zip(values.par_chunks(from.width))
            .for_each(|(maxima, values)| {
                // The offset of the source row within the padded row of the target.
                let shift = i64::from(from.column) - (i64::from(to.column) - margin as i64);
                for (column, &value) in values.iter().enumerate() {
                    let column = column as i64 + shift;
                    if column >= 0 && column < width as i64 {
                        maxima[column as usize] = value;
                    }
                }
                for power in 1..powers {
                    let half = 1 << (power - 1);
                    let (before, after) = maxima.split_at_mut(power * width);
                    let before = &before[(power - 1) * width..];
                    let pairs = before.iter().zip(&before[half..]);
                    for (after, (&a, &b)) in after.iter_mut().zip(pairs) {
                        *after = larger(a, b);
                    }
                }
            });
        Self {
            row: from.row,
            rows: from.height,
            margin,
            width,
            powers,
            maxima,
        }
    }

    /// Raises `result` to the maxima over the runs of `row` that extend `half` columns to either
    /// side.
    fn take(&self, row: i32, half: i32, result: &mut [f32]) {
        let row = row - self.row;
        if row < 0 || row as usize >= self.rows {
            return;
        }
        let half = half as usize;
        let length = 2 * half + 1;
        let power = length.ilog2() as usize;
        let maxima =
            &self.maxima[(row as usize * self.powers + power) * self.width..][..self.width];
        let first = self.margin - half;
        let second = self.margin + half + 1 - (1 << power);
        let (first, second) = (&maxima[first..], &maxima[second..]);
        for ((result, &a), &b) in result.iter_mut().zip(first).zip(second) {
            *result = larger(*result, larger(a, b));
        }
    }
}

/// Returns the larger number. Unlike `f32::max` it does not handle NaN, so it compiles to a single
/// instruction.
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// The row-by-row maximum equals the maximum over the disc, for windows at any position.
    #[test]
    fn disc_maximum_is_what_a_loop_over_the_disc_finds() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(6);
        for round in 0..200 {
            let moves = Moves::any(1.0, 1.0 / f64::from(rng.random_range(1..9)));
            let mut window = || Window {
                column: rng.random_range(0..20),
                row: rng.random_range(0..20),
                width: rng.random_range(1..25),
                height: rng.random_range(1..25),
            };
            let (from, to) = (window(), window());
            let values: Vec<f32> = (0..from.cells())
                .map(|_| {
                    if rng.random_bool(0.3) {
                        f32::NEG_INFINITY
                    } else {
                        rng.random_range(-1.0..1.0)
                    }
                })
                .collect();
            let fast = disc_maximum(&from, &values, &to, &moves);
            for (index, &fast) in fast.iter().enumerate() {
                let (column, row) = to.place(index);
                let slow = (0..from.cells()).filter(|&index| {
                    let (x, y) = from.place(index);
                    let half = moves.half_width.get((y - row).unsigned_abs() as usize);
                    half.is_some_and(|&half| (x - column).abs() <= half)
                });
                let slow = slow
                    .map(|index| values[index])
                    .fold(f32::NEG_INFINITY, f32::max);
                assert_eq!(fast, slow, "round {round} cell {index}");
            }
        }
    }

    /// Forward and backward passes agree: their sum at any cell of the best chain is the chain's
    /// value.
    #[test]
    fn passes_agree_on_the_best_chain() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(8);
        let window = Window {
            column: 0,
            row: 0,
            width: 12,
            height: 9,
        };
        let layers = (0..6).map(|_| Layer {
            window,
            alive: (0..window.cells()).map(|_| rng.random_bool(0.8)).collect(),
        });
        let mut tube = Tube {
            layers: layers.collect(),
        };
        let worth = Worth {
            window,
            value: (0..window.cells())
                .map(|_| rng.random_range(0.0..1.0))
                .collect(),
        };
        let moves = Moves::any(2.0, 1.0);
        let (forward, backward) = (tube.forward(&worth, &moves), tube.backward(&worth, &moves));
        let chain = tube.best_chain(&forward, &moves).expect("a chain");
        let value: f32 = chain
            .iter()
            .map(|&(column, row)| worth.at(column, row))
            .sum();
        let (best, _) = first_largest(forward[5].iter().copied().enumerate());
        assert!((value - best).abs() < 1e-5);
        for (slot, &(column, row)) in chain.iter().enumerate() {
            let index = window.index(column, row).expect("in the window");
            let through = forward[slot][index] + backward[slot][index] - worth.at(column, row);
            assert!((through - best).abs() < 1e-5);
        }
        // The dropped cells are exactly those from which the best value cannot be reached.
        tube.prune(&worth, &forward, &backward, best - 1e-5);
        for (layer, &(column, row)) in tube.layers.iter().zip(&chain) {
            assert!(
                layer
                    .window
                    .index(column, row)
                    .is_some_and(|index| layer.alive[index])
            );
        }
        assert!(tube.stored() < 6 * window.cells());
    }
}
