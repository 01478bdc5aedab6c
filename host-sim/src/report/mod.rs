//! The report of a flight, as files:
//!
//! | file | purpose |
//! |---|---|
//! | `summary.json` | the [`Summary`], for scripts |
//! | `slots.csv` | one row per slot, with units in the column names |
//! | `report.html` | one page with figures and tables; it loads nothing from the network |
//! | `map.svg` | the page's map as a separate file, for documents |
//!
//! `summary.json` is written last, so a directory that contains it contains a complete report. Only
//! these four files of a directory are written or deleted.
//!
//! Users are numbered from 0, as in the scenario file and in `slots.csv`; slots are numbered from 1,
//! as in the paper.

mod facts;
mod flown_path;
mod ground;
mod map;
mod page;
mod schedule;
mod series;
pub(crate) mod slots_csv;
mod table;

#[cfg(test)]
pub(crate) mod fixture;
#[cfg(test)]
mod tests;

use std::{fs, io, path::Path};

use figures::{axis::SlotAxis, quantity};
use files::output::{self, Draft};
use firmware_core::inner::LimitedBy;

use crate::record::{FlightRecord, KnowledgeSummary, SlotRecord, Summary};
use scenario::Scenario;

pub use table::{Look, table};

/// Returns the fraction that the total is of the ideal flight's, and of what it is a fraction, if
/// the ideal flight was flown.
fn of_ideal_flight(summary: &Summary) -> Option<(String, String)> {
    let ideal = summary.ideal_sum_rate.filter(|ideal| *ideal > 0.0)?;
    let ideal_rate = quantity::significant(ideal, 4);
    Some((
        quantity::percent(summary.sum_rate / ideal),
        format!("of {ideal_rate}, the same policy with the ideal vehicle"),
    ))
}

/// Returns the fraction that the total is of the certified bound, and of what it is a fraction, if
/// the bound was asked for.
fn of_certified_bound(summary: &Summary) -> Option<(String, String)> {
    let (bound, fraction) = (
        summary.certified_bound.as_ref()?,
        summary.fraction_of_bound?,
    );
    let upper = quantity::significant(bound.upper, 4);
    let source = match &bound.file {
        Some(file) => format!("from {file}"),
        None => "computed for this flight".into(),
    };
    Some((quantity::percent(fraction), format!("of {upper}, {source}")))
}

/// Returns what it cost that the world was not known exactly: names, values and explanations.
fn of_knowledge(knowledge: &KnowledgeSummary) -> Vec<(&'static str, String, String)> {
    let mut facts = vec![
        (
            "outage",
            quantity::percent(knowledge.outage),
            format!(
                "of slots expected above Γ, {} measured",
                quantity::percent(knowledge.empirical_outage)
            ),
        ),
        (
            "rate lost",
            format!("{} bit/s/Hz", quantity::significant(knowledge.rate_lost, 3)),
            format!(
                "against {} with perfect knowledge",
                quantity::significant(knowledge.perfect_sum_rate, 4)
            ),
        ),
    ];
    if knowledge.error_floor_slots > 0 {
        let slots = quantity::count(knowledge.error_floor_slots, "slot");
        facts.push((
            "error floor",
            slots,
            "known too poorly for Γ at any power".into(),
        ));
    }
    if knowledge.errors_ignored {
        let words = "estimates were taken for exact".into();
        facts.push(("errors", "ignored".into(), words));
    }
    facts
}

/// Returns how the rates at the flown positions compare with those at the waypoints.
fn against_waypoints(summary: &Summary, decimals: usize) -> String {
    let lost = summary.planned_vs_flown_rate;
    format!(
        "{} bit/s/Hz {} than at the waypoints",
        quantity::decimal(lost.abs(), decimals),
        if lost < 0.0 { "more" } else { "less" }
    )
}

/// The file that is written last.
const SUMMARY: &str = "summary.json";
/// All files of a report. The file that marks a report as complete is deleted first.
const FILES: [&str; 4] = [SUMMARY, "report.html", "slots.csv", "map.svg"];

