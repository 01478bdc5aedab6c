//! The value function of the relaxed mission, in which fairness is not a constraint but enters
//! through its prices (`docs/bound.md`).
//!
//! Without the fairness rule, a slot depends on the past only through the vehicle's position, so
//! backward dynamic programming solves the relaxed mission:
//!
//! ```text
//! V_N(q) = 0 where the mission may end, else a loss larger than any detour could gain
//! V_n(q) = max over ||d|| <= V_max delta of  U_{n+1}(q + d)
//! U_n(q) = V_n(q) + max_m ( R_m(q) + p_m )
//! ```
//!
//! The places form a grid, and `U` is interpolated bilinearly between them (a semi-Lagrangian
//! scheme; unlike the bound, the result is not certified).
//! [`Environment::with_values`](crate::Environment::with_values) uses it for potential-based
//! shaping.

use firmware_core::{Displacement, Mission, Position, SENSORS_MAX, Scalar, USERS_MAX};

/// Number of directions considered at a node, each at full and half speed.
const DIRECTIONS: usize = 16;
/// The smallest and the largest number of grid steps along the longer side of the area.
const STEPS: [f64; 2] = [64.0, 128.0];

/// The nodes of a grid over the area.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nodes {
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    spacing_m: [f64; 2],
}

impl Nodes {
    /// Returns a grid whose spacing is half of `reach_m`, as far as [`STEPS`] permits.
    pub(crate) fn new(extent_m: [f64; 2], reach_m: f64) -> Self {
        let longer_m = extent_m[0].max(extent_m[1]);
        let [fewest, most] = STEPS;
        let spacing_m = (reach_m / 2.0).clamp(longer_m / most, longer_m / fewest);
        let steps = extent_m.map(|extent_m| (extent_m / spacing_m).ceil().max(1.0));
        Self {
            columns: steps[0] as usize + 1,
            rows: steps[1] as usize + 1,
            spacing_m: [extent_m[0] / steps[0], extent_m[1] / steps[1]],
        }
    }

    pub(crate) fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// Returns the position of a node, metres.
    pub(crate) fn place(&self, index: usize) -> Position<f64> {
        let (column, row) = (index % self.columns, index / self.columns);
        Position::new(
            column as f64 * self.spacing_m[0],
            row as f64 * self.spacing_m[1],
        )
    }

    /// Returns the value at a place between nodes; outside the area, the value at its border.
    pub(crate) fn interpolate(&self, values: &[f32], place: &Position<f64>) -> f64 {
        let along = |axis: usize, count: usize| {
            let steps = (place[axis] / self.spacing_m[axis]).clamp(0.0, (count - 1) as f64);
            let low = (steps as usize).min(count - 2);
            (low, steps - low as f64)
        };
        let (column, east) = along(0, self.columns);
        let (row, north) = along(1, self.rows);
        let at = |column: usize, row: usize| f64::from(values[row * self.columns + column]);
        let south = at(column, row) * (1.0 - east) + at(column + 1, row) * east;
        let above = at(column, row + 1) * (1.0 - east) + at(column + 1, row + 1) * east;
        south * (1.0 - north) + above * north
    }
}

/// The value function `V_n(q)` of one relaxed mission, bit/s/Hz.
#[derive(Clone, Debug)]
pub struct ValueToGo {
    nodes: Nodes,
    /// `V_0` to `V_{N-1}`, one value per node.
    layers: Vec<Vec<f32>>,
}

impl ValueToGo {
    /// Computes the value function of a mission. `best_worth` returns the largest value of a slot
    /// at a place, `max_m ( R_m(q) + p_m )`, bit/s/Hz; it is called once per node.
    pub fn new<T: Scalar>(
        mission: &Mission<T, USERS_MAX, SENSORS_MAX>,
        mut best_worth: impl FnMut(Position<T>) -> f64,
    ) -> Self {
        let p = mission.parameters();
        let (slots, reach_m) = (mission.slots(), mission.reach_m().to_f64());
        let nodes = Nodes::new([p.area.east_m.to_f64(), p.area.north_m.to_f64()], reach_m);
        let destination = Position::new(p.destination.x.to_f64(), p.destination.y.to_f64());
        let worth: Vec<f64> = (0..nodes.count())
            .map(|index| {
                let place = nodes.place(index);
                best_worth(Position::new(T::of(place.x), T::of(place.y)))
            })
            .collect();
        let range = worth
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |r, &x| {
                [r[0].min(x), r[1].max(x)]
            });
        // Getting closer by one slot's flight is worth more than any other slot could gain.
        let loss_per_m = 2.0 * (range[1] - range[0]) / reach_m;
        let mut value: Vec<f64> = (0..nodes.count())
            .map(|index| {
                let left_m = (nodes.place(index) - destination).norm();
                -loss_per_m * (left_m - reach_m).max(0.0)
            })
            .collect();
        let moves = moves(reach_m);
        let mut layers = Vec::new();
        for _ in 0..slots {
            let total = value.iter().zip(&worth).map(|(value, worth)| value + worth);
            let total: Vec<f32> = total.map(|total| total as f32).collect();
            let best = |index: usize| {
                let from = nodes.place(index);
                let ends = moves
                    .iter()
                    .map(|step| nodes.interpolate(&total, &(from + step)));
                ends.fold(f64::NEG_INFINITY, f64::max)
            };
            value = (0..nodes.count()).map(best).collect();
            layers.push(value.iter().map(|&value| value as f32).collect());
        }
        layers.reverse();
        Self { nodes, layers }
    }

    /// Returns the value of the slots after `slots_done` to a vehicle at `place`, bit/s/Hz; it is
    /// 0 after the last slot.
    pub fn at(&self, slots_done: u32, place: &Position<f64>) -> f64 {
        let layer = self.layers.get(slots_done as usize);
        layer.map_or(0.0, |values| self.nodes.interpolate(values, place))
    }
}

/// Returns the displacements that the dynamic program considers.
pub(crate) fn moves(reach_m: f64) -> Vec<Displacement<f64>> {
    let turns = (0..DIRECTIONS).map(|i| i as f64 / DIRECTIONS as f64 * std::f64::consts::TAU);
    let rings = turns.flat_map(|turn| {
        let (north, east) = (libm::sin(turn), libm::cos(turn));
        [1.0, 0.5].map(|fraction| Displacement::new(east, north) * (fraction * reach_m))
    });
    std::iter::once(Displacement::zeros())
        .chain(rings)
        .collect()
}
