//! What happens to totals and outage when the world is not known exactly: one kind of error at a
//! time, for planner, SAC and straight line, with allocations that know the statistics of the errors
//! (robust) and that ignore them (naive).
//!
//! Measured once into `robustness.csv` and `moving.csv`; drawings and tables are made from these.

mod drawing;
mod error_kind;
mod flights;
mod moving;
mod page;

use std::{fmt, path::Path};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{Watcher, rounded, statistics, table};
use crate::policy::PolicyChoice;
use flights::{Flown, Missions, PlannedMission, fly_all, known_totals, seeds_of};

pub use error_kind::ErrorKind;
pub use moving::MovingRow;
pub use page::section;

/// The name on the command line, and the stem of the files.
pub const NAME: &str = "robustness";
/// The stem of the file of flights with moving users and silent sensors.
const MOVING: &str = "moving";
/// The stem of the drawing of outages.
const OUTAGE: &str = "robustness-outage";

/// Who flies, and what the allocation knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pilot {
    /// The onboard planner, which plans again in flight.
    Planner,
    /// The shipped policy: SAC with Table I's settings, trained for the known world. For the shipped
    /// missions only.
    Sac,
    /// The fair straight line.
    StraightLine,
}

impl Pilot {
    /// All pilots.
    pub const ALL: [Self; 3] = [Self::Planner, Self::Sac, Self::StraightLine];

    fn policy(self) -> PolicyChoice {
        match self {
            Self::Planner => PolicyChoice::Plan,
            Self::Sac => PolicyChoice::Shipped,
            Self::StraightLine => PolicyChoice::StraightLine,
        }
    }
}

impl fmt::Display for Pilot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Planner => "planner",
            Self::Sac => "SAC",
            Self::StraightLine => "straight line",
        })
    }
}

/// The missions that are averaged over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Group {
    /// The shipped mission of Topo.1.
    Separated,
    /// The shipped mission of Topo.2.
    Mixed,
    /// Missions of the benchmark.
    Benchmark,
}

impl Group {
    /// All groups.
    pub const ALL: [Self; 3] = [Self::Separated, Self::Mixed, Self::Benchmark];

    fn title(self) -> &'static str {
        match self {
            Self::Separated => "separated",
            Self::Mixed => "mixed",
            Self::Benchmark => "benchmark",
        }
    }

    fn pilots(self) -> &'static [Pilot] {
        match self {
            Self::Benchmark => &[Pilot::Planner, Pilot::StraightLine],
            _ => &Pilot::ALL,
        }
    }
}

/// A row of `robustness.csv`: the mean over missions and seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobustnessRow {
    /// The missions.
    pub group: Group,
    /// The kind of error.
    pub kind: ErrorKind,
    /// Its level.
    pub level: f64,
    /// Who flew.
    pub pilot: Pilot,
    /// The vehicle knew the statistics of the errors.
    pub robust: bool,
    /// The number of missions.
    pub missions: usize,
    /// The number of seeds of the world, from 1.
    pub seeds: usize,
    /// The total rate over that of the planner in the known world.
    pub share: f64,
    /// Half the width of its 95 % confidence interval: over the seeds of a shipped mission, over the
    /// missions of the benchmark.
    pub share_interval_95: Option<f64>,
    /// The fraction of slots with an expected MSE above the threshold.
    pub outage: f64,
    /// Half the width of its 95 % confidence interval.
    pub outage_interval_95: Option<f64>,
    /// The rate that is lost against perfect knowledge at the same places, over the planner's total
    /// in the known world.
    pub lost_share: f64,
    /// The largest excess of an expected MSE over its threshold, relative to the threshold.
    pub excess: f64,
    /// The number of violated constraints of all flights, arrival and fairness included.
    pub broken: usize,
}

/// How much is flown.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// The number of benchmark missions, from the first.
    pub missions: usize,
    /// The number of seeds, from 1.
    pub seeds: u64,
}

/// Flies what a table of earlier measurements lacks, and hands each longer table to `save`.
fn measure(
    missions: &Missions,
    extent: Extent,
    mut rows: Vec<RobustnessRow>,
    watcher: &dyn Watcher,
    save: &dyn Fn(&[RobustnessRow]) -> Result<(), String>,
) -> Result<Vec<RobustnessRow>, String> {
    let known: Result<Vec<_>, String> = (missions.groups.iter())
        .map(|(_, missions)| known_totals(missions))
        .collect();
    let known = known?;
    for kind in ErrorKind::ALL {
        for ((group, missions), known) in missions.groups.iter().zip(&known) {
            if rows
                .iter()
                .any(|row| (row.group, row.kind) == (*group, kind))
            {
                continue;
            }
            watcher.busy(&format!("{}: {}", group.title(), kind.axis()));
            for level in kind.levels() {
                for &pilot in group.pilots() {
                    let naive = (kind.has_statistics() && level > 0.0).then_some(false);
                    for robust in [Some(true), naive].into_iter().flatten() {
                        let flown = fly_all(missions, (kind, level), (pilot, robust), extent)?;
                        rows.push(row(*group, (kind, level), (pilot, robust), &flown, known));
                    }
                }
            }
            save(&rows)?;
        }
    }
    Ok(rows)
}

