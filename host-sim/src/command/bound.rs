//! `host-sim bound`: computes the certified upper bound of a scenario.

use std::{
    io::Write,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use clap::Args;
use host_sim::interrupt;
use indicatif::{ProgressBar, ProgressStyle};
use planning::bound::{Bound, BoundError, BoundSettings, certify_until};
use scenario::{Scenario, ScenarioChoice};
use serde::Serialize;

use super::{Failure, terminal};

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
        value_parser = clap::value_parser!(u64).range(1..=100_000))]
    parts: u64,
    /// Stop after this many seconds and print the bound that is certified by then
    #[arg(long, value_name = "SECONDS", value_parser = parse_seconds)]
    time_limit: Option<Duration>,
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
    let bound =
        certify_watched(&scenario, &settings, arguments.time_limit).map_err(Failure::bad_input)?;
    print(arguments, &scenario, &bound)?;
    if interrupt::flag().load(Ordering::Relaxed) {
        return Err(Failure::Interrupted(
            "interrupted: the bound that was printed is certified, but more time may tighten it"
                .into(),
        ));
    }
    Ok(())
}

/// Certifies a bound, and displays the progress on a terminal. Ends at the time limit or at the
/// first Ctrl-C with what is certified by then.
pub(super) fn certify_watched(
    scenario: &Scenario,
    settings: &BoundSettings,
    time_limit: Option<Duration>,
) -> Result<Bound, BoundError> {
    let started = Instant::now();
    let interrupted = interrupt::flag();
    let stop = || {
        interrupted.load(Ordering::Relaxed)
            || time_limit.is_some_and(|limit| started.elapsed() >= limit)
    };
    let bar = ProgressBar::with_draw_target(None, terminal()).with_style(style());
    bar.set_message("first prices");
    bar.enable_steady_tick(Duration::from_millis(200));
    let bound = certify_until(&scenario.mission, settings, &stop, |progress| {
        bar.set_message(format!(
            "upper {:.3}, lower {:.3}, gap {:.2} %, {} subproblems, cells of {:.2} m",
            progress.upper,
            progress.lower,
            100.0 * (progress.upper - progress.lower) / progress.upper.max(f64::MIN_POSITIVE),
            progress.leaves,
            progress.cell_m
        ));
    });
    bar.finish_and_clear();
    bound
}

fn parse_seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    Duration::try_from_secs_f64(seconds)
        .map_err(|_| "must be a number of seconds, at least 0".to_owned())
}

/// Prints a bound.
fn print(arguments: &BoundArguments, scenario: &Scenario, bound: &Bound) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    let mse_threshold = scenario.mission.parameters().mse_threshold;
    if arguments.json {
        let report = BoundReport {
            scenario: &scenario.name,
            mse_threshold,
            bound,
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
        "lower     {:.4} bit/s/Hz: sum rate of the best mission that was found",
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
