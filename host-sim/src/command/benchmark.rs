//! `host-sim benchmark`: flies policies on a set of missions and reports their sum rates as
//! fractions of certified bounds.

use std::{
    collections::BTreeSet,
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
    str::FromStr,
    sync::Mutex,
};

use clap::Args;
use host_sim::{
    benchmark::{
        self, Bounds, ChangeFlight, ChangeStatistics, Flown, PolicyStatistics, statistics,
    },
    policy::PolicyChoice,
};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use scenario::{EventKind, Scenario};
use vehicle::Profile;

use super::{Failure, terminal};

/// The options of `host-sim benchmark`.
#[derive(Debug, Args)]
pub(crate) struct BenchmarkArguments {
    /// A policy to fly, as in host-sim run; may be given several times [default: plan and
    /// straight-line]
    #[arg(long)]
    policy: Vec<PolicyChoice>,
    /// Directory that contains the scenarios and bounds.csv
    #[arg(long, default_value = "benchmarks", value_name = "DIR")]
    missions: PathBuf,
    /// The vehicle profile: ideal, multirotor, arducopter or px4
    #[arg(long, default_value = "ideal", value_parser = Profile::from_str)]
    profile: Profile,
    /// Number of missions that are flown in parallel; measured times are comparable only with 1
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=256))]
    jobs: u64,
    /// CSV file to which each flight is appended; flights that it already contains are not repeated
    #[arg(long, value_name = "F.csv")]
    results: Option<PathBuf>,
    /// Compute the bounds that are missing in bounds.csv, without flying
    #[arg(long)]
    certify: bool,
    /// With --certify, also compute again the bounds whose relative gap is above this value; the
    /// larger lower bound and the smaller upper bound are stored
    #[arg(long, value_name = "GAP", requires = "certify")]
    certify_above: Option<f64>,
    /// Fly this many missions in which something changes at mid-mission (users move, leave or join,
    /// sensors leave, the MSE threshold, speed limit or number of slots falls), and compare with
    /// plans that knew it from the start
    #[arg(long, value_name = "N", conflicts_with_all = ["certify", "results"])]
    changes: Option<u16>,
    /// Print the statistics as JSON
    #[arg(long)]
    json: bool,
}

/// Flies the policies and prints the table of statistics, or computes the missing bounds.
pub(crate) fn execute(arguments: &BenchmarkArguments) -> Result<(), Failure> {
    let scenarios = benchmark::missions(&arguments.missions).map_err(Failure::bad_input)?;
    let bounds = Bounds::read(&arguments.missions).map_err(Failure::bad_input)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.jobs as usize)
        .build()
        .map_err(Failure::failed)?;
    if arguments.certify {
        return pool.install(|| certify(arguments, &scenarios, bounds));
    }
    let default = vec![PolicyChoice::Plan, PolicyChoice::StraightLine];
    let policies = if arguments.policy.is_empty() {
        &default
    } else {
        &arguments.policy
    };
    if let Some(count) = arguments.changes {
        return pool.install(|| fly_changes(arguments, policies, &scenarios, count.into()));
    }
    let known = match &arguments.results {
        Some(path) => read_results(path)?,
        None => Vec::new(),
    };
    let flights = pool.install(|| fly(arguments, policies, &scenarios, known))?;
    let found: Vec<PolicyStatistics> = policies
        .iter()
        .map(|policy| statistics(&policy.to_string(), &flights, &bounds))
        .collect();
    let mut out = std::io::stdout().lock();
    if arguments.json {
        serde_json::to_writer_pretty(&mut out, &found).map_err(Failure::failed)?;
        writeln!(out)?;
        return Ok(());
    }
    write!(out, "{}", table(&found))?;
    Ok(())
}

/// Flies missions that change in flight, and prints the table.
fn fly_changes(
    arguments: &BenchmarkArguments,
    policies: &[PolicyChoice],
    scenarios: &[Scenario],
    count: usize,
) -> Result<(), Failure> {
    let missions = benchmark::change_missions(scenarios, count);
    let jobs: Vec<_> = missions
        .iter()
        .flat_map(|mission| policies.iter().map(move |policy| (mission, policy)))
        .collect();
    let bar = bar(jobs.len());
    let flights: Vec<ChangeFlight> = jobs
        .par_iter()
        .map(|(mission, policy)| {
            let flight = mission.fly(policy, arguments.profile);
            bar.set_message(flight.flown.mission.clone());
            bar.inc(1);
            flight
        })
        .collect();
    bar.finish_and_clear();
    let mut out = std::io::stdout().lock();
    if arguments.json {
        serde_json::to_writer_pretty(&mut out, &flights).map_err(Failure::failed)?;
        writeln!(out)?;
        return Ok(());
    }
    write!(out, "{}", change_table(&flights, policies))?;
    Ok(())
}

fn change_table(flights: &[ChangeFlight], policies: &[PolicyChoice]) -> String {
    let mut text = format!(
        "share of a plan that knew the change from the start\n{:<42} {:<14} {:>6} {:>7} {:>7} {:>7}\n",
        "at mid-mission", "policy", "flown", "mean", "worst", "broken"
    );
    let kinds = EventKind::ALL.into_iter().map(Some).chain([None]);
    for kind in kinds {
        for policy in policies {
            let Some(row) = ChangeStatistics::of(flights, &policy.to_string(), kind) else {
                continue;
            };
            text += &format!(
                "{:<42} {:<14} {:>6} {:>7.4} {:>7.4} {:>7}\n",
                kind.map_or("all of these", EventKind::title),
                row.policy,
                row.flown,
                row.mean,
                row.worst,
                row.violations
            );
        }
    }
    text
}

