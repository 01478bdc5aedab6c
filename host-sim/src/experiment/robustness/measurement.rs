//! Measures the tables, and draws them.

use std::path::Path;

use serde::de::DeserializeOwned;

use super::{
    drawing,
    error_kind::ErrorKind,
    flights::{Flown, Missions, fly_all, known_totals, seeds_of},
    moving::{self, MovingRow},
    row::{Extent, Group, MOVING, NAME, OUTAGE, Pilot, RobustnessRow},
};
use crate::experiment::{Watcher, rounded, statistics, table};

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
                return Err(files::named(&path, error));
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
