//! One size of cells: their rate bounds, the dual function over them, and the cells that it
//! excludes.

use firmware_core::{Mission, Position};

use super::{
    grid::{Cell, Grid, Moves},
    multipliers::DualPoint,
    rates::round_up,
    reach::drop_unreachable,
    table::{LiveCell, RateTable, best_user},
    tube::{Tube, Values, Worth},
    window::{Layer, Window},
};

/// Cells of one size, for some or all of the missions.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    pub(crate) grid: Grid,
    pub(crate) tube: Tube,
    /// How many times the first cells of the area were halved.
    pub(crate) depth: usize,
    moves: Moves,
    reach_m: f64,
    quota: f64,
    users: usize,
}

/// Returns whether a cell can contain the waypoint of a slot (counted from 0), because it is near
/// enough to the start and to the destination.
fn within_reach<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    cell: &Cell,
    slot: usize,
) -> bool {
    let p = mission.parameters();
    let reach = |slots: usize| slots as f64 * mission.reach_m() * (1.0 + 1e-12);
    let slots = mission.slots() as usize;
    cell.least_distance_m(&p.start) <= reach(slot + 1)
        && cell.least_distance_m(&p.destination) <= reach(slots - slot)
}

impl Level {
    /// Returns the level of all missions over the cells of a grid, or `None` if more than
    /// `pairs_max` pairs of slot and cell would have to be stored.
    pub(crate) fn first<const M: usize, const J: usize>(
        mission: &Mission<f64, M, J>,
        grid: Grid,
        pairs_max: usize,
    ) -> Option<Self> {
        let slots = mission.slots() as usize;
        let windows: Vec<Window> = (0..slots)
            .map(|slot| window_of_slot(mission, &grid, slot))
            .collect();
        if windows.iter().map(Window::cells).sum::<usize>() > pairs_max {
            return None;
        }
        let layers = windows.into_iter().enumerate().map(|(slot, window)| {
            Layer::new(window, |column, row| {
                within_reach(mission, &grid.cell(column, row), slot)
            })
        });
        let tube = Tube {
            layers: layers.collect(),
        };
        Some(Self::with(mission, grid, tube, 0))
    }

    fn with<const M: usize, const J: usize>(
        mission: &Mission<f64, M, J>,
        grid: Grid,
        tube: Tube,
        depth: usize,
    ) -> Self {
        // No two points of the area are further apart than its diagonal, so longer moves leave the
        // area.
        let area = mission.parameters().area;
        let longest_m = mission.reach_m().min(area.east_m.hypot(area.north_m));
        Self {
            moves: Moves::any(longest_m, grid.side_m),
            reach_m: mission.reach_m(),
            grid,
            tube,
            depth,
            quota: f64::from(mission.quota()),
            users: mission.user_count(),
        }
    }

    /// Returns the level with every live cell split into four.
    pub(crate) fn split<const M: usize, const J: usize>(
        &self,
        mission: &Mission<f64, M, J>,
    ) -> Self {
        let grid = self.grid.halved();
        let tube = self.tube.split(|slot, column, row| {
            column < grid.columns
                && row < grid.rows
                && within_reach(mission, &grid.cell(column, row), slot)
        });
        Self::with(mission, grid, tube, self.depth + 1)
    }

    /// Divides the missions by the position of their waypoint of `slot`: those whose cell has its
    /// centre on one side of a line, and those on the other. `side_of` is positive on one side.
    /// Every cell is on exactly one side, and the cells cover the area, so no mission is lost.
    pub(crate) fn branched(
        &self,
        slot: usize,
        side_of: impl Fn(&Position<f64>) -> f64 + Sync,
    ) -> [Self; 2] {
        [true, false].map(|positive| {
            let mut part = self.clone();
            let layer = &self.tube.layers[slot];
            part.tube.layers[slot] = Layer::new(layer.window, |column, row| {
                let alive = layer.window.index(column, row);
                let center = self.grid.cell(column, row).center();
                alive.is_some_and(|index| layer.alive[index])
                    && (side_of(&center) > 0.0) == positive
            });
            part.drop_unreachable();
            part
        })
    }

    /// Drops cells that no admissible mission through the other cells reaches.
    pub(crate) fn drop_unreachable(&mut self) {
        drop_unreachable(&mut self.tube, &self.grid, self.reach_m);
    }

    /// Returns the number of comparisons that one pass takes.
    pub(crate) fn pass_cost(&self) -> usize {
        let rows = self.moves.half_width.len();
        self.tube.stored() * (2 * rows + rows.ilog2() as usize + 2)
    }

    /// Returns the level together with the rates of its cells.
    pub(crate) fn with_rates<'a>(&'a self, table: &'a RateTable) -> RatedLevel<'a> {
        let hull = self.tube.hull();
        RatedLevel {
            cells: table.live_cells(&hull, &self.tube),
            hull,
            level: self,
            table,
        }
    }

    /// Returns `floor(N/M) sum_m lambda_m`.
    fn owed(&self, prices: &[f32]) -> f64 {
        self.quota * prices.iter().map(|&price| f64::from(price)).sum::<f64>()
    }

    /// Returns the largest error of single precision along a path: each slot rounds once in
    /// `rate + price` and once in the running sum, by at most half a unit in the last place of the
    /// largest sum.
    fn rounding(&self, worth: &Worth) -> f64 {
        let finite = worth.value.iter().filter(|value| value.is_finite());
        let largest = finite.fold(0.0_f32, |largest, value| largest.max(value.abs()));
        let slots = self.tube.layers.len() as f64;
        (2.0 * slots + 4.0) * slots * f64::from(largest) * f64::from(f32::EPSILON) / 2.0
    }

