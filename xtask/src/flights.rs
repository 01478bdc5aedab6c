//! `cargo xtask flights`: the table of flights on real autopilots in `docs/sitl.md`, from what the
//! flights left.
//!
//! A flight is a folder under `docs/flights` with the `summary.json` of the run, as it was written,
//! and a `flight.json` that says what no summary knows: the autopilot and its version, the airframe,
//! the wind, the date, the exit code, and the total of the ideal flight.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::Value;

/// Which flights are added.
#[derive(Debug, Args)]
pub(crate) struct FlightsArguments {
    /// Fail if the page does not hold the table, and change nothing
    #[arg(long)]
    check: bool,
}

/// What encloses the table in the page.
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
        bail!("docs/sitl.md does not hold the table of docs/flights: run cargo xtask flights");
    }
    if new != old {
        fs::write(&page, new).with_context(|| page.display().to_string())?;
    }
    Ok(())
}

/// The page with this table between the marks.
fn replaced(page: &str, table: &str) -> Result<String> {
    let [begin, end] = MARKS;
    let from = page.find(begin).context("docs/sitl.md has no begin mark")? + begin.len();
    let to = page.find(end).context("docs/sitl.md has no end mark")?;
    if to < from {
        bail!("the marks in docs/sitl.md are in the wrong order");
    }
    Ok(format!("{}{table}{}", &page[..from], &page[to..]))
}

/// The flights in the order of their folders' names.
fn table(folder: &Path) -> Result<String> {
    let entries = fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut folders: Vec<PathBuf> = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<std::io::Result<_>>()?;
    folders.retain(|path| path.is_dir());
    folders.sort();
    let mut table = String::from(
        "| autopilot | airframe | wind | mission | policy | total (ideal) | arrived | constraints \
         broken | exit | product | date |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for folder in folders {
        table += &row(&folder).with_context(|| folder.display().to_string())?;
    }
    Ok(table)
}

fn row(folder: &Path) -> Result<String> {
    let read = |name: &str| -> Result<Value> {
        let text = fs::read_to_string(folder.join(name)).with_context(|| name.to_owned())?;
        serde_json::from_str(&text).with_context(|| name.to_owned())
    };
    let (flight, summary) = (read("flight.json")?, read("summary.json")?);
    let text = |of: &Value, name: &str| -> Result<String> {
        let value = &of[name];
        let known = value.as_str().map(str::to_owned);
        known
            .or_else(|| value.as_f64().map(|number| number.to_string()))
            .with_context(|| format!("{name} is missing"))
    };
    let number = |of: &Value, name: &str| -> Result<f64> {
        of[name]
            .as_f64()
            .with_context(|| format!("{name} is missing"))
    };
    let (total, ideal) = (number(&summary, "sum_rate")?, number(&flight, "ideal")?);
    let arrived = summary["arrived"].as_bool().context("arrived is missing")?;
    let away_m = number(&summary, "arrival_distance_m")?;
    Ok(format!(
        "| {} | {} | {} m/s | {} | {} | {total:.2} ({:.3} of {ideal:.2}) | {}{away_m:.0} m | {} | {} | {} | {} |\n",
        text(&flight, "autopilot")?,
        text(&flight, "airframe")?,
        number(&flight, "wind_mps")?,
        text(&summary, "scenario")?,
        text(&summary, "policy")?,
        total / ideal,
        if arrived { "" } else { "no: " },
        number(&summary, "constraint_violations")?,
        number(&flight, "exit_code")?,
        text(&summary, "version")?,
        text(&flight, "date")?,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the page says of the flights is what the flights left.
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
