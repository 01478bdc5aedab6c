//! What is still to be had from a place: the value function of the relaxed mission, in which
//! fairness is paid for by its prices instead of being kept (`docs/bound.md`).
//!
//! Without the fairness rule a slot depends on the past through the vehicle's place alone, so
//! backward dynamic programming solves it:
//!
//! ```text
//! V_N(q) = 0 where the mission may end, else a loss that no detour is worth
//! V_n(q) = max over ||d|| <= V_max delta of  U_{n+1}(q + d)
//! U_n(q) = V_n(q) + max_m ( R_m(q) + p_m )
//! ```
//!
//! on a grid of places, between which `U` is interpolated bilinearly (a semi-Lagrangian scheme:
//! nothing is certified here, unlike in the bound). [`Environment::with_values`] takes it for
//! potential-based shaping.

use firmware_core::{Displacement, Position, Scalar};

use crate::env::Environment;

/// Directions in which the vehicle is tried out at a node, at full and half speed.
const DIRECTIONS: usize = 16;
/// The fewest and the most steps of the grid along the longer side of the area.
const STEPS: [f64; 2] = [64.0, 128.0];

/// Places on a grid over the area.
#[derive(Clone, Copy, Debug)]
struct Nodes {
    columns: usize,
    rows: usize,
    spacing_m: [f64; 2],
}

impl Nodes {
    /// Half of `reach_m` apart, within what [`STEPS`] allow.
    fn new(extent_m: [f64; 2], reach_m: f64) -> Self {
        let longer_m = extent_m[0].max(extent_m[1]);
        let [fewest, most] = STEPS;
        let wished_m = (reach_m / 2.0).clamp(longer_m / most, longer_m / fewest);
        let steps = extent_m.map(|extent_m| (extent_m / wished_m).ceil().max(1.0));
        Self {
            columns: steps[0] as usize + 1,
            rows: steps[1] as usize + 1,
            spacing_m: [extent_m[0] / steps[0], extent_m[1] / steps[1]],
        }
    }

    fn count(&self) -> usize {
        self.columns * self.rows
    }

    fn place(&self, index: usize) -> Position<f64> {
        let (column, row) = (index % self.columns, index / self.columns);
        Position::new(
            column as f64 * self.spacing_m[0],
            row as f64 * self.spacing_m[1],
        )
    }

