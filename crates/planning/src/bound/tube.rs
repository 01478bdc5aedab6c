//! The cells that each slot may still end in, and the dynamic programme over them.
//!
//! A [`Tube`] holds one [`Layer`] per slot: a window of cells, each of which is alive or dropped. A
//! *pass* in either direction computes, for every live cell, the value of the best chain up to and
//! including that cell. A pass costs the number of cells times the number of rows of the disc of
//! moves ([`disc_maximum`]).

use rayon::prelude::*;

use super::{
    disc::disc_maximum,
    grid::Moves,
    window::{Layer, Window, rows_per_task},
};

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
            let window = layer.window.split(1);
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
        let rows = value
            .par_chunks_mut(self.window.width)
            .with_min_len(rows_per_task(self.window.width))
            .enumerate();
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

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

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
