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
        self, BoundRecord, Bounds, ChangeFlight, ChangeStatistics, Flown, PolicyStatistics, Table,
        group_statistics, statistics,
    },
    policy::PolicyChoice,
};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use scenario::{EventKind, Scenario};
use serde::Serialize;
use vehicle::Profile;

use super::{Failure, terminal};

/// The options of `host-sim benchmark`.
#[derive(Debug, Args)]
pub(crate) struct BenchmarkArguments {
    /// A policy to fly, as in host-sim run; may be given several times. A directory of .onnx files
    /// flies on each mission the policy that was trained for it [default: plan and straight-line]
    #[arg(long)]
    policy: Vec<PolicyChoice>,
    /// Directory that contains the scenarios and bounds.csv
    #[arg(long, default_value = "benchmarks", value_name = "DIR")]
    missions: PathBuf,
    /// The vehicle profile: ideal, multirotor, arducopter or px4
    #[arg(long, default_value = "ideal", value_parser = Profile::from_str)]
    profile: Profile,
    /// Fly only the first N missions, in the order of their names
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    first: Option<u64>,
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
    /// Print the statistics over groups of missions in place of those of all: by layout of the users
    /// and of the sensors, by their numbers, and by the MSE threshold
    #[arg(long, conflicts_with_all = ["certify", "changes", "page"])]
    groups: bool,
    /// Print the statistics as JSON
    #[arg(long)]
    json: bool,
    /// Also write the table into a document, between the marks <!-- benchmark NAME --> and
    /// <!-- /benchmark NAME --> (with --groups: "benchmark NAME groups")
    #[arg(long, value_name = "F.md", conflicts_with = "certify")]
    document: Option<PathBuf>,
    /// Name of the table in the document [default: the profile; with --changes: changes]
    #[arg(long, value_name = "NAME", requires = "document")]
    table: Option<String>,
    /// Also write a page with the table, the fractions of all missions, and the smallest ones
    #[arg(long, value_name = "F.html", conflicts_with_all = ["certify", "changes"])]
    page: Option<PathBuf>,
}

impl BenchmarkArguments {
    /// Returns the name of the table in the document's marks.
    fn table_name(&self) -> String {
        let name = match (&self.table, self.changes) {
            (Some(name), _) => name.clone(),
            (None, Some(_)) => "changes".into(),
            (None, None) => self.profile.to_string(),
        };
        let groups = if self.groups { " groups" } else { "" };
        format!("benchmark {name}{groups}")
    }

    /// Checks that the document can take the table.
    fn check_document(&self) -> Result<(), Failure> {
        let Some(path) = &self.document else {
            return Ok(());
        };
        let named = |problem: String| Failure::bad_input(format!("{}: {problem}", path.display()));
        let document = fs::read_to_string(path).map_err(|error| named(error.to_string()))?;
        figures::document::with_table(&document, &self.table_name(), "").map_err(named)?;
        Ok(())
    }

    /// Checks that the page can be written.
    fn check_page(&self) -> Result<(), Failure> {
        let Some(path) = &self.page else {
            return Ok(());
        };
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        if folder.is_dir() && !path.is_dir() {
            return Ok(());
        }
        Err(Failure::bad_input(format!(
            "--page {}: must be a file in a directory that exists",
            path.display()
        )))
    }

    /// Writes the table into the document, if there is one.
    fn write_document(&self, table: &str) -> Result<(), Failure> {
        let Some(document) = &self.document else {
            return Ok(());
        };
        figures::document::write_table(document, &self.table_name(), table).map_err(Failure::failed)
    }
}

/// Flies the policies and prints the table of statistics, or computes the missing bounds.
pub(crate) fn execute(arguments: &BenchmarkArguments) -> Result<(), Failure> {
    let mut scenarios = benchmark::missions(&arguments.missions).map_err(Failure::bad_input)?;
    if let Some(first) = arguments.first {
        scenarios.truncate(usize::try_from(first).unwrap_or(usize::MAX));
    }
    let bounds = Bounds::read(&arguments.missions).map_err(Failure::bad_input)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.jobs as usize)
        .build()
        .map_err(Failure::failed)?;
    if arguments.certify {
        return pool.install(|| certify(arguments, &scenarios, bounds));
    }
    // Found now rather than after the flights.
    arguments.check_document()?;
    arguments.check_page()?;
    let default = vec![PolicyChoice::Plan, PolicyChoice::StraightLine];
    let policies = if arguments.policy.is_empty() {
        &default
    } else {
        &arguments.policy
    };
    for policy in policies {
        policy.check_path().map_err(|(path, error)| {
            Failure::bad_input(format!("--policy {}: {error}", path.display()))
        })?;
    }
    if let Some(count) = arguments.changes {
        return pool.install(|| fly_changes(arguments, policies, &scenarios, count.into()));
    }
    let known = match &arguments.results {
        Some(path) => read_results(path)?,
        None => Vec::new(),
    };
    let flights = pool.install(|| fly(arguments, policies, &scenarios, known))?;
    let (flights, ideal): (Vec<Flown>, Vec<Flown>) = flights
        .into_iter()
        .partition(|flown| flown.profile == arguments.profile.to_string());
    let names: Vec<String> = policies.iter().map(ToString::to_string).collect();
    if arguments.groups {
        let found = group_statistics(&scenarios, &names, &flights, &bounds);
        return report(arguments, &found, &Table::of_groups(&found));
    }
    let found: Vec<PolicyStatistics> = names
        .iter()
        .map(|policy| statistics(policy, &names[0], &flights, &ideal, &bounds))
        .collect();
    let table = Table::of_policies(&found);
    if let Some(path) = &arguments.page {
        let profile = arguments.profile;
        let page = benchmark::page(&scenarios, &names, profile, &flights, &bounds, &table);
        files::output::write(path, page.as_bytes()).map_err(Failure::failed)?;
    }
    report(arguments, &found, &table)?;
    if !arguments.json {
        let mut out = std::io::stdout().lock();
        for row in found.iter().filter(|row| row.refused > 0) {
            writeln!(out, "{} does not fit {} missions", row.policy, row.refused)?;
        }
    }
    Ok(())
}

