//! `host-sim plan`: plans a mission once with the onboard planner.

use std::{fs, io::Write, path::PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use planning::planner::{PlannedMission, ground_control, plan};
use scenario::ScenarioChoice;
use serde::Serialize;

use super::{Failure, bound::style, terminal};

/// The options of `host-sim plan`.
#[derive(Debug, Args)]
pub(crate) struct PlanArguments {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// Write the waypoints as a QGroundControl mission; the file name must end in .plan
    #[arg(long, value_name = "F.plan")]
    out: Option<PathBuf>,
    /// Print the plan with its waypoints and served users as JSON
    #[arg(long)]
    json: bool,
}

/// The output of `--json`.
#[derive(Debug, Serialize)]
struct PlanReport<'a> {
    scenario: &'a str,
    #[serde(flatten)]
    plan: &'a PlannedMission,
}

/// Plans the mission, prints the result, and writes the file if requested.
pub(crate) fn execute(arguments: &PlanArguments) -> Result<(), Failure> {
    if let Some(path) = &arguments.out
        && path.extension().is_none_or(|extension| extension != "plan")
    {
        return Err(Failure::bad_input(format!(
            "--out {}: the file name must end in .plan",
            path.display()
        )));
    }
    let scenario = arguments.mission.load().map_err(Failure::bad_input)?;
    let spinner = ProgressBar::with_draw_target(None, terminal()).with_style(style());
    let planned = plan(&scenario.mission, |progress| {
        spinner.set_message(format!("planning: {:.3} bit/s/Hz", progress.value));
        spinner.tick();
    })
    .map_err(Failure::bad_input)?;
    spinner.finish_and_clear();
    if let Some(path) = &arguments.out {
        let text = ground_control::plan_file(&scenario, &planned.waypoints).ok_or_else(|| {
            Failure::bad_input(
                "--out: a .plan file holds at most 65000 waypoints, but the mission has more",
            )
        })?;
        fs::write(path, text)
            .map_err(|error| Failure::failed(format!("{}: {error}", path.display())))?;
    }
    let mut out = std::io::stdout().lock();
    if arguments.json {
        let report = PlanReport {
            scenario: &scenario.name,
            plan: &planned,
        };
        serde_json::to_writer(&mut out, &report).map_err(Failure::failed)?;
        writeln!(out)?;
        return Ok(());
    }
    writeln!(out, "scenario  {}", scenario.name)?;
    writeln!(
        out,
        "sum rate  {:.4} bit/s/Hz (host-sim run --policy plan flies this plan)",
        planned.sum_rate
    )?;
    match planned.upper_estimate.zip(planned.gap_estimate) {
        Some((upper, gap)) => writeln!(
            out,
            "gap       {:.2} % (estimated upper bound {upper:.4}; host-sim bound computes a certified one)",
            100.0 * gap
        )?,
        None => writeln!(out, "gap       unknown: the mission allows only one path")?,
    }
    writeln!(
        out,
        "time      {:.3} s, {:.0} million operations, {:.0} kB",
        planned.seconds,
        planned.operations as f64 / 1e6,
        planned.memory_bytes as f64 / 1e3
    )?;
    if let Some(path) = &arguments.out {
        writeln!(out, "mission   {}", path.display())?;
    }
    Ok(())
}