    /// The value at a place between nodes; outside the area, that at its border.
    fn interpolate(&self, values: &[f32], place: &Position<f64>) -> f64 {
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

/// `V_n(q)`, bit/s/Hz, of one mission.
#[derive(Clone, Debug)]
pub struct ValueToGo {
    nodes: Nodes,
    /// `V_0` to `V_{N-1}`, node by node.
    layers: Vec<Vec<f32>>,
}

impl ValueToGo {
    /// Of an environment's mission, at its prices and with its way of choosing powers.
    pub fn new<T: Scalar>(environment: &Environment<T>) -> Self {
        let mut environment = environment.clone();
        let mission = environment.mission();
        let p = mission.parameters();
        let (slots, reach_m) = (mission.slots(), mission.reach_m().to_f64());
        let nodes = Nodes::new([p.area.east_m.to_f64(), p.area.north_m.to_f64()], reach_m);
        let destination = Position::new(p.destination.x.to_f64(), p.destination.y.to_f64());
        let worth: Vec<f64> = (0..nodes.count())
            .map(|index| {
                let place = nodes.place(index);
                environment.best_worth(Position::new(T::of(place.x), T::of(place.y)))
            })
            .collect();
        let range = worth
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |r, &x| {
                [r[0].min(x), r[1].max(x)]
            });
        // A slot's flight nearer is worth more than any other slot could gain.
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

    /// What the slots after `slots_done` are worth to a vehicle at `place`, bit/s/Hz; 0 after
    /// the last.
    pub fn at(&self, slots_done: u32, place: &Position<f64>) -> f64 {
        let layer = self.layers.get(slots_done as usize);
        layer.map_or(0.0, |values| self.nodes.interpolate(values, place))
    }
}

/// Displacements to choose from.
fn moves(reach_m: f64) -> Vec<Displacement<f64>> {
    let turns = (0..DIRECTIONS).map(|i| i as f64 / DIRECTIONS as f64 * std::f64::consts::TAU);
    let rings = turns.flat_map(|turn| {
        let (north, east) = (libm::sin(turn), libm::cos(turn));
        [1.0, 0.5].map(|share| Displacement::new(east, north) * (share * reach_m))
    });
    std::iter::once(Displacement::zeros())
        .chain(rings)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        learner::Choice,
        settings::{Algorithm, Preset, Settings},
    };
    use scenario::Scenario;

    fn environment() -> Environment<f64> {
        let scenario = Scenario::shipped("separated").and_then(|s| s.with_noise_dbm(-85.0).ok());
        let mission = scenario.expect("a shipped scenario").mission;
        let settings = Settings::preset(Preset::Paper, Algorithm::Sac, 1);
        let prices: Vec<f64> = (0..15).map(|user| 0.02 * f64::from(user)).collect();
        Environment::new(mission, &settings).with_prices(&prices)
    }

    #[test]
    fn what_is_bilinear_is_interpolated_exactly() {
        let nodes = Nodes::new([900.0, 500.0], 30.0);
        assert_eq!((nodes.columns, nodes.rows), (65, 37));
        let bilinear = |place: &Position<f64>| 2.0 + 0.01 * place.x - 0.03 * place.y * place.x;
        let values = (0..nodes.count()).map(|index| bilinear(&nodes.place(index)) as f32);
        let values: Vec<f32> = values.collect();
        for (x, y) in [(0.0, 0.0), (900.0, 500.0), (431.7, 77.7), (899.9, 0.1)] {
            let place = Position::new(x, y);
            let error = nodes.interpolate(&values, &place) - bilinear(&place);
            assert!(error.abs() < 2e-3, "{x} {y}: {error}");
        }
        // Outside it is as at the border.
        let [outside, border] = [Position::new(-5.0, 600.0), Position::new(0.0, 500.0)];
        let [a, b] = [outside, border].map(|place| nodes.interpolate(&values, &place));
        assert_eq!(a, b);
    }

    /// Who goes wherever the values are best gets what they promise.
    #[test]
    fn the_values_come_true() {
        let mut environment = environment();
        let values = ValueToGo::new(&environment);
        let start = environment.position();
        let reach_m = environment.mission().reach_m();
        let (moves, slots) = (moves(reach_m), environment.mission().slots());
        let mut worth = 0.0;
        for slot in 1..=slots {
            let mut best = (f64::NEG_INFINITY, 0.0, Displacement::zeros());
            for step in &moves {
                let place = environment.position() + step;
                if place.x.min(place.y) < 0.0 || place.x.max(place.y) > 1000.0 {
                    continue;
                }
                let here = environment.clone().best_worth(place);
                let total = here + values.at(slot, &place);
                if total > best.0 {
                    best = (total, here, *step);
                }
            }
            let action = best.2 / reach_m;
            let from = environment.position();
            environment.step(&Choice {
                action: vec![action.x as f32, action.y as f32],
                user: slot as usize % 15,
            });
            // In the last slots the shield decides; until then it has nothing to object to.
            let flown = environment.position() - from;
            if slot < slots - 1 {
                assert!(
                    (flown - best.2).norm() < 1.0,
                    "slot {slot}: {flown} {}",
                    best.2
                );
                worth += best.1;
            } else {
                worth += environment.clone().best_worth(environment.position());
            }
        }
        assert!(environment.episode().arrived);
        let promised = values.at(0, &start);
        assert!((worth / promised - 1.0).abs() < 0.02, "{worth} {promised}");
        assert_eq!(values.at(slots, &start), 0.0);
        // Too far from the destination for the slots that are left.
        assert!(
            values.at(slots - 5, &start) < values.at(slots - 5, &environment.position()) - 10.0
        );
    }
}