fn row(
    group: Group,
    (kind, level): (ErrorKind, f64),
    (pilot, robust): (Pilot, bool),
    flown: &[Vec<Flown>],
    known: &[f64],
) -> RobustnessRow {
    let all = || flown.iter().flatten();
    // The interval is over what varies: seeds of one mission, or missions.
    let samples = |value: &dyn Fn(&Flown, f64) -> f64| -> Vec<f64> {
        let of_mission = flown.iter().zip(known).map(|(flights, &known)| {
            let values: Vec<f64> = flights.iter().map(|flight| value(flight, known)).collect();
            values
        });
        match flown {
            [_] => of_mission.flatten().collect(),
            _ => of_mission.map(|values| statistics::mean(&values)).collect(),
        }
    };
    let shares = samples(&|flight, known| flight.sum_rate / known);
    let outages = samples(&|flight, _| flight.outage);
    RobustnessRow {
        group,
        kind,
        level,
        pilot,
        robust,
        missions: flown.len(),
        seeds: flown.first().map_or(0, Vec::len),
        share: rounded(statistics::mean(&shares)),
        share_interval_95: statistics::half_width_95(&shares).map(rounded),
        outage: rounded(statistics::mean(&outages)),
        outage_interval_95: statistics::half_width_95(&outages).map(rounded),
        lost_share: rounded(statistics::mean(&samples(&|flight, known| {
            flight.lost / known
        }))),
        excess: rounded(all().map(|flight| flight.excess).fold(0.0, f64::max)),
        broken: all().map(|flight| flight.broken).sum(),
    }
}

/// Removes the CSV files of a directory, so that everything is measured again.
///
/// # Errors
/// Returns a message of one line if a file cannot be removed.
pub fn forget(out: &Path) -> Result<(), String> {
    for stem in [NAME, MOVING] {
        let path = out.join(format!("{stem}.csv"));
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(table::named(&path, error));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Measures everything into the CSV files of a directory. Rows that are there and were measured with
/// the same missions and seeds are kept, so an interrupted measurement goes on where it was.
///
/// # Errors
/// Returns a message of one line if a mission cannot be read or flown, or a file cannot be written.
pub fn write(
    benchmark: &Path,
    extent: Extent,
    out: &Path,
    watcher: &dyn Watcher,
) -> Result<(), String> {
    let missions = Missions::read(benchmark, extent)?;
    let path = out.join(format!("{NAME}.csv"));
    let rows: Vec<RobustnessRow> = earlier(&path, |row: &RobustnessRow| {
        missions.has(row.group, row.missions)
            && row.seeds as u64 == seeds_of(row.kind, row.level, extent)
    })?;
    measure(&missions, extent, rows, watcher, &|rows| {
        table::write(&path, rows)
    })?;
    let path = out.join(format!("{MOVING}.csv"));
    let rows: Vec<MovingRow> = earlier(&path, |row: &MovingRow| {
        missions.has(row.group, row.missions) && row.seeds as u64 == extent.seeds
    })?;
    moving::measure(&missions, extent, rows, watcher, &|rows| {
        table::write(&path, rows)
    })
}

/// Returns the rows of an earlier measurement: none if there is no file, or if a row has another
/// extent.
fn earlier<Row: DeserializeOwned>(
    path: &Path,
    fits: impl Fn(&Row) -> bool,
) -> Result<Vec<Row>, String> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let rows: Vec<Row> = table::read(path)?;
    Ok(if rows.iter().all(fits) {
        rows
    } else {
        Vec::new()
    })
}

/// Draws the CSV file of a directory: `robustness.svg` and `robustness-outage.svg`.
///
/// # Errors
/// Returns a message of one line if the file is missing or has other columns.
pub fn write_drawings(out: &Path) -> Result<(), String> {
    let rows: Vec<RobustnessRow> = table::read(&out.join(format!("{NAME}.csv")))?;
    for (stem, chart) in [
        (NAME, drawing::totals(&rows)),
        (OUTAGE, drawing::outage(&rows)),
    ] {
        table::write_text(&out.join(format!("{stem}.svg")), &chart.to_svg())?;
    }
    Ok(())
}
