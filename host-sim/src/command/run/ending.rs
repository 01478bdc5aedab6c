//! What a flight ends with: the report's files, the summary, and the exit code.

use std::{fs, io::Write, path::PathBuf};

use clap::Args;
use files::output;
use host_sim::{
    flight::{FailedFlight, FlightError},
    flight_log,
    record::{FlightRecord, Summary},
    report::{self, Look},
};

use super::progress::line;
use crate::command::Failure;

/// The options that select the output.
#[derive(Debug, Args)]
pub(super) struct OutputArguments {
    /// Output directory for summary.json, slots.csv, report.html, the MAVLink log and, while
    /// parameters of the vehicle are changed, their journal
    #[arg(long, default_value = "out", value_name = "DIR")]
    pub(super) out: PathBuf,
    /// Also write the flight as an MCAP log, which Foxglove opens (docs/formats.md)
    #[arg(long, value_name = "F.mcap")]
    mcap: Option<PathBuf>,
    /// Print only the contents of summary.json on standard output
    #[arg(long)]
    json: bool,
}

impl OutputArguments {
    /// Checks that the log can be written: better now than after the flight.
    pub(super) fn check_mcap(&self) -> Result<(), Failure> {
        let Some(path) = &self.mcap else {
            return Ok(());
        };
        let named =
            |problem: String| Failure::bad_input(format!("--mcap {}: {problem}", path.display()));
        if path.is_dir() {
            return Err(named("is a directory".into()));
        }
        let folder = output::folder(path);
        // A folder that is missing has the shorter message of the two.
        let checked = fs::metadata(folder).and_then(|_| output::probe(folder));
        checked.map_err(|error| named(error.to_string()))
    }

    /// Writes the log, if one was asked for.
    fn write_mcap(&self, record: &FlightRecord) -> Result<(), Failure> {
        let Some(path) = &self.mcap else {
            return Ok(());
        };
        let named = |problem: String| Failure::failed(format!("{}: {problem}", path.display()));
        let log = flight_log::mcap(record).map_err(named)?;
        output::write(path, &log).map_err(|error| named(error.to_string()))
    }
}

/// Writes the report of a flight that was completed or failed, and returns its error. `prints_events`
/// is whether the events of a failed flight are still to be displayed.
pub(super) fn report(
    flown: Result<FlightRecord, FailedFlight>,
    output: &OutputArguments,
    prints_events: bool,
) -> Result<(), Failure> {
    let failed = match flown {
        Ok(record) => return conclude(&record, output),
        Err(failed) => failed,
    };
    if let Some(record) = &failed.record {
        if prints_events {
            for event in &record.events {
                eprintln!("{}", line(event));
            }
        }
        // A failed flight is reported as well; its cause matters more than an error in writing the
        // report.
        if let Err(Failure::Failed(problem)) = write_report(record, output) {
            eprintln!("warning: {problem}");
        }
    }
    Err(match failed.error {
        error @ FlightError::Allocation(_) => Failure::bad_input(error),
        error @ FlightError::Ended { .. } => Failure::Interrupted(error.to_string()),
        error => Failure::failed(error),
    })
}

/// Writes the report's files and prints the summary.
fn write_report(record: &FlightRecord, output: &OutputArguments) -> Result<Summary, Failure> {
    let out = &output.out;
    let summary: Summary = report::write(record, out)
        .map_err(|error| Failure::failed(format!("{}: {error}", out.display())))?;
    output.write_mcap(record)?;
    let mut stdout = std::io::stdout().lock();
    if output.json {
        let text = serde_json::to_string_pretty(&summary).map_err(Failure::failed)?;
        writeln!(stdout, "{text}")?;
    } else {
        if !record.slots.is_empty() {
            writeln!(
                stdout,
                "{}",
                report::table(record, &summary, Look::of_stdout())
            )?;
        }
        writeln!(stdout, "report: {}", out.join("report.html").display())?;
    }
    Ok(summary)
}

/// Writes the report of a completed mission. Fails if the vehicle did not arrive or a constraint was
/// violated.
fn conclude(record: &FlightRecord, output: &OutputArguments) -> Result<(), Failure> {
    let summary = write_report(record, output)?;
    if summary.mse_violations > 0 {
        eprintln!(
            "warning: the MSE exceeded the threshold in {} of {} slots",
            summary.mse_violations, summary.slots
        );
    }
    if summary.arrived && summary.fair && summary.constraint_violations == 0 {
        return Ok(());
    }
    Err(Failure::failed(format!(
        "the mission was flown to its last slot, but {}: {:.1} m from the destination, {} constraint \
         violations; if the vehicle is slower than the mission requires, host-sim doctor lists the \
         parameters that limit it, and --set-params sets them for the flight",
        if summary.arrived {
            "violates its constraints"
        } else {
            "did not reach the destination"
        },
        summary.arrival_distance_m,
        summary.constraint_violations
    )))
}
