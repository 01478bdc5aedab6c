//! `cargo xtask flights`: the table of flights on real autopilots in `docs/sitl.md`, made from the
//! files of the flights.
//!
//! A flight is a folder under `docs/flights` with the `summary.json` of the run, as it was written,
//! and a `flight.json` with the data that a summary does not contain: the autopilot and its
//! version, the airframe, the wind, the commit and date of host-sim, the exit code, and the sum rate
//! of the ideal flight.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::Value;

/// The options of `cargo xtask flights`.
#[derive(Debug, Args)]
pub(crate) struct FlightsArguments {
    /// Only check whether docs/sitl.md contains the current table, and fail if it does not
    #[arg(long)]
    check: bool,
}

/// The markers around the table in the page.
const MARKS: [&str; 2] = [
    "<!-- cargo xtask flights: begin -->\n",
    "<!-- cargo xtask flights: end -->\n",
];

/// Writes the table into the page, or checks it.
pub(crate) fn run(root: &Path, arguments: &FlightsArguments) -> Result<()> {
    let page = root.join("docs/sitl.md");
    let old = fs::read_to_string(&page).with_context(|| page.display().to_string())?;
    let new = replaced(&old, &table(&root.join("docs/flights"))?)?;
    if arguments.check && new != old {
        bail!("docs/sitl.md does not contain the table of docs/flights: run `cargo xtask flights`");
    }
    if new != old {
        fs::write(&page, new).with_context(|| page.display().to_string())?;
    }
    Ok(())
}

/// Returns the page with this table between the markers.
fn replaced(page: &str, table: &str) -> Result<String> {
    let [begin, end] = MARKS;
    let from = page.find(begin).context("docs/sitl.md has no begin mark")? + begin.len();
    let to = page.find(end).context("docs/sitl.md has no end mark")?;
    if to < from {
        bail!("the marks in docs/sitl.md are in the wrong order");
    }
    Ok(format!("{}{table}{}", &page[..from], &page[to..]))
}

/// The properties that the flights of one row have in common, in the order of the columns.
type Kind = [String; 7];

/// The properties of one flight that the table contains.
struct Flight {
    /// The fraction of the ideal flight's sum rate.
    fraction: f64,
    /// The sum rate, bit/s/Hz.
    sum_rate: f64,
    arrived: bool,
    /// The distance from the last position to the destination, metres.
    away_m: f64,
    violations: f64,
    exit_code: f64,
}

/// Returns a table with one row for all flights of a kind.
fn table(folder: &Path) -> Result<String> {
    let entries = fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut folders: Vec<PathBuf> = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<std::io::Result<_>>()?;
    folders.retain(|path| path.is_dir());
    folders.sort();
    let mut kinds: BTreeMap<Kind, Vec<Flight>> = BTreeMap::new();
    for folder in folders {
        let (kind, flight) = read(&folder).with_context(|| folder.display().to_string())?;
        kinds.entry(kind).or_default().push(flight);
    }
    let mut table = String::from(
        "| autopilot | mission | policy | wind | airframe | version | date | flights | sum rate \
         (bit/s/Hz) | fraction of the ideal flight's | arrived, largest distance | violated \
         constraints | exit code 0 |\n\
         |---|---|---|---|---|---|---|--:|--:|--:|--:|--:|--:|\n",
    );
    for (kind, flights) in kinds {
        table += &row(&kind, &flights);
    }
    Ok(table)
}

fn row(kind: &Kind, flights: &[Flight]) -> String {
    let count = |what: fn(&Flight) -> bool| flights.iter().filter(|&flight| what(flight)).count();
    let range = |what: fn(&Flight) -> f64, digits: usize| {
        let values = || flights.iter().map(what);
        let (least, most) = (
            values().fold(f64::MAX, f64::min),
            values().fold(f64::MIN, f64::max),
        );
        if flights.len() == 1 {
            format!("{least:.digits$}")
        } else {
            format!("{least:.digits$} to {most:.digits$}")
        }
    };
    let all = flights.len();
    let away_m = flights.iter().map(|flight| flight.away_m);
    let violations: f64 = flights.iter().map(|flight| flight.violations).sum();
    format!(
        "| {} | {all} | {} | {} | {} of {all}, {:.0} m | {violations} | {} of {all} |\n",
        kind.join(" | "),
        range(|flight| flight.sum_rate, 2),
        range(|flight| flight.fraction, 3),
        count(|flight| flight.arrived),
        away_m.fold(0.0, f64::max),
        count(|flight| flight.exit_code == 0.0),
    )
}

fn read(folder: &Path) -> Result<(Kind, Flight)> {
    let read = |name: &str| -> Result<Value> {
        let text = fs::read_to_string(folder.join(name)).with_context(|| name.to_owned())?;
        serde_json::from_str(&text).with_context(|| name.to_owned())
    };
    let (flight, summary) = (read("flight.json")?, read("summary.json")?);
    let text = |of: &Value, name: &str| -> Result<String> {
        let value = of[name].as_str().map(str::to_owned);
        value.with_context(|| format!("{name} is missing"))
    };
    let number = |of: &Value, name: &str| -> Result<f64> {
        let value = of[name].as_f64();
        value.with_context(|| format!("{name} is missing"))
    };
    let sum_rate = number(&summary, "sum_rate")?;
    let kind = [
        text(&flight, "autopilot")?,
        text(&summary, "scenario")?,
        text(&summary, "policy")?,
        format!("{} m/s", number(&flight, "wind_mps")?),
        text(&flight, "airframe")?,
        format!(
            "{} ({})",
            text(&summary, "version")?,
            text(&flight, "commit")?
        ),
        text(&flight, "date")?,
    ];
    Ok((
        kind,
        Flight {
            fraction: sum_rate / number(&flight, "ideal")?,
            sum_rate,
            arrived: summary["arrived"].as_bool().context("arrived is missing")?,
            away_m: number(&summary, "arrival_distance_m")?,
            violations: number(&summary, "constraint_violations")?,
            exit_code: number(&flight, "exit_code")?,
        },
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table in the page agrees with the files of the flights.
    #[test]
    fn the_page_holds_the_table() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        run(&root, &FlightsArguments { check: true }).unwrap();
    }

    #[test]
    fn a_page_without_marks_is_an_error() {
        let [begin, end] = MARKS;
        assert!(replaced("nothing", "x").is_err());
        assert!(replaced(&format!("{end}{begin}"), "x").is_err());
        let page = format!("a\n{begin}old\n{end}b\n");
        assert_eq!(
            replaced(&page, "new\n").unwrap(),
            format!("a\n{begin}new\n{end}b\n")
        );
    }
}
