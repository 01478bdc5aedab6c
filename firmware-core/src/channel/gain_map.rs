// SPDX-License-Identifier: MIT OR Apache-2.0
//! Power gains that were computed elsewhere, for example by ray tracing: a grid of gains per user
//! and per sensor, at the altitude of the mission.
//!
//! Between grid points the gain is interpolated bilinearly (the power gain, not decibels), and
//! beyond the grid it is that of the nearest border. A gain of 0 is a link that is not heard.
//!
//! The grid is not part of a board's order: it would not fit into the frame. That is why the module
//! has a feature, `gain-map`, which a microcontroller does not need.

use core::fmt;

use super::GroundNode;
use crate::{
    scalar::{Position, Scalar},
    units::PowerGain,
};

/// Gains on a grid, in memory that lasts as long as the program.
#[derive(Clone, Copy, PartialEq)]
pub struct GainMap {
    east_m: &'static [f64],
    north_m: &'static [f64],
    users: usize,
    gains: &'static [f64],
}

impl fmt::Debug for GainMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GainMap")
            .field("columns", &self.east_m.len())
            .field("rows", &self.north_m.len())
            .field("users", &self.users)
            .finish_non_exhaustive()
    }
}

impl GainMap {
    /// Creates a map from the positions of the grid's columns and rows, ascending, metres, and the
    /// power gains: node by node, first the `users` users and then the sensors, each row by row
    /// from south to north, and each row from west to east.
    ///
    /// Returns `None` unless there are at least two columns and rows, both ascending, and a whole
    /// number of nodes, of which `users` are users, with gains that are valid.
    pub fn new(
        east_m: &'static [f64],
        north_m: &'static [f64],
        users: usize,
        gains: &'static [f64],
    ) -> Option<Self> {
        let ascends = |axis: &[f64]| {
            let mut pairs = axis.iter().zip(axis.iter().skip(1));
            axis.len() > 1 && pairs.all(|(low, high)| low < high)
        };
        let per_node = east_m.len().checked_mul(north_m.len())?;
        let valid = ascends(east_m)
            && ascends(north_m)
            && gains.len().is_multiple_of(per_node)
            && gains.len() / per_node >= users
            && gains.iter().all(|gain| gain.is_finite() && *gain >= 0.0);
        valid.then_some(Self {
            east_m,
            north_m,
            users,
            gains,
        })
    }

    /// Returns the power gain between a vehicle over `vehicle` and a node; 0 for a node that is not
    /// in the map. Worst case: two binary searches.
    pub fn power_gain<T: Scalar>(&self, node: GroundNode, vehicle: &Position<T>) -> PowerGain<T> {
        let (column, east) = bracket(self.east_m, vehicle.x.to_f64());
        let (row, north) = bracket(self.north_m, vehicle.y.to_f64());
        let at = |column, row| self.at(node, column, row);
        let along = |row: usize| at(column, row) * (1.0 - east) + at(column + 1, row) * east;
        PowerGain(T::of(along(row) * (1.0 - north) + along(row + 1) * north))
    }

    /// Returns the least and the largest power gain at the corners of all cells of the grid that
    /// come within `radius_m` of `vehicle` in both coordinates. Between the corners the gain lies
    /// between theirs. Worst case: two binary searches per axis, and all points of the grid.
    pub fn bounds<T: Scalar>(
        &self,
        node: GroundNode,
        vehicle: &Position<T>,
        radius_m: T,
    ) -> (PowerGain<T>, PowerGain<T>) {
        let radius_m = radius_m.to_f64();
        let cells = |axis, x: f64| {
            let (first, last) = (bracket(axis, x - radius_m).0, bracket(axis, x + radius_m).0);
            first..=last + 1
        };
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for row in cells(self.north_m, vehicle.y.to_f64()) {
            for column in cells(self.east_m, vehicle.x.to_f64()) {
                let gain = self.at(node, column, row);
                (least, most) = (least.min(gain), most.max(gain));
            }
        }
        (PowerGain(T::of(least.min(most))), PowerGain(T::of(most)))
    }

    /// Returns the gain of a node at a point of the grid, or 0 if there is none.
    fn at(&self, node: GroundNode, column: usize, row: usize) -> f64 {
        let index = match node {
            GroundNode::User(user) if user >= self.users => return 0.0,
            GroundNode::User(user) => user,
            GroundNode::Sensor(sensor) => self.users + sensor,
        };
        let point = (index * self.north_m.len() + row) * self.east_m.len() + column;
        self.gains.get(point).copied().unwrap_or(0.0)
    }
}

