//! Drops cells that the vehicle cannot reach from the cells of another slot, or not in time.
//!
//! Moves between cells are longer than admissible displacements by up to the diagonal of a cell,
//! and a chain may gain that much in every slot. From one slot to any other, however, the vehicle
//! gets no further than the number of slots times `V_max delta`. Let `h_n(e)` be the furthest that
//! a point of the live cells of slot `n` lies in the direction of the unit vector `e`. A waypoint
//! of slot `n` lies no further in that direction than `h_s(e) + |n - s| V_max delta`, for every
//! slot `s`. Cells that lie beyond it with all their points are dropped.

use nalgebra::Vector2 as Vector;
use rayon::prelude::*;

use super::{grid::Grid, tube::Tube};

/// The number of directions. The more there are, the less a disc differs from its polygon: with 24,
/// by less than 1 % of its radius.
const DIRECTIONS: usize = 24;

/// The least number of slots that one task takes.
const SLOTS_PER_TASK: usize = 4;

/// Drops the cells of `tube` that no admissible mission through its other cells can reach.
pub(crate) fn drop_unreachable(tube: &mut Tube, grid: &Grid, reach_m: f64) {
    let slots = tube.layers.len();
    let directions: [Vector<f64>; DIRECTIONS] = std::array::from_fn(|index| {
        let turn = std::f64::consts::TAU * index as f64 / DIRECTIONS as f64;
        Vector::new(turn.cos(), turn.sin())
    });
    // The furthest that a point of a cell lies beyond its south-west corner, and the least.
    let side_m = grid.side_m;
    let beyond = directions.map(|e| side_m * (e.x.max(0.0) + e.y.max(0.0)));
    let before = directions.map(|e| side_m * (e.x.min(0.0) + e.y.min(0.0)));
    let furthest = tube
        .layers
        .par_iter()
        .with_min_len(SLOTS_PER_TASK)
        .map(|layer| {
            let mut furthest = [f64::NEG_INFINITY; DIRECTIONS];
            // Only the outermost live cells of a row can be the furthest.
            for row in 0..layer.window.height {
                let alive = &layer.alive[row * layer.window.width..][..layer.window.width];
                let first = alive.iter().position(|&alive| alive);
                let last = alive.iter().rposition(|&alive| alive);
                for column in first.into_iter().chain(last) {
                    let index = row * layer.window.width + column;
                    let corner = corner(layer.window.place(index), side_m);
                    for (furthest, (e, beyond)) in
                        furthest.iter_mut().zip(directions.iter().zip(&beyond))
                    {
                        *furthest = furthest.max(e.dot(&corner) + beyond);
                    }
                }
            }
            furthest
        });
    let mut limit: Vec<[f64; DIRECTIONS]> = furthest.collect();
    let reach_m = reach_m * (1.0 + 1e-12);
    for slot in 1..slots {
        limit[slot] = nearer(&limit[slot], &limit[slot - 1], reach_m);
    }
    for slot in (1..slots).rev() {
        limit[slot - 1] = nearer(&limit[slot - 1], &limit[slot], reach_m);
    }
    let layers = tube.layers.par_iter_mut().with_min_len(SLOTS_PER_TASK);
    layers.zip(&limit).for_each(|(layer, limit)| {
        let slack_m = 1e-9 * (1.0 + side_m);
        let mut dropped = false;
        for index in 0..layer.alive.len() {
            if !layer.alive[index] {
                continue;
            }
            let corner = corner(layer.window.place(index), side_m);
            let lies_beyond = (0..DIRECTIONS)
                .any(|e| directions[e].dot(&corner) + before[e] > limit[e] + slack_m);
            if lies_beyond {
                layer.alive[index] = false;
                dropped = true;
            }
        }
        if dropped {
            *layer = std::mem::take(layer).shrunk();
        }
    });
}

fn corner((column, row): (i32, i32), side_m: f64) -> Vector<f64> {
    Vector::new(f64::from(column), f64::from(row)) * side_m
}

/// Returns the limits of a slot, given those of a slot next to it.
fn nearer(own: &[f64; DIRECTIONS], next: &[f64; DIRECTIONS], reach_m: f64) -> [f64; DIRECTIONS] {
    std::array::from_fn(|index| own[index].min(next[index] + reach_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bound::window::{Layer, Window};
    use firmware_core::mission::Area;
    use rand::{RngExt, SeedableRng};

    /// A mission whose waypoints lie in live cells keeps all its cells, whatever else is dropped.
    #[test]
    fn no_cell_of_an_admissible_path_is_dropped() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(12);
        let (mut before, mut after) = (0, 0);
        for _ in 0..200 {
            let side_m = [2.0, 5.0, 11.0][rng.random_range(0..3)];
            let reach_m = rng.random_range(3.0..20.0);
            let area = Area {
                east_m: 100.0,
                north_m: 70.0,
            };
            let grid = Grid::new(area, side_m);
            let window = Window {
                column: 0,
                row: 0,
                width: grid.columns as usize,
                height: grid.rows as usize,
            };
            let mut place = Vector::new(rng.random_range(0.0..100.0), rng.random_range(0.0..70.0));
            let mut cells = Vec::new();
            let layers = (0..12).map(|_| {
                // Steps of full length in one direction are the hardest to keep.
                let turn = [0.3, 0.3, rng.random_range(0.0..6.3)][rng.random_range(0..3)];
                let length_m = reach_m * [1.0, rng.random_range(0.0..1.0)][rng.random_range(0..2)];
                let to = place + Vector::new(f64::cos(turn), f64::sin(turn)) * length_m;
                if (0.0..100.0).contains(&to.x) && (0.0..70.0).contains(&to.y) {
                    place = to;
                }
                let cell = ((place.x / side_m) as i32, (place.y / side_m) as i32);
                cells.push(cell);
                // Some slots have few live cells, others many.
                let wide = [0, 3, 100][rng.random_range(0..3)];
                Layer::new(window, |column, row| {
                    (column - cell.0).abs() <= wide && (row - cell.1).abs() <= wide
                })
            });
            let mut tube = Tube {
                layers: layers.collect(),
            };
            let living = |tube: &Tube| -> usize {
                tube.layers.iter().map(|layer| layer.living().count()).sum()
            };
            before += living(&tube);
            drop_unreachable(&mut tube, &grid, reach_m);
            after += living(&tube);
            for (layer, &(column, row)) in tube.layers.iter().zip(&cells) {
                let index = layer.window.index(column, row);
                assert!(index.is_some_and(|index| layer.alive[index]));
            }
        }
        assert!(after < before / 2, "{after} of {before}");
    }
}
