//! Upper bounds on the rate of each user at any point of a cell.

use firmware_core::{
    Mission, Position, PowerGain,
    inner::{SlotLimits, Workspace},
};

use super::{error::BoundError, grid::Cell};
use scenario::with_field;

/// The number of steps of the gain table over the area's diagonal.
const TABLE_STEPS: usize = 1 << 17;

/// The largest relative rise from an entry of the gain table to the next one that is rounding.
const RISE_TOLERANCE: f64 = 1e-12;

/// A table of the power gain over the horizontal distance, rounded so that it never understates the
/// gain. An entry is valid for all distances from its own on, because gains decrease with distance:
/// `docs/bound.md` has the proof for every radio model, and the table is checked for it.
#[derive(Clone, Debug)]
struct GainTable {
    steps_per_m: f64,
    gain: Vec<f64>,
}

impl GainTable {
    fn new<const M: usize, const J: usize>(
        mission: &Mission<f64, M, J>,
    ) -> Result<Self, BoundError> {
        if mission.has_gain_map() {
            return Err(BoundError::GainMap);
        }
        let p = mission.parameters();
        let diagonal_m = p.area.east_m.hypot(p.area.north_m);
        let step_m = diagonal_m / TABLE_STEPS as f64;
        let gain = (0..TABLE_STEPS + 2).map(|step| {
            let slant_m = (step as f64 * step_m).hypot(p.altitude_m);
            mission.channel().power_gain_at(slant_m).0 * (1.0 + 1e-12)
        });
        let gain: Vec<f64> = gain.collect();
        if let Some(step) = first_rise(&gain) {
            return Err(BoundError::GainRises {
                model: p.radio_model,
                distance_m: step as f64 * step_m,
            });
        }
        Ok(Self {
            steps_per_m: 1.0 / step_m,
            gain,
        })
    }

    /// Returns an upper bound on the gain at any distance of at least `distance_m`.
    fn at_least(&self, distance_m: f64) -> PowerGain<f64> {
        // The small margin ensures that rounding never selects the next entry.
        let step = (distance_m * self.steps_per_m - 1e-6).max(0.0) as usize;
        PowerGain(self.gain[step.min(self.gain.len() - 1)])
    }
}

/// Returns the first entry that is less than the next one, or that cannot be compared with it.
fn first_rise(gain: &[f64]) -> Option<usize> {
    let falls = |pair: &[f64]| pair[1] <= pair[0] * (1.0 + RISE_TOLERANCE);
    gain.windows(2).position(|pair| !falls(pair))
}

/// Bounds the rates of a mission's users over cells.
#[derive(Clone, Debug)]
pub(crate) struct RateBound<'m, const M: usize, const J: usize> {
    mission: &'m Mission<f64, M, J>,
    limits: SlotLimits<f64>,
    table: GainTable,
}

impl<'m, const M: usize, const J: usize> RateBound<'m, M, J> {
    /// # Errors
    /// Returns an error if the gain rises somewhere with the distance, or comes from a map.
    pub(crate) fn new(mission: &'m Mission<f64, M, J>) -> Result<Self, BoundError> {
        Ok(Self {
            mission,
            limits: SlotLimits::of_mission(mission),
            table: GainTable::new(mission)?,
        })
    }

    /// Writes, for every user, an upper bound on the rate at any point of the cell: the rate of a
    /// slot in which every node is as near as the nearest point of the cell.
    pub(crate) fn over(&self, cell: &Cell, workspace: &mut Workspace<f64, J>, rates: &mut [f32]) {
        self.with_distances(|place| cell.least_distance_m(place), workspace, rates);
    }

    fn with_distances(
        &self,
        distance_m: impl Fn(&Position<f64>) -> f64,
        workspace: &mut Workspace<f64, J>,
        rates: &mut [f32],
    ) {
        let p = self.mission.parameters();
        let mut gains = [PowerGain(0.0); J];
        for (gain, sensor) in gains.iter_mut().zip(&p.sensors) {
            *gain = self.table.at_least(distance_m(sensor));
        }
        with_field(
            workspace,
            &self.limits,
            &gains[..p.sensors.len()],
            |field| {
                for (rate, user) in rates.iter_mut().zip(&p.users) {
                    let gain = self.table.at_least(distance_m(user));
                    let bound = field.map_or(0.0, |field| field.rate(gain));
                    *rate = round_up(bound + RATE_ROUNDING);
                }
            },
        );
    }
}

/// A bound on the rounding error of the slot solution in double precision, bit/s/Hz, with a large
/// margin.
pub(crate) const RATE_ROUNDING: f64 = 1e-9;