/// Returns the interval of an ascending axis that `x` is in, and the fraction of the interval below
/// `x`.
fn bracket(axis: &[f64], x: f64) -> (usize, f64) {
    let above = axis.partition_point(|&entry| entry <= x);
    let low = above.clamp(1, axis.len().max(2) - 1) - 1;
    match (axis.get(low), axis.get(low + 1)) {
        (Some(from), Some(to)) => (low, ((x - from) / (to - from)).clamp(0.0, 1.0)),
        // A map has at least two columns and rows.
        _ => (0, 0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One user and one sensor on a grid of 3 columns and 2 rows.
    const EAST: &[f64] = &[0.0, 10.0, 40.0];
    const NORTH: &[f64] = &[0.0, 20.0];
    const GAINS: &[f64] = &[
        1.0, 2.0, 4.0, 5.0, 6.0, 0.0, // user
        7.0, 7.0, 7.0, 7.0, 7.0, 7.0, // sensor
    ];

    #[test]
    fn gains_are_interpolated_and_held_beyond_the_border() {
        let map = GainMap::new(EAST, NORTH, 1, GAINS).expect("a map");
        let user = |east, north| {
            map.power_gain(GroundNode::User(0), &Position::<f64>::new(east, north))
                .0
        };
        for (east, north, expected) in [
            (0.0, 0.0, 1.0),
            (10.0, 20.0, 6.0),
            (5.0, 0.0, 1.5),
            // Half of 2 and 6, and of 4 and 0; a third of the way between 4 and 2.
            (20.0, 10.0, 4.0 * 2.0 / 3.0 + 2.0 / 3.0),
            (40.0, 20.0, 0.0),
            (-3.0, -8.0, 1.0),
            (100.0, 5.0, 3.0),
        ] {
            assert!(
                (user(east, north) - expected).abs() < 1e-12,
                "{east} {north}"
            );
        }
        let sensor = |index, place| map.power_gain(GroundNode::Sensor(index), &place).0;
        assert_eq!(sensor(0, Position::new(33.0_f32, 1.0)), 7.0);
        assert_eq!(sensor(1, Position::new(33.0, 1.0)), 0.0);
        let nobody = map.power_gain(GroundNode::User(1), &Position::<f64>::new(1.0, 1.0));
        assert_eq!(nobody.0, 0.0);
    }

    /// Every gain within the radius lies between the bounds, which are gains of the grid.
    #[test]
    fn bounds_contain_the_gains_nearby() {
        let map = GainMap::new(EAST, NORTH, 1, GAINS).expect("a map");
        let node = GroundNode::User(0);
        let bounds = |east, north, radius_m| {
            let (least, most) = map.bounds(node, &Position::<f64>::new(east, north), radius_m);
            (least.0, most.0)
        };
        assert_eq!(bounds(4.0, 10.0, 3.0), (1.0, 6.0));
        assert_eq!(bounds(9.0, 10.0, 3.0), (0.0, 6.0));
        assert_eq!(bounds(30.0, 10.0, 3.0), (0.0, 6.0));
        for step in 0..200 {
            let (east, north) = (f64::from(step % 20) * 2.5, f64::from(step / 20) * 2.5);
            let (least, most) = bounds(east, north, 4.0);
            for (aside, ahead) in [(-4.0, 0.0), (4.0, 0.0), (0.0, 4.0), (2.0, -3.0), (0.0, 0.0)] {
                let near = Position::<f64>::new(east + aside, north + ahead);
                let gain = map.power_gain(node, &near).0;
                assert!(
                    gain >= least - 1e-12 && gain <= most + 1e-12,
                    "{east} {north}"
                );
            }
        }
    }

    #[test]
    fn what_is_no_map_is_refused() {
        assert!(GainMap::new(EAST, NORTH, 2, GAINS).is_some());
        assert!(GainMap::new(EAST, NORTH, 3, GAINS).is_none());
        assert!(GainMap::new(EAST, &[0.0], 1, GAINS).is_none());
        assert!(GainMap::new(&[0.0, 10.0, 10.0], NORTH, 1, GAINS).is_none());
        assert!(GainMap::new(EAST, NORTH, 1, &[1.0; 11]).is_none());
        assert!(GainMap::new(EAST, NORTH, 0, &[1.0, 1.0, -1.0, 1.0, 1.0, 1.0]).is_none());
        assert!(GainMap::new(EAST, NORTH, 0, &[1.0, 1.0, f64::NAN, 1.0, 1.0, 1.0]).is_none());
    }
}
