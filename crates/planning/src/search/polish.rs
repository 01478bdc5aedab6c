//! Continuous refinement of a path: all waypoints may move a little at the same time.
//!
//! Around each waypoint there is a stencil of `(2k + 1)^2` candidate positions. Dynamic programming
//! finds the best admissible chain through the candidates. The old path is among the candidates, so
//! the value never decreases. A stretched path, in which no single waypoint can move without
//! breaking the speed limit, can still move as a whole.

use firmware_core::{Mission, Position};
use rayon::prelude::*;

use scenario::{ABSENT_RATE, PlaceRates};

use super::{plan::Plan, rearrange::CandidateGraph};

/// The number of candidates to each side of a waypoint.
const STENCIL_REACH: i32 = 4;
const STENCIL_SIDE: usize = 2 * STENCIL_REACH as usize + 1;

/// The constraints on a path, slightly tighter than the mission's own, and the lattice of its
/// waypoints.
///
/// Waypoints and their differences are multiples of a power of two that `f32` represents exactly.
/// MAVLink therefore transmits exactly what was planned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PathRules<'m, const M: usize, const J: usize> {
    pub(crate) mission: &'m Mission<f64, M, J>,
    /// What the mission becomes in flight: first slots, ascending, and missions.
    later: &'m [(u32, Mission<f64, M, J>)],
    /// `V_max delta` minus the margin, and at most what is needed to cross the area, metres.
    pub(crate) reach_m: f64,
    /// The spacing of the lattice, metres.
    pub(crate) quantum_m: f64,
}

impl<'m, const M: usize, const J: usize> PathRules<'m, M, J> {
    pub(crate) fn new(mission: &'m Mission<f64, M, J>) -> Self {
        Self::changing(mission, &[])
    }

    /// Creates the rules of a mission that becomes another one in flight: `later` has the first slot
    /// of each version, ascending.
    pub(crate) fn changing(
        mission: &'m Mission<f64, M, J>,
        later: &'m [(u32, Mission<f64, M, J>)],
    ) -> Self {
        let area = mission.parameters().area;
        let extent_m = area.east_m.max(area.north_m);
        // 2^23 steps across the area leave one bit of the mantissa of f32 unused.
        let quantum_m = (extent_m.log2().ceil() - 23.0).exp2();
        // Twice the extent is more than the diagonal, so no waypoint is lost, and candidates, whose
        // spacings are fractions of the reach, start inside the area.
        let reach_m = mission.reach_m().min(2.0 * extent_m);
        Self {
            mission,
            later,
            reach_m: reach_m - 2.0 * quantum_m,
            quantum_m,
        }
    }