/// Returns the smallest `f32` that is not less than `value`.
pub(crate) fn round_up(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) < value {
        nearest.next_up()
    } else {
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_core::mission::RadioModel;
    use scenario::{PlaceRates, Scenario};

    use crate::bound::grid::Grid;
    use rand::{RngExt, SeedableRng};

    /// No point of a cell exceeds the cell's bound, and the bound approaches the rate as cells
    /// shrink.
    #[test]
    fn no_point_of_a_cell_exceeds_its_bound() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(9);
        for (name, noise_dbm) in [("separated", -95.0), ("mixed", -85.0), ("mixed", -70.0)] {
            let scenario = Scenario::shipped(name).and_then(|s| s.with_noise_dbm(noise_dbm).ok());
            let mission = scenario.expect("a shipped scenario").mission;
            let users = mission.user_count();
            let bound = RateBound::new(&mission).expect("a gain that falls");
            let mut exact = PlaceRates::new(&mission);
            let mut workspace = Workspace::default();
            for side_m in [15.0, 2.0, 0.1] {
                let grid = Grid::new(mission.parameters().area, side_m);
                let mut widest = 0.0_f64;
                for _ in 0..300 {
                    let column = rng.random_range(0..grid.columns);
                    let cell = grid.cell(column, rng.random_range(0..grid.rows));
                    let mut bounds = vec![0.0; users];
                    bound.over(&cell, &mut workspace, &mut bounds);
                    for (east, north) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 2), (2, 0), (1, 2)] {
                        let mut along = |axis: usize, step: usize| {
                            let share = [0.0, 1.0, rng.random_range(0.0..1.0)][step];
                            cell.low[axis] + share * (cell.high[axis] - cell.low[axis])
                        };
                        let place = Position::new(along(0, east), along(1, north));
                        let mut rates = vec![0.0; users];
                        exact.write(&place, &mut rates);
                        for (rate, &bound) in rates.iter().zip(&bounds) {
                            assert!(*rate <= f64::from(bound), "{name} {side_m} {rate} {bound}");
                            widest = widest.max(f64::from(bound) - rate);
                        }
                    }
                }
                assert!(widest < 0.1 * side_m + 1e-3, "{name} {side_m}: {widest}");
            }
        }
    }

    /// A gain that rises by more than rounding is found, and so is one that is not a number.
    #[test]
    fn a_rise_of_the_gain_is_found() {
        assert_eq!(first_rise(&[4.0, 3.0, 3.0 * (1.0 + 1e-13), 1.0]), None);
        assert_eq!(first_rise(&[4.0, 3.0, 3.0 * (1.0 + 1e-11), 1.0]), Some(1));
        assert_eq!(first_rise(&[4.0, f64::NAN, 1.0]), Some(0));
    }

    /// The bound holds with the models of TR 36.777 too: cells near and far, with and without
    /// certain line of sight.
    #[test]
    fn no_point_of_a_cell_exceeds_its_bound_with_aerial_models() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(10);
        for (model, altitude_m) in [
            (RadioModel::UmaAv, 60.0),
            (RadioModel::UmaAv, 120.0),
            (RadioModel::UmiAv, 30.0),
            (RadioModel::UmiAv, 300.0),
            (RadioModel::RmaAv, 12.0),
            (RadioModel::RmaAv, 39.0),
        ] {
            let shipped = Scenario::shipped("mixed").expect("shipped");
            let mut parameters = shipped.mission.parameters().clone();
            (parameters.radio_model, parameters.altitude_m) = (model, altitude_m);
            let mission = Mission::new(parameters).expect("a valid mission");
            let users = mission.user_count();
            let bound = RateBound::new(&mission).expect("a gain that falls");
            let mut exact = PlaceRates::new(&mission);
            let mut workspace = Workspace::default();
            let grid = Grid::new(mission.parameters().area, 5.0);
            let mut any = false;
            for _ in 0..300 {
                let column = rng.random_range(0..grid.columns);
                let cell = grid.cell(column, rng.random_range(0..grid.rows));
                let mut bounds = vec![0.0; users];
                bound.over(&cell, &mut workspace, &mut bounds);
                let place = Position::new(
                    rng.random_range(cell.low[0]..=cell.high[0]),
                    rng.random_range(cell.low[1]..=cell.high[1]),
                );
                let mut rates = vec![0.0; users];
                exact.write(&place, &mut rates);
                for (rate, &bound) in rates.iter().zip(&bounds) {
                    assert!(
                        *rate <= f64::from(bound),
                        "{model} {altitude_m} {rate} {bound}"
                    );
                    any |= *rate > 0.0;
                }
            }
            assert!(any, "{model} {altitude_m}: no rate at all");
        }
    }
}
