//! Figures of total rates: the result of every approach on every mission of a figure.

mod verdicts;

use std::fmt::Write as _;

use plotters::chart::SeriesLabelPosition;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    Experiment,
    cell::{
        Cell, HIGH_NOISE_DBM, Learner, MISSION_TIMES_S, MSE_THRESHOLDS, NOISE_DBM, Topology,
        Training,
    },
    claims::range,
    context::ExperimentContext,
    figure::{Axis, Figure, LOOKS, Look, Panel, Series},
    rounded, statistics,
};
use crate::{policy::PolicyChoice, record::Summary};
use environment::Allocation;

pub(super) use verdicts::{
    claims_of_approaches, claims_of_mission_time, claims_of_noise, claims_of_strategies,
};

/// The policy and allocation of a mission, or a reference that it is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Approach {
    /// SAC with the best settings that were found.
    Sac,
    /// SAC with Table I's settings.
    SacTableOne,
    /// DDPG with Table I's settings.
    Ddpg,
    /// Straight to the destination, serving the nearest admissible user.
    StraightLine,
    /// The best known mission.
    Search,
    /// The certified upper bound of any mission.
    Bound,
    /// Hovering over the centre of all nodes, serving the nearest admissible user.
    FixedPosition,
    /// SAC's policy; users send with full power or not at all.
    FixedUserPower,
    /// SAC's policy; sensors send with full power.
    FixedSensorPower,
}

impl Approach {
    /// Returns the name for legends and tables.
    pub fn title(self) -> &'static str {
        match self {
            Self::Sac => "SAC",
            Self::SacTableOne => "SAC, Table I",
            Self::Ddpg => "DDPG",
            Self::StraightLine => "straight line",
            Self::Search => "search",
            Self::Bound => "certified bound",
            Self::FixedPosition => "fixed position",
            Self::FixedUserPower => "fixed user power",
            Self::FixedSensorPower => "fixed sensor power",
        }
    }

    /// Returns the appearance, which is the same in every figure.
    fn look(self) -> Look {
        LOOKS[match self {
            Self::Sac => 0,
            Self::Ddpg | Self::FixedPosition => 1,
            Self::StraightLine | Self::FixedUserPower => 2,
            Self::Search | Self::FixedSensorPower => 3,
            Self::SacTableOne => 4,
            Self::Bound => 5,
        }]
    }

    /// Returns the learner of the approach, if it has one.
    fn learner(self) -> Option<Learner> {
        match self {
            Self::Sac | Self::FixedUserPower | Self::FixedSensorPower => Some(Learner::Sac),
            Self::SacTableOne => Some(Learner::SacTableOne),
            Self::Ddpg => Some(Learner::Ddpg),
            Self::StraightLine | Self::Search | Self::Bound | Self::FixedPosition => None,
        }
    }

    fn inner(self) -> Allocation {
        match self {
            Self::FixedUserPower => Allocation::FixedUserPower(None),
            Self::FixedSensorPower => Allocation::FixedSensorPower(None),
            _ => Allocation::Exact,
        }
    }
}

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
    /// The number of policies of different seeds that were flown.
    pub runs: usize,
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
}

impl TotalRow {
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
        Bound, Ddpg, FixedPosition, FixedSensorPower, FixedUserPower, Sac, SacTableOne, Search,
        StraightLine,
    };
    match experiment {
        Experiment::Noise => &[Sac],
        Experiment::Strategies => &[Sac, FixedPosition, FixedUserPower, FixedSensorPower],
        Experiment::MissionTime => &[Sac, FixedPosition, FixedUserPower, FixedSensorPower, Bound],
        _ => &[Sac, SacTableOne, Ddpg, StraightLine, Search, Bound],
    }
}

/// One flight that a figure needs.
struct FlightJob {
    cell: Cell,
    approach: Approach,
    policy: PolicyChoice,
}

/// Flies and certifies everything that a figure shows.
pub(super) fn measure(
    experiment: Experiment,
    context: &mut ExperimentContext<'_>,
) -> Result<Vec<TotalRow>, String> {
    let mut trainings: Vec<(Cell, Approach, Training)> = Vec::new();
    let mut jobs = Vec::new();
    let mut plan = Vec::new();
    for cell in cells(experiment) {
        for &approach in approaches(experiment) {
            let policy = match approach {
                Approach::StraightLine => PolicyChoice::StraightLine,
                Approach::FixedPosition => PolicyChoice::Fixed,
                _ => {
                    if let Some(learner) = approach.learner() {
                        let seeds = context.seeds(cell, learner);
                        let seeds = seeds.into_iter();
                        trainings.extend(seeds.map(|training| (cell, approach, training)));
                    }
                    plan.push((cell, approach));
                    continue;
                }
            };
            plan.push((cell, approach));
            jobs.push(FlightJob {
                cell,
                approach,
                policy,
            });
        }
    }
    let wanted: Vec<Training> = trainings.iter().map(|(.., training)| *training).collect();
    let files = context.policies(&wanted)?;
    for ((cell, approach, _), file) in trainings.into_iter().zip(files) {
        jobs.push(FlightJob {
            cell,
            approach,
            policy: PolicyChoice::File(file),
        });
    }
    let flown: Result<Vec<Summary>, String> = jobs
        .par_iter()
        .map(|sortie| {
            let FlightJob {
                cell,
                approach,
                policy,
            } = sortie;
            Ok(context.fly(cell, policy, approach.inner())?.summary())
        })
        .collect();
    let flown = flown?;
    let mut rows = Vec::new();
    for (cell, approach) in plan {
        let summaries = jobs
            .iter()
            .zip(&flown)
            .filter(|(sortie, _)| sortie.cell == cell && sortie.approach == approach);
        let summaries: Vec<&Summary> = summaries.map(|(_, summary)| summary).collect();
        rows.push(match approach {
            Approach::Search => certified(cell, approach, context.bound(&cell)?.lower),
            Approach::Bound => certified(cell, approach, context.bound(&cell)?.upper),
            _ => total(cell, approach, &summaries),
        });
    }
    Ok(rows)
}