    /// Returns the mission as it is in the slot of waypoint `index`.
    pub(crate) fn mission_in(&self, index: usize) -> &'m Mission<f64, M, J> {
        let versions = self.later.iter().rev();
        let mut begun = versions.filter(|(slot, _)| *slot as usize <= index + 1);
        begun.next().map_or(self.mission, |(_, mission)| mission)
    }

    fn at_end(&self) -> &'m Mission<f64, M, J> {
        self.later.last().map_or(self.mission, |(_, end)| end)
    }

    /// Returns the number of slots of the mission.
    pub(crate) fn slots(&self) -> usize {
        self.at_end().slots() as usize
    }

    /// Returns the longest step to waypoint `index`; after the last one, to the destination.
    pub(crate) fn reach_in(&self, index: usize) -> f64 {
        match self.later {
            [] => self.reach_m,
            _ => (self.mission_in(index).reach_m() - 2.0 * self.quantum_m).min(self.reach_m),
        }
    }

    /// Returns the plan of a path with the best fair assignment.
    pub(crate) fn assigned(&self, path: Vec<Position<f64>>) -> Plan {
        Plan::assigned_in(|index| self.mission_in(index), self.at_end(), path)
    }

    /// Returns the lattice point nearest to a position, or `None` if that point is outside the
    /// area.
    pub(crate) fn on_lattice(&self, place: Position<f64>) -> Option<Position<f64>> {
        let place = place.map(|value| (value / self.quantum_m).round() * self.quantum_m);
        self.mission
            .parameters()
            .area
            .contains(&place)
            .then_some(place)
    }

    /// Returns whether the vehicle can fly to waypoint `index` at `to` in its slot.
    fn joins(&self, index: usize, from: &Position<f64>, to: &Position<f64>) -> bool {
        let reach_m = self.reach_in(index);
        (to - from).norm_squared() <= reach_m * reach_m
    }

    /// Returns whether a path from the mission's start has a waypoint for every slot, satisfies the
    /// speed limit, stays in the area, and ends within one more slot of the destination.
    pub(crate) fn admits(&self, path: &[Position<f64>]) -> bool {
        let p = self.mission.parameters();
        // If no chain connects the cells, the path has no waypoints.
        if path.len() != self.slots() {
            return false;
        }
        let mut from = &p.start;
        for (index, to) in path.iter().enumerate() {
            if !(self.joins(index, from, to) && p.area.contains(to)) {
                return false;
            }
            from = to;
        }
        self.joins(path.len(), from, &p.destination)
    }

    /// Returns the candidates of the given spacing around `path`, which must be admissible.
    pub(crate) fn candidates(&self, path: &[Position<f64>], spacing_m: f64) -> CandidateGraph {
        let p = self.mission.parameters();
        let users = self.at_end().user_count();
        let places: Vec<Vec<Position<f64>>> = path
            .iter()
            .map(|center| self.stencil(center, spacing_m).collect())
            .collect();
        let rates = places.par_iter().enumerate().map(|(slot, places)| {
            let mut place_rates = PlaceRates::new(self.mission_in(slot));
            let mut rates = vec![vec![0.0; places.len()]; users];
            for (index, place) in places.iter().enumerate() {
                let mut row = [ABSENT_RATE; M];
                place_rates.write(place, &mut row[..users]);
                for (rates, &rate) in rates.iter_mut().zip(row.iter()) {
                    rates[index] = rate;
                }
            }
            rates
        });
        let start = vec![p.start];
        let predecessors = places.par_iter().enumerate().map(|(slot, here)| {
            let before = slot
                .checked_sub(1)
                .map_or(&start, |previous| &places[previous]);
            let bits = |to: &Position<f64>| {
                let predecessors = before
                    .iter()
                    .enumerate()
                    .filter(|(_, from)| self.joins(slot, from, to));
                predecessors.fold(0, |bits, (index, _)| bits | 1_u128 << index)
            };
            here.iter().map(bits).collect()
        });
        let (rates, predecessors) = (rates.collect(), predecessors.collect());
        let last = places.last().into_iter().flatten();
        let reaches_destination = last
            .map(|place| self.joins(path.len(), place, &p.destination))
            .collect();
        CandidateGraph {
            places,
            rates,
            predecessors,
            reaches_destination,
        }
    }

    /// Returns the candidates around a waypoint. The waypoint itself comes first, so that it wins
    /// ties.
    fn stencil(
        &self,
        center: &Position<f64>,
        spacing_m: f64,
    ) -> impl Iterator<Item = Position<f64>> {
        let offsets = (0..STENCIL_SIDE * STENCIL_SIDE).map(move |index| {
            let column = (index % STENCIL_SIDE) as i32 - STENCIL_REACH;
            let row = (index / STENCIL_SIDE) as i32 - STENCIL_REACH;
            nalgebra::Vector2::new(f64::from(column), f64::from(row)) * spacing_m
        });
        let moved = offsets
            .filter(|offset| offset.norm_squared() > 0.0)
            .filter_map(move |offset| self.on_lattice(center + offset));
        std::iter::once(*center).chain(moved)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::Scenario;

    /// If start and destination are near each other, a path without waypoints connects them, but it
    /// is not a mission.
    #[test]
    fn a_path_of_another_length_is_not_admitted() {
        let shipped = Scenario::shipped("separated").expect("a shipped scenario");
        let mut parameters = shipped.mission.parameters().clone();
        parameters.destination = parameters.start;
        let mission = Mission::new(parameters).expect("a valid mission");
        let rules = PathRules::new(&mission);
        let stay = vec![mission.parameters().start; mission.slots() as usize];
        assert!(rules.admits(&stay));
        assert!(!rules.admits(&stay[1..]));
        assert!(!rules.admits(&[]));
    }
}
