//! Figures of total rates: every approach on every mission of a figure.

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
    claims::{Claim, Tally, Verdict, range},
    figure::{Axis, Figure, LOOKS, Look, Panel, Series},
    laboratory::Laboratory,
    rounded, statistics,
};
use crate::{allocation::Allocation, policy::PolicyChoice, record::Summary};

/// How a mission is decided, or what it is measured against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Approach {
    /// SAC with the settings that were found best.
    Sac,
    /// SAC with Table I's settings.
    SacTableOne,
    /// DDPG with Table I's settings.
    Ddpg,
    /// Straight to the destination, the nearest admissible user.
    StraightLine,
    /// The best mission known.
    Search,
    /// What no mission exceeds.
    Bound,
    /// Hovering over the middle of all nodes, the nearest admissible user.
    FixedPosition,
    /// SAC's policy, users sending with full power or not at all.
    FixedUserPower,
    /// SAC's policy, sensors sending with full power.
    FixedSensorPower,
}

impl Approach {
    /// For legends and tables.
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

    /// The same look in every figure.
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

    /// What learns, if anything does.
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
    /// Of the mission.
    pub topology: Topology,
    /// `T`, seconds.
    pub mission_time_s: u32,
    /// `sigma^2`, dBm.
    pub noise_dbm: f64,
    /// `Gamma`.
    pub mse_threshold: f64,
    /// Who decided.
    pub approach: Approach,
    /// Policies of different seeds that were flown.
    pub runs: usize,
    /// Sum of the rates, bit/s/Hz, the mean over the runs.
    pub sum_rate: f64,
    /// Half the width of its 95 % interval.
    pub interval_95: Option<f64>,
    /// The best run's.
    pub sum_rate_max: f64,
    /// Slots in which `Gamma` was missed, the mean over the runs.
    pub missed_slots: f64,
    /// Whether every run arrived, was fair and broke no limit.
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

/// The missions of a figure.
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

/// The approaches of a figure, in the paper's order.
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

/// Whether an approach is trained on a mission: with more noise only SAC is held against the bound.
fn is_compared(cell: &Cell, approach: Approach) -> bool {
    let at_low_noise_only = matches!(approach, Approach::SacTableOne | Approach::Ddpg);
    !at_low_noise_only || cell.noise_dbm == NOISE_DBM
}

/// One flight that a figure needs.
struct Sortie {
    cell: Cell,
    approach: Approach,
    policy: PolicyChoice,
}

/// Flies and certifies all that a figure shows.
pub(super) fn measure(
    experiment: Experiment,
    laboratory: &mut Laboratory<'_>,
) -> Result<Vec<TotalRow>, String> {
    let mut trainings: Vec<(Cell, Approach, Training)> = Vec::new();
    let mut sorties = Vec::new();
    let mut plan = Vec::new();
    for cell in cells(experiment) {
        for &approach in approaches(experiment) {
            if !is_compared(&cell, approach) {
                continue;
            }
            plan.push((cell, approach));
            let policy = match approach {
                Approach::StraightLine => PolicyChoice::StraightLine,
                Approach::FixedPosition => PolicyChoice::Fixed,
                _ => {
                    if let Some(learner) = approach.learner() {
                        let seeds = laboratory.seeds(cell, learner).into_iter();
                        trainings.extend(seeds.map(|training| (cell, approach, training)));
                    }
                    continue;
                }
            };
            sorties.push(Sortie {
                cell,
                approach,
                policy,
            });
        }
    }
    let wanted: Vec<Training> = trainings.iter().map(|(.., training)| *training).collect();
    let files = laboratory.policies(&wanted)?;
    for ((cell, approach, _), file) in trainings.into_iter().zip(files) {
        sorties.push(Sortie {
            cell,
            approach,
            policy: PolicyChoice::File(file),
        });
    }
    let flown: Result<Vec<Summary>, String> = sorties
        .par_iter()
        .map(|sortie| {
            let Sortie {
                cell,
                approach,
                policy,
            } = sortie;
            Ok(laboratory.fly(cell, policy, approach.inner())?.summary())
        })
        .collect();
    let flown = flown?;
    let mut rows = Vec::new();
    for (cell, approach) in plan {
        let summaries = sorties
            .iter()
            .zip(&flown)
            .filter(|(sortie, _)| sortie.cell == cell && sortie.approach == approach);
        let summaries: Vec<&Summary> = summaries.map(|(_, summary)| summary).collect();
        rows.push(match approach {
            Approach::Search => certified(cell, approach, laboratory.bound(&cell)?.lower),
            Approach::Bound => certified(cell, approach, laboratory.bound(&cell)?.upper),
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

/// One panel per topology; for `approaches` per topology and noise power.
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

/// Rows of one approach, found by mission.
struct Totals<'a>(&'a [TotalRow]);

impl Totals<'_> {
    fn row(&self, cell: &Cell, approach: Approach) -> Option<&TotalRow> {
        let mut of_cell = self.0.iter().filter(|row| row.is_of(cell));
        of_cell.find(|row| row.approach == approach)
    }

    fn rate(&self, cell: &Cell, approach: Approach) -> f64 {
        self.row(cell, approach)
            .map_or(f64::NAN, |row| row.sum_rate)
    }

    /// The better of SAC's two presets, by their means.
    fn sac(&self, cell: &Cell) -> f64 {
        let tuned = self.rate(cell, Approach::Sac);
        // NaN where Table I's settings were not trained: then the other counts.
        tuned.max(self.rate(cell, Approach::SacTableOne))
    }
}

/// What an approach reaches of another over the cells, in per cent.
fn shares(
    totals: &Totals<'_>,
    cells: &[Cell],
    of: impl Fn(&Cell) -> f64,
    reference: Approach,
) -> String {
    let (low, high) = range(
        cells
            .iter()
            .map(|cell| of(cell) / totals.rate(cell, reference)),
    );
    format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high)
}

/// How often a total rises from each mission to the next of the same kind.
fn rises(
    totals: &Totals<'_>,
    cells: &[Cell],
    approach: Approach,
    same_kind: impl Fn(&Cell, &Cell) -> bool,
) -> Tally {
    let mut tally = Tally::default();
    for pair in cells
        .windows(2)
        .filter(|pair| same_kind(&pair[0], &pair[1]))
    {
        let (before, after) = (
            totals.rate(&pair[0], approach),
            totals.rate(&pair[1], approach),
        );
        if !before.is_nan() && !after.is_nan() {
            tally.add(after > before);
        }
    }
    tally
}

fn same_topology_and_noise(a: &Cell, b: &Cell) -> bool {
    a.topology == b.topology && a.noise_dbm == b.noise_dbm
}

/// fig:alg.
pub(super) fn claims_of_approaches(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::Approaches));
    let quiet: Vec<Cell> = cells
        .iter()
        .copied()
        .filter(|cell| cell.noise_dbm == NOISE_DBM)
        .collect();
    let mut rising = Tally::default();
    for &approach in approaches(Experiment::Approaches) {
        let tally = rises(&totals, &cells, approach, same_topology_and_noise);
        rising.holding += tally.holding;
        rising.cases += tally.cases;
    }
    let (mut best, mut between, mut near) = <(Tally, Tally, Tally)>::default();
    let mut near_quiet = Tally::default();
    for cell in &cells {
        let ddpg = totals.rate(cell, Approach::Ddpg);
        let straight = totals.rate(cell, Approach::StraightLine);
        best.add(totals.sac(cell) > straight);
        if !ddpg.is_nan() {
            best.add(totals.sac(cell) > ddpg);
            between.add(ddpg > straight);
        }
        let search = totals.rate(cell, Approach::Search);
        let bound = totals.rate(cell, Approach::Bound);
        let is_near = totals.sac(cell) >= 0.97 * search && totals.sac(cell) >= 0.95 * bound;
        near.add(is_near);
        if cell.noise_dbm == NOISE_DBM {
            near_quiet.add(is_near);
        }
    }
    vec![
        Claim::new(
            "The total grows with the threshold, for every approach.",
            rising.verdict(),
            format!("It rises in {rising} steps."),
            "",
        ),
        Claim::new(
            "SAC is best, above DDPG and above the straight line.",
            best.verdict(),
            format!(
                "The better preset of SAC is above in {best} comparisons; SAC comes to {} of the \
                 certified bound, with Table I's settings to {}.",
                shares(
                    &totals,
                    &cells,
                    |cell| totals.rate(cell, Approach::Sac),
                    Approach::Bound
                ),
                shares(
                    &totals,
                    &quiet,
                    |cell| totals.rate(cell, Approach::SacTableOne),
                    Approach::Bound
                ),
            ),
            "",
        ),
        Claim::new(
            "DDPG is slightly inferior; the straight line is far behind.",
            between.verdict(),
            format!(
                "DDPG comes to {} of the certified bound, the straight line to {}; DDPG is above \
                 it in {between} cells.",
                shares(
                    &totals,
                    &cells,
                    |cell| totals.rate(cell, Approach::Ddpg),
                    Approach::Bound
                ),
                shares(
                    &totals,
                    &cells,
                    |cell| totals.rate(cell, Approach::StraightLine),
                    Approach::Bound
                ),
            ),
            "At the loosest threshold DDPG flies along the edge of the area (fig:topo_ddpg): its policy \
             has settled at the limits of its action.",
        ),
        Claim::new(
            "SAC comes close to a global search.",
            near.verdict(),
            format!(
                "The better preset comes to {} of the best known mission and {} of the certified \
                 bound; at least 97 % and 95 % in {near} cells, at {NOISE_DBM} dBm in {}.",
                shares(&totals, &cells, |cell| totals.sac(cell), Approach::Search),
                shares(&totals, &cells, |cell| totals.sac(cell), Approach::Bound),
                near_quiet,
            ),
            "At -85 dBm rates vary more over the area, so that the order of service matters more; \
             these are trainings of one seed with settings that were found at -95 dBm.",
        ),
        Claim::new(
            "With more noise SAC's lead over DDPG grows.",
            Verdict::Open,
            "Not measured.".into(),
            "DDPG has not been trained at -85 dBm.",
        ),
    ]
}

