//! Figures of total rates: the result of every approach on every mission of a figure.

mod approach_verdicts;
mod by_mission;
mod drawing;
mod verdicts;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    Experiment,
    approach::Approach,
    cell::{Cell, HIGH_NOISE_DBM, MISSION_TIMES_S, MSE_THRESHOLDS, NOISE_DBM, Topology, Training},
    claims::range,
    context::ExperimentContext,
    rounded,
    seed_table::SeedRow,
    statistics,
    trainings::Run,
};
use crate::policy::PolicyChoice;
use environment::Allocation;

pub(super) use approach_verdicts::claims_of_approaches;
pub(super) use drawing::chart;
pub(super) use verdicts::{claims_of_mission_time, claims_of_noise, claims_of_strategies};

/// A row of a figure's CSV file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TotalRow {
    /// The topology of the mission.
    pub topology: Topology,
    /// `T`, seconds.
    pub mission_time_s: u32,
    /// `sigma^2`, dBm.
    pub noise_dbm: f64,
    /// `Gamma`.
    pub mse_threshold: f64,
    /// The approach that was flown.
    pub approach: Approach,
    /// The number of policies of different seeds.
    pub runs: usize,
    /// The number of runs among them that were read from a table (`models/seeds.csv`, or
    /// `models/bounds.csv` for `search` and `bound`) and not computed with the figure.
    pub stored: usize,
    /// The sum of the rates, bit/s/Hz, averaged over the runs.
    pub sum_rate: f64,
    /// Half the width of its 95 % confidence interval.
    pub interval_95: Option<f64>,
    /// The sum of the rates of the best run, bit/s/Hz.
    pub sum_rate_max: f64,
    /// The number of slots in which `Gamma` was not met, averaged over the runs.
    pub missed_slots: f64,
    /// Whether every run arrived, was fair and violated no limit.
    pub constraints_held: bool,
    /// The seeds of the runs that count as failed, separated by spaces: their totals are below
    /// [`FAILED`] times the median of the others.
    pub failed_seeds: String,
}

/// A run whose total is below this fraction of the median of the same cell's other seeds counts
/// as failed.
pub const FAILED: f64 = 0.9;

impl TotalRow {
    /// Returns whether another row is of the same mission.
    pub(super) fn is_of_mission(&self, other: &Self) -> bool {
        self.topology == other.topology
            && self.mission_time_s == other.mission_time_s
            && self.noise_dbm == other.noise_dbm
            && self.mse_threshold == other.mse_threshold
    }

    fn is_of(&self, cell: &Cell) -> bool {
        self.topology == cell.topology
            && self.mission_time_s == cell.slots
            && self.noise_dbm == cell.noise_dbm
            && self.mse_threshold == cell.mse_threshold
    }
}

/// Returns the missions of a figure.
fn cells(experiment: Experiment) -> Vec<Cell> {
    let thresholds = |noise_dbm: f64| {
        Topology::ALL.into_iter().flat_map(move |topology| {
            let cell = Cell::table_one(topology).at_noise(noise_dbm);
            MSE_THRESHOLDS.map(|threshold| cell.at_threshold(threshold))
        })
    };
    match experiment {
        Experiment::MissionTime => MISSION_TIMES_S
            .map(|slots| Cell::table_one(Topology::Separated).lasting(slots))
            .into(),
        Experiment::Strategies => thresholds(NOISE_DBM).collect(),
        _ => thresholds(NOISE_DBM)
            .chain(thresholds(HIGH_NOISE_DBM))
            .collect(),
    }
}

/// Returns the approaches of a figure, in the paper's order.
fn approaches(experiment: Experiment) -> &'static [Approach] {
    use Approach::{
        AnyMission, Bound, DdpgTableOne, DdpgTuned, FixedPosition, FixedSensorPower,
        FixedUserPower, SacTableOne, SacTuned, Search, StraightLine,
    };
    match experiment {
        Experiment::Noise => &[SacTuned],
        Experiment::Strategies => &[SacTuned, FixedPosition, FixedUserPower, FixedSensorPower],
        Experiment::MissionTime => &[
            SacTuned,
            FixedPosition,
            FixedUserPower,
            FixedSensorPower,
            Bound,
        ],
        _ => &[
            SacTuned,
            SacTableOne,
            DdpgTuned,
            DdpgTableOne,
            AnyMission,
            StraightLine,
            Search,
            Bound,
        ],
    }
}

/// Returns how many seeds of a learner a figure shows. The schemes that hold a quantity fixed fly
/// the policy of seed 1, and so does SAC in the same figures.
fn seeds(experiment: Experiment) -> u64 {
    match experiment {
        Experiment::Approaches | Experiment::Noise => u64::MAX,
        _ => 1,
    }
}

/// One run that a figure needs.
struct FlightJob {
    cell: Cell,
    approach: Approach,
    seed: u64,
    source: Source,
}

/// Where the result of a run comes from.
enum Source {
    Flight(PolicyChoice),
    Table(SeedRow),
}

/// The result of a run.
struct RunResult {
    seed: u64,
    stored: bool,
    sum_rate: f64,
    missed_slots: f64,
    constraints_held: bool,
}

