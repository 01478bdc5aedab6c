//! What is written from the CSV files and the policies: drawings, `index.html`, `docs/results.md`, the
//! table of `docs/bound.md` and the card of the shipped policies.

mod cards;
mod index;
mod results;

use std::{fmt::Write as _, path::Path};

use super::{Experiment, bounds::BoundRow, table};
use figures::document;

pub use cards::write_cards;
pub use index::write_index;
pub use results::{results, write_results};

/// Draws a figure next to its CSV file, as `NAME.svg`.
///
/// # Errors
/// Returns an error if the CSV file is missing or the directory cannot be written.
pub fn write_drawing(experiment: Experiment, directory: &Path) -> Result<(), String> {
    let svg = experiment.draw(directory)?.to_svg();
    table::write_text(&directory.join(format!("{}.svg", experiment.name())), &svg)
}

/// Writes the table of bounds between the markers of a page.
///
/// # Errors
/// Returns an error if the page cannot be read, has no markers `bounds`, or cannot be written.
pub fn write_bounds(rows: &[BoundRow], path: &Path) -> Result<(), String> {
    let mut body = String::from(
        "| scenario | T, s | noise, dBm | Gamma | upper | lower | gap | seconds | processor s |\n\
         |---|---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let _ = writeln!(
            body,
            "| {} | {} | {} | {:.3} | {:.4} | {:.4} | {:.3} % | {:.1} | {:.1} |",
            row.topology.name(),
            row.mission_time_s,
            row.noise_dbm,
            row.mse_threshold,
            row.upper,
            row.lower,
            100.0 * (row.upper - row.lower) / row.upper,
            row.seconds,
            row.processor_seconds
        );
    }
    document::write_table(path, "bounds", &body)
}
