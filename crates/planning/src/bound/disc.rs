//! The largest value within reach of each cell: a maximum over a disc of cells.
//!
//! It is computed row by row. The maximum over a run of any length is that of two overlapping runs
//! whose length is a power of two, so a disc costs its number of rows per cell, and the loops
//! vectorize.

use rayon::prelude::*;

use super::{
    grid::Moves,
    window::{Window, rows_per_task},
};

/// Returns, for every cell of `to`, the largest value among the cells of `from` that a move
/// connects to it.
pub(crate) fn disc_maximum(from: &Window, values: &[f32], to: &Window, moves: &Moves) -> Vec<f32> {
    let mut result = vec![f32::NEG_INFINITY; to.cells()];
    if from.width == 0 || to.width == 0 {
        return result;
    }
    let runs = RunMaxima::new(from, values, to, moves.half_width[0]);
    result
        .par_chunks_mut(to.width)
        .with_min_len(rows_per_task(to.width))
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
            .with_min_len(rows_per_task(powers * width))
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
}