fn certified(cell: Cell, approach: Approach, sum_rate: f64) -> TotalRow {
    TotalRow {
        topology: cell.topology,
        mission_time_s: cell.slots,
        noise_dbm: cell.noise_dbm,
        mse_threshold: cell.mse_threshold,
        approach,
        runs: 1,
        sum_rate: rounded(sum_rate),
        interval_95: None,
        sum_rate_max: rounded(sum_rate),
        missed_slots: 0.0,
        constraints_held: true,
    }
}

fn total(cell: Cell, approach: Approach, flights: &[&Summary]) -> TotalRow {
    let rates: Vec<f64> = flights.iter().map(|flight| flight.sum_rate).collect();
    let missed: Vec<f64> = flights
        .iter()
        .map(|flight| flight.mse_violations as f64)
        .collect();
    TotalRow {
        runs: flights.len(),
        interval_95: statistics::half_width_95(&rates).map(rounded),
        sum_rate_max: rounded(range(rates.iter().copied()).1),
        missed_slots: rounded(statistics::mean(&missed)),
        constraints_held: flights
            .iter()
            .all(|flight| flight.arrived && flight.fair && flight.constraint_violations == 0),
        ..certified(cell, approach, statistics::mean(&rates))
    }
}

/// Draws one panel per topology; for `approaches` one per topology and noise power.
pub(super) fn figure(experiment: Experiment, rows: &[TotalRow]) -> Figure {
    let over_time = experiment == Experiment::MissionTime;
    let noises: &[Option<f64>] = match experiment {
        Experiment::Approaches => &[Some(NOISE_DBM), Some(HIGH_NOISE_DBM)],
        _ => &[None],
    };
    let mut panels = Vec::new();
    for &noise in noises {
        for topology in Topology::ALL {
            let here: Vec<&TotalRow> = rows
                .iter()
                .filter(|row| row.topology == topology)
                .filter(|row| noise.is_none_or(|noise| row.noise_dbm == noise))
                .collect();
            if here.is_empty() {
                continue;
            }
            let abscissa = |row: &TotalRow| match over_time {
                true => f64::from(row.mission_time_s),
                false => row.mse_threshold,
            };
            let mut title = topology.title().to_owned();
            if let Some(noise) = noise {
                let _ = write!(title, ", {noise} dBm");
            }
            let x = Axis {
                digits: if over_time { 0 } else { 3 },
                ..Axis::around(
                    if over_time {
                        "mission time, s"
                    } else {
                        "MSE threshold Gamma"
                    },
                    here.iter().map(|row| abscissa(row)),
                    0,
                )
            };
            let rates = here.iter().map(|row| row.sum_rate);
            panels.push(Panel {
                title,
                x: Axis { ticks: 5, ..x },
                y: Axis::around("total rate, bit/s/Hz", rates, 0).with_zero(),
                series: series(experiment, &here, abscissa),
                legend: SeriesLabelPosition::UpperLeft,
            });
        }
    }
    Figure {
        columns: panels.len().min(2),
        panels,
        size: (500, 400),
    }
}

fn series(
    experiment: Experiment,
    rows: &[&TotalRow],
    abscissa: impl Fn(&TotalRow) -> f64,
) -> Vec<Series> {
    let of = |name: String, look: Look, chosen: &dyn Fn(&TotalRow) -> bool| {
        let chosen: Vec<&&TotalRow> = rows.iter().filter(|row| chosen(row)).collect();
        let points = chosen
            .iter()
            .map(|row| (abscissa(row), row.sum_rate))
            .collect();
        let band = chosen.iter().map(|row| {
            let half = row.interval_95.unwrap_or(0.0);
            ((row.sum_rate - half).max(0.0), row.sum_rate + half)
        });
        let band = match chosen.iter().any(|row| row.interval_95.is_some()) {
            true => band.collect(),
            false => Vec::new(),
        };
        Series {
            band,
            ..Series::new(name, look, points)
        }
    };
    if experiment == Experiment::Noise {
        return [NOISE_DBM, HIGH_NOISE_DBM]
            .into_iter()
            .zip(LOOKS)
            .map(|(noise, look)| {
                of(format!("SAC, {noise} dBm"), look, &|row| {
                    row.noise_dbm == noise
                })
            })
            .collect();
    }
    approaches(experiment)
        .iter()
        .map(|&approach| {
            of(approach.title().into(), approach.look(), &|row| {
                row.approach == approach
            })
        })
        .filter(|series| !series.points.is_empty())
        .collect()
}