impl FlightJob {
    fn result(&self, context: &ExperimentContext<'_>) -> Result<RunResult, String> {
        let Self {
            cell,
            approach,
            seed,
            ..
        } = *self;
        Ok(match &self.source {
            Source::Table(row) => RunResult {
                seed,
                stored: true,
                sum_rate: row.sum_rate,
                missed_slots: row.missed_slots as f64,
                constraints_held: row.arrived && row.fair && row.constraint_violations == 0,
            },
            Source::Flight(policy) => {
                let flown = context.fly(&cell, policy, approach.allocation())?.summary();
                RunResult {
                    seed,
                    stored: false,
                    sum_rate: flown.sum_rate,
                    missed_slots: flown.mse_violations as f64,
                    constraints_held: flown.arrived
                        && flown.fair
                        && flown.constraint_violations == 0,
                }
            }
        })
    }
}

/// Flies and certifies everything that a figure shows.
pub(super) fn measure(
    experiment: Experiment,
    context: &mut ExperimentContext<'_>,
) -> Result<Vec<TotalRow>, String> {
    let mut trainings: Vec<(Approach, Training)> = Vec::new();
    let mut jobs = Vec::new();
    let mut plan = Vec::new();
    for cell in cells(experiment) {
        for &approach in approaches(experiment) {
            plan.push((cell, approach));
            let mut add = |seed, source| {
                jobs.push(FlightJob {
                    cell,
                    approach,
                    seed,
                    source,
                });
            };
            match approach {
                Approach::AnyMission => add(1, Source::Flight(PolicyChoice::Any)),
                Approach::StraightLine => add(1, Source::Flight(PolicyChoice::StraightLine)),
                Approach::FixedPosition => add(1, Source::Flight(PolicyChoice::Fixed)),
                _ => {
                    let Some(learner) = approach.learner() else {
                        continue;
                    };
                    for run in context.trainings().runs(cell, learner, seeds(experiment))? {
                        match run {
                            Run::Policy(training) => trainings.push((approach, training)),
                            Run::Stored(row) if approach.allocation() == Allocation::Exact => {
                                add(row.seed, Source::Table(row));
                            }
                            // The table has no flights with other allocations, so the policy is
                            // needed, and reported as missing.
                            Run::Stored(row) => {
                                let training = Training::new(cell, learner, row.seed);
                                trainings.push((approach, training));
                            }
                        }
                    }
                }
            }
        }
    }
    let wanted: Vec<Training> = trainings.iter().map(|(_, training)| *training).collect();
    let files = context.trainings().policies(&wanted)?;
    for ((approach, training), file) in trainings.into_iter().zip(files) {
        jobs.push(FlightJob {
            cell: training.cell,
            approach,
            seed: training.seed,
            source: Source::Flight(PolicyChoice::File(file)),
        });
    }
    let results: Result<Vec<RunResult>, String> =
        jobs.par_iter().map(|job| job.result(context)).collect();
    let results = results?;
    let mut rows = Vec::new();
    for (cell, approach) in plan {
        let of_row = jobs
            .iter()
            .zip(&results)
            .filter(|(job, _)| job.cell == cell && job.approach == approach);
        let mut of_row: Vec<&RunResult> = of_row.map(|(_, result)| result).collect();
        of_row.sort_by_key(|result| result.seed);
        rows.push(match approach {
            Approach::Search | Approach::Bound => {
                let bound = context.bound(&cell)?;
                let rate = match approach {
                    Approach::Search => bound.lower,
                    _ => bound.upper,
                };
                let stored = usize::from(context.is_stored(&bound));
                TotalRow {
                    stored,
                    ..single(cell, approach, rate)
                }
            }
            _ => total(cell, approach, &of_row),
        });
    }
    Ok(rows)
}

fn single(cell: Cell, approach: Approach, sum_rate: f64) -> TotalRow {
    TotalRow {
        topology: cell.topology,
        mission_time_s: cell.slots,
        noise_dbm: cell.noise_dbm,
        mse_threshold: cell.mse_threshold,
        approach,
        runs: 1,
        stored: 0,
        sum_rate: rounded(sum_rate),
        interval_95: None,
        sum_rate_max: rounded(sum_rate),
        missed_slots: 0.0,
        constraints_held: true,
        failed_seeds: String::new(),
    }
}

fn total(cell: Cell, approach: Approach, runs: &[&RunResult]) -> TotalRow {
    let rates: Vec<f64> = runs.iter().map(|run| run.sum_rate).collect();
    let missed: Vec<f64> = runs.iter().map(|run| run.missed_slots).collect();
    let failed = runs.iter().enumerate().filter(|(index, run)| {
        let mut others = rates.clone();
        others.remove(*index);
        run.sum_rate < FAILED * statistics::median(&others)
    });
    let failed: Vec<String> = failed.map(|(_, run)| run.seed.to_string()).collect();
    TotalRow {
        runs: runs.len(),
        stored: runs.iter().filter(|run| run.stored).count(),
        interval_95: statistics::half_width_95(&rates).map(rounded),
        sum_rate_max: rounded(range(rates.iter().copied()).1),
        missed_slots: rounded(statistics::mean(&missed)),
        constraints_held: runs.iter().all(|run| run.constraints_held),
        failed_seeds: failed.join(" "),
        ..single(cell, approach, statistics::mean(&rates))
    }
}