/// fig:sigma.
pub(super) fn claims_of_noise(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::Noise));
    let mut falls = Tally::default();
    let mut losses = Vec::new();
    for cell in cells.iter().filter(|cell| cell.noise_dbm == NOISE_DBM) {
        let quiet = totals.rate(cell, Approach::Sac);
        let noisy = totals.rate(&cell.at_noise(HIGH_NOISE_DBM), Approach::Sac);
        falls.add(noisy < quiet);
        losses.push(100.0 * (1.0 - noisy / quiet));
    }
    let rising = rises(&totals, &cells, Approach::Sac, same_topology_and_noise);
    let (least, most) = range(losses);
    vec![
        Claim::new(
            "The total falls with noise, in both topologies and at every threshold.",
            falls.verdict(),
            format!("It falls in {falls} cells, by {least:.1} to {most:.1} %."),
            "",
        ),
        Claim::new(
            "It grows with the threshold at either noise power.",
            rising.verdict(),
            format!("It rises in {rising} steps."),
            "",
        ),
    ]
}

/// fig:diffing.
pub(super) fn claims_of_strategies(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::Strategies));
    let growth = |approach: Approach| {
        let each = Topology::ALL.map(|topology| {
            let at = |index: usize| {
                let cell = Cell::table_one(topology).at_threshold(MSE_THRESHOLDS[index]);
                totals.rate(&cell, approach)
            };
            (at(3) / at(2) - 1.0, at(1) / at(0) - 1.0)
        });
        each.map(|(late, early)| (100.0 * late, 100.0 * early))
    };
    let mut levels_off = Tally::default();
    let sensor = growth(Approach::FixedSensorPower);
    for ((late, _), (sac_late, _)) in sensor.iter().zip(growth(Approach::Sac)) {
        levels_off.add(*late < 0.5 * sac_late);
    }
    let missed = rows
        .iter()
        .filter(|row| row.approach == Approach::FixedSensorPower)
        .map(|row| row.missed_slots);
    let (fewest, most) = range(missed);
    vec![
        best_of_strategies(&totals, &cells),
        Claim::new(
            "With fixed sensor power the total levels off as the threshold grows.",
            levels_off.verdict(),
            format!(
                "From 0.020 to 0.025 it grows by {:.1} % (separated) and {:.1} % (mixed); in \
                 {fewest:.0} to {most:.0} of 60 slots sensors of equal power cannot meet the \
                 threshold at all, and such a slot carries nothing.",
                sensor[0].0, sensor[1].0
            ),
            "Sensors that all send with full power arrive with unequal amplitudes, which alone \
             exceeds a tight threshold; a looser one lets more slots through, so the total grows \
             with it. The paper gives neither the power nor what a slot counts that misses Gamma.",
        ),
    ]
}