/// Writes the table into the document, and prints the table or, as JSON, what it was made of.
fn report(
    arguments: &BenchmarkArguments,
    found: &impl Serialize,
    table: &Table,
) -> Result<(), Failure> {
    arguments.write_document(&table.to_markdown())?;
    let mut out = std::io::stdout().lock();
    if arguments.json {
        serde_json::to_writer_pretty(&mut out, found).map_err(Failure::failed)?;
        writeln!(out)?;
        return Ok(());
    }
    let fraction = match arguments.changes {
        Some(_) => "fraction of a plan that knew the change from the start".to_owned(),
        None => format!(
            "sum rate as a fraction of the certified upper bound, over missions with a gap of at most {} %",
            100.0 * benchmark::COUNTED_GAP
        ),
    };
    writeln!(out, "{fraction}")?;
    write!(out, "{}", table.to_text())?;
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
    let rows = change_rows(&flights, policies);
    let table = Table::of_changes(&rows, &policies[0].to_string());
    report(arguments, &flights, &table)
}

/// Returns the statistics of each kind of change and policy, then of all changes.
fn change_rows(flights: &[ChangeFlight], policies: &[PolicyChoice]) -> Vec<ChangeStatistics> {
    let kinds = EventKind::ALL.into_iter().map(Some).chain([None]);
    kinds
        .flat_map(|kind| policies.iter().map(move |policy| (kind, policy)))
        .filter_map(|(kind, policy)| {
            let reference = policies[0].to_string();
            ChangeStatistics::of(flights, &policy.to_string(), &reference, kind)
        })
        .collect()
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
    let mut bounds = bounds;
    // One after the other, each on all threads: so the times are those of single missions.
    for scenario in missing {
        bar.set_message(scenario.name.clone());
        match Bounds::certify(scenario) {
            Ok(record) => {
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
    }
    bar.finish_and_clear();
    let records: Vec<&BoundRecord> = scenarios
        .iter()
        .filter_map(|scenario| bounds.of(&scenario.digest()))
        .collect();
    let within = |gap: f64| records.iter().filter(|record| record.gap <= gap).count();
    let mut times: Vec<f64> = records.iter().map(|r| r.processor_seconds).collect();
    times.sort_by(f64::total_cmp);
    writeln!(
        std::io::stdout(),
        "{} missions: {} with a gap of at most 1 %, {} of at most 2 %; processor time of a mission: median {:.1} s, \
         at most {:.1} s",
        scenarios.len(),
        within(0.01),
        within(0.02),
        times.get(times.len() / 2).copied().unwrap_or(f64::NAN),
        times.last().copied().unwrap_or(f64::NAN),
    )?;
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
/// profile, and those of the first policy with the ideal vehicle.
fn fly(
    arguments: &BenchmarkArguments,
    policies: &[PolicyChoice],
    scenarios: &[Scenario],
    known: Vec<Flown>,
) -> Result<Vec<Flown>, Failure> {
    let profile = arguments.profile;
    let with_profile = policies.iter().map(|policy| (policy, profile));
    let with_ideal = (profile != Profile::Ideal).then_some((&policies[0], Profile::Ideal));
    let pairs: Vec<(&PolicyChoice, Profile)> = with_profile.chain(with_ideal).collect();
    let wanted: Vec<(&Scenario, &PolicyChoice, Profile)> = scenarios
        .iter()
        .flat_map(|scenario| {
            pairs
                .iter()
                .map(move |(policy, on)| (scenario, *policy, *on))
        })
        .collect();
    let key = |flown: &Flown| {
        (
            flown.digest.clone(),
            flown.policy.clone(),
            flown.profile.clone(),
        )
    };
    let asked: BTreeSet<_> = wanted
        .iter()
        .map(|(scenario, policy, on)| (scenario.digest(), policy.to_string(), on.to_string()))
        .collect();
    let known: Vec<Flown> = known
        .into_iter()
        .filter(|flown| asked.contains(&key(flown)))
        .collect();
    let done: BTreeSet<_> = known.iter().map(key).collect();
    let jobs: Vec<_> = wanted
        .into_iter()
        .filter(|(scenario, policy, on)| {
            !done.contains(&(scenario.digest(), policy.to_string(), on.to_string()))
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
        .map(|(scenario, policy, on)| {
            let flown = benchmark::fly(scenario, policy, *on);
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
    Ok(known.into_iter().chain(flown?).collect())
}