/// Prepares a directory for a report before the flight: creates it, checks that files can be written,
/// and deletes the report of an earlier run, so that it cannot be taken for the report of a flight
/// that fails.
///
/// # Errors
/// Returns an error if the directory is a file or cannot be created or written to; the message names
/// it.
pub fn prepare(folder: &Path) -> io::Result<()> {
    let named = |error: io::Error| name(folder, error);
    if folder.exists() && !folder.is_dir() {
        let problem = io::Error::new(
            io::ErrorKind::NotADirectory,
            "is a file, but must be a directory for the report",
        );
        return Err(named(problem));
    }
    fs::create_dir_all(folder).map_err(named)?;
    output::probe(folder).map_err(named)?;
    for file in FILES {
        let path = folder.join(file);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(name(&path, error));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Writes the report of a flight into a directory, replaces an earlier report, and returns the
/// summary. All files are complete before the first one gets its final name.
///
/// # Errors
/// Returns an error under the conditions of [`prepare`], or if a file cannot be written; incomplete
/// files are deleted.
pub fn write(record: &FlightRecord, folder: &Path) -> io::Result<Summary> {
    prepare(folder)?;
    let summary = record.summary();
    let mut json = serde_json::to_vec_pretty(&summary)?;
    json.push(b'\n');
    let files = [
        ("slots.csv", slots_csv::csv(record)?),
        ("map.svg", map_svg(record).into_bytes()),
        ("report.html", html(record, &summary).into_bytes()),
        (SUMMARY, json),
    ];
    let drafts = files.iter().map(|(file, bytes)| {
        let path = folder.join(file);
        Draft::write(&path, bytes).map_err(|error| name(&path, error))
    });
    // All temporary files are complete before the first one is renamed; the others are deleted after an
    // error.
    let drafts = drafts.collect::<io::Result<Vec<_>>>()?;
    for (draft, (file, _)) in drafts.into_iter().zip(&files) {
        let named = |error| name(&folder.join(file), error);
        draft.publish().map_err(named)?;
    }
    Ok(summary)
}

/// Returns the error with the path before its message.
fn name(path: &Path, error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Returns the contents of `report.html`.
pub fn html(record: &FlightRecord, summary: &Summary) -> String {
    page::html(record, summary)
}

/// Returns the map of a flight as an SVG file.
pub fn map_svg(record: &FlightRecord) -> String {
    let summary = record.summary();
    let name = format!("{} · {}", record.scenario.name, record.policy);
    let words = format!(
        "{} bit/s/Hz in {}, {} of the physical limit",
        quantity::significant(summary.sum_rate, 3),
        quantity::count(summary.slots, "slot"),
        quantity::percent(summary.sum_rate / summary.sum_rate_physical_limit),
    );
    map::draw(&record.scenario, Some(record), Some([&name, &words])).to_string()
}

/// Returns the map of a scenario without a flight as an SVG file.
pub fn scenario_svg(scenario: &Scenario) -> String {
    let mission = &scenario.mission;
    let words = format!(
        "{}, {}, {}",
        quantity::count(mission.user_count(), "user"),
        quantity::count(mission.sensor_count(), "sensor"),
        quantity::count(mission.slots() as usize, "slot"),
    );
    map::draw(scenario, None, Some([&scenario.name, &words])).to_string()
}

/// Describes a slot in one line.
fn slot_words(record: &FlightRecord, slot: &SlotRecord) -> String {
    let held_back = match (slot.feasible, slot.limited_by) {
        (false, _) => ", threshold out of reach",
        (true, LimitedBy::Accuracy) => ", limited by accuracy",
        (true, LimitedBy::Power) => ", limited by the user's power",
        (true, LimitedBy::None) => "",
    };
    let shield = match slots_csv::shield(&slot.intervention) {
        none if none == "none" => String::new(),
        changes => format!(", shield: {}", changes.replace('_', " ")),
    };
    let violated = match record.violates_mse(slot) {
        true => " (above the threshold)",
        false => "",
    };
    format!(
        "slot {}: user {}, {} bit/s/Hz, MSE {}{violated}{held_back}{shield}",
        slot.slot,
        slot.user_name(),
        quantity::significant(slot.rate, 4),
        quantity::significant(slot.mse, 4),
    )
}

/// Returns the axis over all slots of a mission, including those that an aborted flight did not
/// reach.
fn slot_axis(record: &FlightRecord) -> SlotAxis {
    let slots = record.scenario.mission.slots() as usize;
    SlotAxis::new(record.slots.len().max(slots))
}
