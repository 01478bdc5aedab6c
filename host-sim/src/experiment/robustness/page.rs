//! The section of `docs/results.md`.

use std::{fmt::Write as _, path::Path};

use super::{
    error_kind::ErrorKind,
    moving::MovingRow,
    row::{Group, MOVING, NAME, OUTAGE, Pilot, RobustnessRow},
};
use crate::experiment::table;

/// Returns the section, with links to drawings that start with `figures`; nothing if it was not
/// measured to the end.
///
/// # Errors
/// Returns a message of one line if a CSV file has other columns.
pub fn section(directory: &Path, figures: &str) -> Result<String, String> {
    let [path, moving] = [NAME, MOVING].map(|stem| directory.join(format!("{stem}.csv")));
    if !(path.exists() && moving.exists()) {
        return Ok(String::new());
    }
    let rows: Vec<RobustnessRow> = table::read(&path)?;
    let moving: Vec<MovingRow> = table::read(&moving)?;
    let missions = rows.iter().map(|row| row.missions).max().unwrap_or(0);
    let seeds = rows.iter().map(|row| row.seeds).max().unwrap_or(0);
    let mut text = format!(
        "\n## A world that is not known exactly\n\n\
         `host-sim experiment robustness --out docs/figures --results docs/results.md` flies the two shipped \
         missions and {missions}\nbenchmark missions in worlds with one kind of error at a time \
         ([formats.md](formats.md#uncertainty)), {seeds} seeds each.\n\n\
         * The share is the total rate over that of the planner in the known world, with its 95 % \
         interval: over the seeds of a\n  shipped mission, over the missions of the benchmark. Expected MSE \
         and achievable rate average over estimation and\n  phase errors, so no seed matters to these.\n\
         * The outage is the fraction of slots whose expected MSE is above Gamma; \"over\" is by how much \
         at most.\n\
         * \"errors ignored\": the vehicle does not learn how good the estimates are. Only estimation and phase \
         errors have\n  statistics that a pilot signal gives.\n\
         * Broken constraints are speed, area, arrival and quotas: {} in all flights.\n\n\
         ![{NAME}]({figures}{NAME}.svg)\n\n![{OUTAGE}]({figures}{OUTAGE}.svg)\n",
        rows.iter().map(|row| row.broken).sum::<usize>()
    );
    for kind in ErrorKind::ALL {
        let levels = &kind.levels()[1..];
        let _ = write!(
            text,
            "\n### {}\n\n| missions | who flies |",
            capitalized(kind.axis())
        );
        for level in levels {
            let _ = write!(text, " {level} |");
        }
        let _ = writeln!(text, "\n|---|---|{}", "---|".repeat(levels.len()));
        for group in Group::ALL {
            for pilot in Pilot::ALL {
                for robust in [true, false] {
                    let of_line: Vec<&RobustnessRow> = (rows.iter())
                        .filter(|row| (row.group, row.kind) == (group, kind) && row.level > 0.0)
                        .filter(|row| (row.pilot, row.robust) == (pilot, robust))
                        .collect();
                    if of_line.is_empty() {
                        continue;
                    }
                    let ignored = if robust { "" } else { ", errors ignored" };
                    let _ = write!(text, "| {} | {pilot}{ignored} |", group.title());
                    for row in of_line {
                        let _ = write!(text, " {} |", cell(row));
                    }
                    text.push('\n');
                }
            }
        }
    }
    text += &of_moving(&moving);
    Ok(text)
}

fn cell(row: &RobustnessRow) -> String {
    let mut cell = interval(row.share, row.share_interval_95);
    if row.outage > 0.0 {
        let _ = write!(cell, ", outage {:.3}", row.outage);
        if row.excess > 0.0 {
            let _ = write!(cell, " (over {:.0} %)", 100.0 * row.excess);
        }
    }
    cell
}

fn interval(value: f64, half: Option<f64>) -> String {
    match half {
        Some(half) => format!("{value:.3} ± {half:.3}"),
        None => format!("{value:.3}"),
    }
}

fn of_moving(rows: &[MovingRow]) -> String {
    let mut text = String::from(
        "\n### Walking users and silent sensors\n\n\
         All users walk at up to 5 m/s, and every sensor is silent in a slot with probability 0.1. The \
         share is that of a plan\nwhich knew all motion from the start (math: `planning::hindsight`).\n\n\
         | missions | policy | mean | worst | outage | constraints broken |\n|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let _ = writeln!(
            text,
            "| {} | {} | {} | {:.3} | {:.3} | {} |",
            row.group.title(),
            row.policy,
            interval(row.share, row.share_interval_95),
            row.worst,
            row.outage,
            row.broken
        );
    }
    text
}

fn capitalized(words: &str) -> String {
    let mut letters = words.chars();
    let first = letters
        .next()
        .map(|letter| letter.to_uppercase().to_string());
    first.unwrap_or_default() + letters.as_str()
}