fn bar(length: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{pos}/{len} {wide_bar} {msg} {elapsed}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::with_draw_target(Some(length as u64), terminal()).with_style(style)
}

/// Computes the missing bounds. Each bound is written to the file as soon as it is known.
fn certify(
    arguments: &BenchmarkArguments,
    scenarios: &[Scenario],
    bounds: Bounds,
) -> Result<(), Failure> {
    let folder = &arguments.missions;
    let enough = arguments.certify_above.unwrap_or(f64::INFINITY);
    let missing: Vec<&Scenario> = scenarios
        .iter()
        .filter(|scenario| {
            let known = bounds.of(&scenario.digest());
            known.is_none_or(|known| known.gap > enough)
        })
        .collect();
    let bar = bar(missing.len());
    let bounds = Mutex::new(bounds);
    missing.par_iter().try_for_each(|scenario| {
        match Bounds::certify(scenario) {
            Ok(record) => {
                let mut bounds = bounds.lock().map_err(Failure::failed)?;
                let record = match bounds.of(&record.digest) {
                    Some(known) => record.tighter(known),
                    None => record,
                };
                bounds.insert(record);
                bounds.write(folder).map_err(Failure::failed)?;
            }
            Err(problem) => bar.suspend(|| eprintln!("warning: {problem}")),
        }
        bar.inc(1);
        Ok::<(), Failure>(())
    })?;
    bar.finish_and_clear();
    Ok(())
}

fn read_results(path: &Path) -> Result<Vec<Flown>, Failure> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let named = |error: csv::Error| Failure::bad_input(format!("{}: {error}", path.display()));
    let mut reader = csv::Reader::from_path(path).map_err(named)?;
    let flights: Result<Vec<Flown>, _> = reader.deserialize().collect();
    flights.map_err(named)
}

/// Flies the missions that are not among the known flights, and returns all flights with this
/// profile.
fn fly(
    arguments: &BenchmarkArguments,
    policies: &[PolicyChoice],
    scenarios: &[Scenario],
    known: Vec<Flown>,
) -> Result<Vec<Flown>, Failure> {
    let profile = arguments.profile.to_string();
    let key = |flown: &Flown| {
        (
            flown.digest.clone(),
            flown.policy.clone(),
            flown.profile.clone(),
        )
    };
    let done: BTreeSet<_> = known.iter().map(key).collect();
    let jobs: Vec<(&Scenario, &PolicyChoice)> = scenarios
        .iter()
        .flat_map(|scenario| policies.iter().map(move |policy| (scenario, policy)))
        .filter(|(scenario, policy)| {
            !done.contains(&(scenario.digest(), policy.to_string(), profile.clone()))
        })
        .collect();
    let writer = match &arguments.results {
        Some(path) => {
            let failed = |error| Failure::failed(format!("{}: {error}", path.display()));
            if let Some(folder) = path.parent() {
                fs::create_dir_all(folder).map_err(failed)?;
            }
            let file = File::options().create(true).append(true).open(path);
            let file = file.map_err(failed)?;
            let is_new = file.metadata().map_err(failed)?.len() == 0;
            let builder = csv::WriterBuilder::new()
                .has_headers(is_new)
                .from_writer(file);
            Some(Mutex::new(builder))
        }
        None => None,
    };
    let bar = bar(jobs.len());
    let flown: Result<Vec<Flown>, Failure> = jobs
        .par_iter()
        .map(|(scenario, policy)| {
            let flown = benchmark::fly(scenario, policy, arguments.profile);
            if let Some(writer) = &writer {
                let mut writer = writer.lock().map_err(Failure::failed)?;
                writer.serialize(&flown).map_err(Failure::failed)?;
                writer.flush()?;
            }
            bar.set_message(flown.mission.clone());
            bar.inc(1);
            Ok(flown)
        })
        .collect();
    bar.finish_and_clear();
    let digests: BTreeSet<String> = scenarios.iter().map(Scenario::digest).collect();
    let own = |flown: &Flown| flown.profile == profile && digests.contains(&flown.digest);
    Ok(known.into_iter().filter(own).chain(flown?).collect())
}

fn table(found: &[PolicyStatistics]) -> String {
    let mut text = format!(
        "sum rate as a fraction of the certified upper bound, over missions with a gap of at most {} %\n\
         {:<14} {:>6} {:>7} {:>7} {:>7} {:>7} {:>7} {:>10} {:>10} {:>9} {:>12}\n",
        100.0 * benchmark::COUNTED_GAP,
        "policy",
        "flown",
        "counted",
        "mean",
        "5 %",
        "worst",
        "violated",
        "inaccurate",
        "prepare s",
        "at most",
        "decide us"
    );
    for row in found {
        text += &format!(
            "{:<14} {:>6} {:>7} {:>7.4} {:>7.4} {:>7.4} {:>7} {:>10} {:>10.3} {:>9.3} {:>12.1}\n",
            row.policy,
            row.flown,
            row.counted,
            row.mean,
            row.quantile_5,
            row.worst,
            row.violations,
            row.inaccurate_slots,
            row.preparation_median_s,
            row.preparation_max_s,
            row.decision_median_us
        );
    }
    for row in found.iter().filter(|row| row.refused > 0) {
        text += &format!("{} does not fit {} missions\n", row.policy, row.refused);
    }
    text
}