fn best_of_strategies(totals: &Totals<'_>, cells: &[Cell]) -> Claim {
    const FIXED: [Approach; 3] = [
        Approach::FixedPosition,
        Approach::FixedUserPower,
        Approach::FixedSensorPower,
    ];
    let mut best = Tally::default();
    let mut text = String::new();
    for approach in FIXED {
        for cell in cells {
            best.add(totals.rate(cell, Approach::Sac) > totals.rate(cell, approach));
        }
        let of_sac = shares(
            totals,
            cells,
            |cell| totals.rate(cell, approach),
            Approach::Sac,
        );
        let _ = write!(text, " {}: {of_sac} of SAC's total.", approach.title());
    }
    Claim::new(
        "SAC is best, with an evident gap to every scheme that holds something fixed.",
        best.verdict(),
        format!("Above in {best} comparisons.{text}"),
        "",
    )
}

/// fig:diffint.
pub(super) fn claims_of_mission_time(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::MissionTime));
    let rising = rises(&totals, &cells, Approach::Sac, |a, b| {
        a.topology == b.topology
    });
    let per_second: Vec<f64> = cells
        .iter()
        .map(|cell| totals.rate(cell, Approach::Sac) / f64::from(cell.slots))
        .collect();
    let (low, high) = range(per_second);
    vec![
        best_of_strategies(&totals, &cells),
        Claim::new(
            "The total grows with the mission time.",
            rising.verdict(),
            format!(
                "It rises in {rising} steps, at {low:.3} to {high:.3} bit/s/Hz per slot; SAC comes \
                 to {} of the certified bound.",
                shares(
                    &totals,
                    &cells,
                    |cell| totals.rate(cell, Approach::Sac),
                    Approach::Bound
                ),
            ),
            "",
        ),
    ]
}
