//! `host-sim bound`: computes the certified upper bound of a scenario.

use std::io::Write;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use planning::bound::{Bound, BoundSettings, certify};
use scenario::ScenarioChoice;
use serde::Serialize;

use super::Failure;

/// The options of `host-sim bound`.
#[derive(Debug, Args)]
pub(crate) struct BoundArguments {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// Relative gap (upper - lower) / upper at which the computation stops
    #[arg(long, default_value_t = BoundSettings::default().gap)]
    gap: f64,
    /// Largest number of subproblems (branch and bound); 1 disables branching
    #[arg(long, default_value_t = BoundSettings::default().leaves_max as u64,
        value_parser = clap::value_parser!(u64).range(1..=1000))]
    parts: u64,
    /// Print the bound and the mission that was found as JSON
    #[arg(long)]
    json: bool,
}

/// The output of `--json`.
#[derive(Debug, Serialize)]
struct BoundReport<'a> {
    scenario: &'a str,
    mse_threshold: f64,
    #[serde(flatten)]
    bound: &'a Bound,
}

/// Computes the bound and prints it.
pub(crate) fn execute(arguments: &BoundArguments) -> Result<(), Failure> {
    if !(arguments.gap >= 0.0 && arguments.gap < 1.0) {
        return Err(Failure::bad_input(format!(
            "--gap is {}, but must be at least 0 and below 1",
            arguments.gap
        )));
    }
    let scenario = arguments.mission.load().map_err(Failure::bad_input)?;
    let settings = BoundSettings {
        gap: arguments.gap,
        leaves_max: arguments.parts as usize,
        ..BoundSettings::default()
    };
    let bar = ProgressBar::new_spinner().with_style(style());
    let bound = certify(&scenario.mission, &settings, |progress| {
        bar.set_message(format!(
            "upper {:.3}, lower {:.3}, {} subproblems, cells of {:.2} m",
            progress.upper, progress.lower, progress.leaves, progress.cell_m
        ));
        bar.tick();
    })
    .map_err(Failure::bad_input)?;
    bar.finish_and_clear();
    let mut out = std::io::stdout().lock();
    let mse_threshold = scenario.mission.parameters().mse_threshold;
    if arguments.json {
        let report = BoundReport {
            scenario: &scenario.name,
            mse_threshold,
            bound: &bound,
        };
        serde_json::to_writer(&mut out, &report).map_err(Failure::failed)?;
        writeln!(out)?;
        return Ok(());
    }
    writeln!(
        out,
        "scenario  {} (MSE threshold {mse_threshold})",
        scenario.name
    )?;
    writeln!(
        out,
        "upper     {:.4} bit/s/Hz: no admissible mission has a higher sum rate",
        bound.upper
    )?;
    writeln!(
        out,
        "lower     {:.4} bit/s/Hz: sum rate of the mission flown by host-sim run --policy search",
        bound.lower
    )?;
    writeln!(out, "gap       {:.3} %", 100.0 * bound.gap)?;
    writeln!(
        out,
        "cells     down to {:.3} m, in {} subproblems",
        bound.cell_m, bound.leaves
    )?;
    writeln!(out, "time      {:.1} s", bound.seconds)?;
    if bound.carries_nothing() {
        writeln!(
            out,
            "note      no reachable position meets the MSE threshold: the sum rate of every mission is 0"
        )?;
    }
    Ok(())
}

pub(super) fn style() -> ProgressStyle {
    ProgressStyle::with_template("{spinner} {elapsed} {msg}")
        .unwrap_or_else(|_| ProgressStyle::default_spinner())
}
