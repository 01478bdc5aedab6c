//! Square cells over the area, and the pairs of cells that the flight of one slot can connect.

use firmware_core::{Position, mission::Area};

/// Cells of one size, anchored in the area's south-west corner. Halving the side splits each cell
/// into four.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    pub(crate) side_m: f64,
    pub(crate) columns: i32,
    pub(crate) rows: i32,
    area: Area<f64>,
}

/// A cell, cut to the area.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    pub(crate) low: Position<f64>,
    pub(crate) high: Position<f64>,
}

impl Grid {
    pub(crate) fn new(area: Area<f64>, side_m: f64) -> Self {
        let count = |extent_m: f64| (extent_m / side_m).floor() as i32 + 1;
        Self {
            side_m,
            columns: count(area.east_m),
            rows: count(area.north_m),
            area,
        }
    }

    pub(crate) fn halved(&self) -> Self {
        Self::new(self.area, self.side_m / 2.0)
    }

    /// Returns the closed cell, cut to the area.
    pub(crate) fn cell(&self, column: i32, row: i32) -> Cell {
        let corner = |column: i32, row: i32| {
            Position::new(
                (f64::from(column) * self.side_m).min(self.area.east_m),
                (f64::from(row) * self.side_m).min(self.area.north_m),
            )
        };
        Cell {
            low: corner(column, row),
            high: corner(column + 1, row + 1),
        }
    }
}

impl Cell {
    pub(crate) fn center(&self) -> Position<f64> {
        nalgebra::center(&self.low, &self.high)
    }

    /// Returns the distance from a position to the nearest point of the cell, metres.
    pub(crate) fn least_distance_m(&self, place: &Position<f64>) -> f64 {
        let beyond = |axis: usize| {
            (self.low[axis] - place[axis])
                .max(place[axis] - self.high[axis])
                .max(0.0)
        };
        beyond(0).hypot(beyond(1))
    }
}

/// The moves of one slot, in cells: for a change of row by `dy`, the column changes by up to
/// `half_width[|dy|]` to either side.
#[derive(Clone, Debug)]
pub(crate) struct Moves {
    pub(crate) half_width: Vec<i32>,
}

impl Moves {
    /// Returns every move that some admissible displacement makes: all pairs of cells whose nearest
    /// points are within reach.
    pub(crate) fn any(reach_m: f64, side_m: f64) -> Self {
        Self::within(reach_m / side_m * (1.0 + 1e-12), |cells| (cells - 1).max(0))
    }

    fn within(reach: f64, gap: impl Fn(i32) -> i32) -> Self {
        let joins = |dx: i32, dy: i32| f64::from(gap(dx)).hypot(f64::from(gap(dy))) <= reach;
        let mut half_width = Vec::new();
        let mut widest = reach as i32 + 2;
        for dy in 0.. {
            if !joins(0, dy) {
                break;
            }
            while !joins(widest, dy) {
                widest -= 1;
            }
            half_width.push(widest);
        }
        Self { half_width }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Every admissible displacement is a move between the cells of its two end points.
    #[test]
    fn moves_cover_every_admissible_displacement() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(4);
        let reach_m = 30.0;
        for halvings in 1..8 {
            let side_m = reach_m / f64::from(1 << halvings) / (1.0 - 1e-9);
            let moves = Moves::any(reach_m, side_m);
            for _ in 0..20_000 {
                let from =
                    Position::new(rng.random_range(0.0..side_m), rng.random_range(0.0..side_m));
                let turn = rng.random_range(0.0..std::f64::consts::TAU);
                let length_m = reach_m * [1.0, rng.random_range(0.0..1.0)][rng.random_range(0..2)];
                let to = from + nalgebra::Vector2::new(turn.cos(), turn.sin()) * length_m;
                let [dx, dy] = [to.x, to.y].map(|value| (value / side_m).floor() as i32);
                let half = moves.half_width.get(dy.unsigned_abs() as usize);
                assert!(
                    half.is_some_and(|&half| dx.abs() <= half),
                    "{side_m} {dx} {dy}"
                );
            }
            // Moves along the axes are not longer than V delta.
            assert!(f64::from(moves.half_width[0]) * side_m <= reach_m * (1.0 + 2e-9));
        }
    }

    #[test]
    fn cells_cover_the_area_and_halve_into_four() {
        let area = Area {
            east_m: 100.0,
            north_m: 45.0,
        };
        let grid = Grid::new(area, 15.0);
        let half = grid.halved();
        for (x, y) in [(0.0, 0.0), (100.0, 45.0), (14.9, 15.1), (99.9, 0.1)] {
            let index = |grid: &Grid, value: f64| (value / grid.side_m) as i32;
            let (column, row) = (index(&half, x), index(&half, y));
            assert!(column < half.columns && row < half.rows);
            assert_eq!((column / 2, row / 2), (index(&grid, x), index(&grid, y)));
            assert_eq!(
                half.cell(column, row)
                    .least_distance_m(&Position::new(x, y)),
                0.0
            );
        }
    }
}