    /// Drops every pair of slot and cell through which no mission reaches `lower`. Returns a bound
    /// on all missions in the tube before cells were dropped.
    pub(crate) fn prune(&mut self, table: &RateTable, multipliers: &[f64], lower: f64) -> f64 {
        let prices = single(multipliers);
        let rated = self.with_rates(table);
        let worth = rated.worth(&prices);
        let (forward, backward) = rayon::join(
            || self.tube.forward(&worth, &self.moves),
            || self.tube.backward(&worth, &self.moves),
        );
        let value = rated.value(&forward, &prices, &worth);
        let least = lower - self.rounding(&worth) + self.owed(&prices);
        // Rounding down guarantees that everything dropped is worse than `lower`.
        self.tube
            .prune(&worth, &forward, &backward, -round_up(-least));
        value
    }
}

/// A level and the rates of its live cells.
#[derive(Debug)]
pub(crate) struct RatedLevel<'a> {
    level: &'a Level,
    table: &'a RateTable,
    hull: Window,
    cells: Vec<LiveCell>,
}

impl RatedLevel<'_> {
    /// Returns the value of every cell at the given prices: the largest rate bound plus price.
    fn worth(&self, prices: &[f32]) -> Worth {
        let mut value = vec![f32::NEG_INFINITY; self.hull.cells()];
        let worth = self.table.worth(&self.cells, prices);
        for (cell, worth) in self.cells.iter().zip(worth) {
            value[cell.index as usize] = worth;
        }
        Worth {
            window: self.hull,
            value,
        }
    }

    /// Returns the dual function over the live cells with a subgradient, and a path that attains
    /// it, as centres of cells.
    pub(crate) fn dual(&self, multipliers: &[f64]) -> (DualPoint, Vec<Position<f64>>) {
        let prices = single(multipliers);
        let worth = self.worth(&prices);
        let Level { tube, moves, .. } = self.level;
        let forward = tube.forward(&worth, moves);
        let chain = tube.best_chain(&forward, moves).unwrap_or_default();
        let mut subgradient = vec![-self.level.quota; self.level.users];
        let mut path = Vec::with_capacity(chain.len());
        for (column, row) in chain {
            if let Some(rates) = self.table.of_cell(column, row) {
                subgradient[best_user(rates, &prices)] += 1.0;
            }
            path.push(self.level.grid.cell(column, row).center());
        }
        let point = DualPoint {
            value: self.value(&forward, &prices, &worth),
            subgradient,
        };
        (point, path)
    }

    /// Returns the bound that a forward pass proves.
    fn value(&self, forward: &Values, prices: &[f32], worth: &Worth) -> f64 {
        let largest = forward.last().map_or(f32::NEG_INFINITY, |last| {
            last.iter().copied().fold(f32::NEG_INFINITY, f32::max)
        });
        f64::from(largest) + self.level.rounding(worth) - self.level.owed(prices)
    }
}

/// Returns the prices in single precision: those that the dynamic programme uses and that the bound
/// is then proved at.
fn single(multipliers: &[f64]) -> Vec<f32> {
    multipliers.iter().map(|&price| price as f32).collect()
}

/// Returns the window of cells that can contain the waypoint of a slot (counted from 0).
fn window_of_slot<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    grid: &Grid,
    slot: usize,
) -> Window {
    let p = mission.parameters();
    let from_start_m = (slot + 1) as f64 * mission.reach_m();
    let from_destination_m = (mission.slots() as usize - slot) as f64 * mission.reach_m();
    let range = |axis: usize, count: i32| {
        let low_m = (p.start[axis] - from_start_m).max(p.destination[axis] - from_destination_m);
        let high_m = (p.start[axis] + from_start_m).min(p.destination[axis] + from_destination_m);
        // One more cell on either side covers rounding.
        let low = (low_m / grid.side_m).floor().max(1.0) as i32 - 1;
        let high = ((high_m / grid.side_m).floor().max(0.0) as i32)
            .saturating_add(2)
            .min(count);
        (low, (high - low).max(0) as usize)
    };
    let (column, width) = range(0, grid.columns);
    let (row, height) = range(1, grid.rows);
    Window {
        column,
        row,
        width,
        height,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::{HostMission, Scenario};

    fn first_level(mission: &HostMission) -> Level {
        let p = mission.parameters();
        let extent_m = p.area.east_m.max(p.area.north_m);
        let grid = Grid::new(p.area, mission.reach_m().min(extent_m) / 2.0 / (1.0 - 1e-9));
        Level::first(mission, grid, usize::MAX).expect("a level")
    }

    /// Moves that leave the area from every cell are omitted: they would only cost time and memory.
    #[test]
    fn moves_are_no_longer_than_the_area() {
        let shipped = Scenario::shipped("separated").expect("a shipped scenario");
        for max_speed_mps in [35.0, 1e3, 1e5] {
            let mut parameters = shipped.mission.parameters().clone();
            parameters.max_speed_mps = max_speed_mps;
            let mission = Mission::new(parameters).expect("a valid mission");
            let level = first_level(&mission).split(&mission);
            let across =
                f64::from(level.grid.columns.max(level.grid.rows)) * std::f64::consts::SQRT_2;
            let (rows, widest) = (level.moves.half_width.len(), level.moves.half_width[0]);
            assert!(rows as f64 <= across + 2.0, "{max_speed_mps}: {rows}");
            assert!(
                f64::from(widest) <= across + 2.0,
                "{max_speed_mps}: {widest}"
            );
        }
    }
}
