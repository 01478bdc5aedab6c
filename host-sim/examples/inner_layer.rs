//! The table of `docs/inner-layer.md`: every way of solving the slot problem, on the same slots.
//!
//! ```text
//! cargo run --release -p host-sim --example inner_layer -- --write docs/inner-layer.md
//! ```
//!
//! Slots are drawn over both shipped topologies (a position, a user, one of the paper's four
//! thresholds) and at the corners of the domain. `--dump` writes them as JSON lines for
//! `.ci/interop/inner_cvxpy.py`, whose results `--cvxpy` takes in. Fails where a promise about the
//! solvers does not hold on the random slots.

use std::{fmt::Write as _, fs, hint::black_box, path::PathBuf, time::Instant};

use anyhow::{Context, Error, Result, ensure};
use clap::Parser;
use figures::document;
use firmware_core::{
    Position, PowerGain, SENSORS_MAX, Watt,
    inner::{SlotLimits, Workspace, alternating},
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use reference::conic;
use reference::solve::Problem;
use scenario::Scenario;
use serde::Deserialize;

/// Compares the solvers of the slot problem.
#[derive(Debug, Parser)]
struct Arguments {
    /// Random slots, half of them over each shipped topology
    #[arg(long, default_value_t = 1000)]
    slots: usize,
    /// Seed of the draw
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the random slots here, one JSON line each, and stop
    #[arg(long)]
    dump: Option<PathBuf>,
    /// Results of inner_cvxpy.py on the first of the dumped slots
    #[arg(long)]
    cvxpy: Option<PathBuf>,
    /// Replace the tables of this document; without it they are printed
    #[arg(long)]
    write: Option<PathBuf>,
}

/// The paper's thresholds (its Fig. on trajectories); 0.010 is infeasible in much of the area.
const THRESHOLDS: [f64; 4] = [0.010, 0.015, 0.020, 0.025];
/// What times are the median of, for solvers that a clock cannot see once.
const REPETITIONS: u32 = 64;

/// What a method made of a slot.
#[derive(Clone, Copy, Debug)]
struct Outcome {
    rate: f64,
    feasible: bool,
    /// A general solver gave up; what it reached before counts.
    failed: bool,
    seconds: f64,
    /// Convex problems solved on the way.
    solves: u32,
}

/// A line of inner_cvxpy.py.
#[derive(Debug, Deserialize)]
struct CvxpyLine {
    rate: f64,
    feasible: bool,
    failed: bool,
    seconds: f64,
    solves: u32,
}

#[derive(Clone, Copy, Debug)]
enum Method {
    Exact,
    Alternating(f64),
    /// (a): Alg. 1, each eq:p_pbp by Clarabel.
    ConicAlternating(f64),
    /// (b): eq:p1 by bisection.
    Conic,
}

impl Method {
    const ALL: [(&'static str, Self); 5] = [
        ("exact", Self::Exact),
        ("alternating, xi = 1e-3", Self::Alternating(1e-3)),
        ("alternating, xi = 1e-6", Self::Alternating(1e-6)),
        (
            "Clarabel (a): Alg. 1, xi = 1e-3",
            Self::ConicAlternating(1e-3),
        ),
        ("Clarabel (b): eq:p1 by bisection", Self::Conic),
    ];

    fn solve(self, slot: &Problem) -> Result<Outcome> {
        let limits = SlotLimits {
            sensor_power_max: Watt(slot.sensor_power_max),
            user_power_max: Watt(slot.user_power_max),
            noise_power: Watt(slot.noise_power),
            mse_threshold: slot.mse_threshold,
        };
        let gains: Vec<_> = slot.sensor_gain.iter().copied().map(PowerGain).collect();
        let user = slot.user_gain.map(PowerGain);
        let settings = |tolerance| alternating::AlternatingSettings {
            tolerance,
            ..alternating::AlternatingSettings::default()
        };
        let mut workspace = Workspace::<f64, SENSORS_MAX>::default();
        Ok(match self {
            Self::Exact => {
                let mut solution = None;
                let begun = Instant::now();
                for _ in 0..REPETITIONS {
                    let field = workspace.sensors(black_box(&limits), black_box(&gains))?;
                    solution = Some(black_box(field.solve(user)?));
                }
                let seconds = begun.elapsed().as_secs_f64() / f64::from(REPETITIONS);
                let solution = solution.context("solved at least once")?;
                Outcome {
                    rate: solution.rate,
                    feasible: solution.status.is_feasible(),
                    failed: false,
                    seconds,
                    solves: 1,
                }
            }
            Self::Alternating(tolerance) => {
                let begun = Instant::now();
                let field = workspace.sensors(&limits, &gains)?;
                let report = field.alternate(user, &settings(tolerance), |_| {})?;
                Outcome {
                    seconds: begun.elapsed().as_secs_f64(),
                    rate: report.solution.rate,
                    feasible: report.solution.status.is_feasible(),
                    failed: report.outcome == alternating::AlternatingOutcome::IterationLimit,
                    solves: report.subproblems,
                }
            }
            Self::ConicAlternating(_) | Self::Conic => {
                let begun = Instant::now();
                let report = match self {
                    Self::ConicAlternating(tolerance) => {
                        conic::alternate(&limits, &gains, user, None, &settings(tolerance))
                    }
                    _ => conic::bisect(&limits, &gains, user, None),
                };
                Outcome {
                    seconds: begun.elapsed().as_secs_f64(),
                    rate: report.rate,
                    feasible: !report.status.is_infeasible(),
                    failed: matches!(
                        report.status,
                        conic::ConicStatus::SolverFailed(_) | conic::ConicStatus::IterationLimit
                    ),
                    solves: report.solves,
                }
            }
        })
    }
}

fn random_slots(count: usize, seed: u64) -> Result<Vec<Problem>> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut slots = Vec::with_capacity(count);
    for index in 0..count {
        let name = ["separated", "mixed"][index % 2];
        let scenario = Scenario::shipped(name).context(name)?;
        let (mission, p) = (&scenario.mission, scenario.mission.parameters());
        let here = Position::new(
            random.random_range(0.0..=p.area.east_m),
            random.random_range(0.0..=p.area.north_m),
        );
        let gain = |place| mission.channel().power_gain(&here, place).0;
        slots.push(Problem {
            sensor_gain: p.sensors.iter().map(gain).collect(),
            user_gain: Some(gain(&p.users[random.random_range(0..p.users.len())])),
            sensor_power_max: p.sensor_power_max.0,
            user_power_max: p.user_power_max.0,
            noise_power: p.noise_power.0,
            mse_threshold: THRESHOLDS[index / 2 % THRESHOLDS.len()],
            ..Problem::default()
        });
    }
    Ok(slots)
}

/// Groups of slots where something could go wrong.
fn corners(slots: &[Problem]) -> Result<Vec<(String, Vec<Problem>)>> {
    let some = || slots.iter().take(10).cloned();
    let changed = |change: &dyn Fn(&mut Problem)| {
        let mut group: Vec<Problem> = some().collect();
        group.iter_mut().for_each(change);
        group
    };
    let mut groups = Vec::new();
    for offset in [1e-6, -1e-6, 1e-9, -1e-9] {
        let mut group = Vec::new();
        for slot in some() {
            let (count, least) = (slot.sensor_gain.len() as f64, least_mse(&slot)?);
            let f = count - least * count * count;
            // kappa = f (1 - offset): feasible by that much.
            let mse_threshold = (1.0 - f * (1.0 - offset) / count) / count;
            group.push(Problem {
                mse_threshold,
                ..slot
            });
        }
        groups.push((format!("border, `f(c*) = kappa (1 {offset:+e})`"), group));
    }
    groups.push((
        "a third of the sensors without gain".into(),
        changed(&|slot| {
            slot.sensor_gain
                .iter_mut()
                .step_by(3)
                .for_each(|gain| *gain = 0.0)
        }),
    ));
    groups.push((
        "no sensor with gain".into(),
        changed(&|slot| slot.sensor_gain.fill(0.0)),
    ));
    groups.push((
        "one sensor a million times stronger".into(),
        changed(&|slot| slot.sensor_gain[0] *= 1e6),
    ));
    groups.push((
        "gains over 12 orders".into(),
        changed(&|slot| {
            let orders = 12.0 / slot.sensor_gain.len() as f64;
            for (index, gain) in slot.sensor_gain.iter_mut().enumerate() {
                *gain = 10f64.powf(-18.0 + orders * index as f64);
            }
            slot.mse_threshold = 0.9 / slot.sensor_gain.len() as f64;
        }),
    ));
    groups.push((
        "one sensor only".into(),
        changed(&|slot| {
            slot.sensor_gain.truncate(1);
            slot.sensor_gain[0] = 1e-10;
            slot.mse_threshold *= 36.0;
        }),
    ));
    groups.push((
        "user without gain".into(),
        changed(&|slot| slot.user_gain = Some(0.0)),
    ));
    groups.push((
        "nobody served".into(),
        changed(&|slot| slot.user_gain = None),
    ));
    Ok(groups)
}

fn least_mse(slot: &Problem) -> Result<f64> {
    let mut workspace = Workspace::<f64, SENSORS_MAX>::default();
    let limits = SlotLimits {
        sensor_power_max: Watt(slot.sensor_power_max),
        user_power_max: Watt(slot.user_power_max),
        noise_power: Watt(slot.noise_power),
        mse_threshold: slot.mse_threshold,
    };
    let gains: Vec<_> = slot.sensor_gain.iter().copied().map(PowerGain).collect();
    Ok(workspace.sensors(&limits, &gains)?.least_mse())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn time(seconds: f64) -> String {
    match seconds {
        s if s < 1e-6 => format!("{:.0} ns", s * 1e9),
        s if s < 1e-3 => format!("{:.1} us", s * 1e6),
        s if s < 1.0 => format!("{:.1} ms", s * 1e3),
        s => format!("{s:.1} s"),
    }
}

/// A fraction near 1, by how far it is from 1 where digits would not show it.
fn fraction(value: f64) -> String {
    let short = 1.0 - value;
    if short == 0.0 {
        "1".into()
    } else if short.abs() < 1e-4 {
        format!(
            "1 {} {:.0e}",
            if short < 0.0 { '+' } else { '-' },
            short.abs()
        )
    } else {
        format!("{value:.6}")
    }
}

/// Fractions of the optimum where there is one to speak of.
fn fractions(outcomes: &[Outcome], exact: &[Outcome], rate_min: f64) -> Vec<f64> {
    let pairs = outcomes.iter().zip(exact);
    pairs
        .filter(|(_, exact)| exact.rate > rate_min)
        .map(|(outcome, exact)| outcome.rate / exact.rate)
        .collect()
}

fn differing(outcomes: &[Outcome], exact: &[Outcome]) -> usize {
    let pairs = outcomes.iter().zip(exact);
    pairs.filter(|(a, b)| a.feasible != b.feasible).count()
}

fn main_table(rows: &[(&str, Vec<Outcome>)]) -> String {
    let exact = &rows[0].1;
    let mut table = String::from(
        "| method | slots | share of the optimum: least | median | most | feasibility differs | not finished | solves, median | time, median | times exact |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    let exact_time = median(exact.iter().map(|o| o.seconds).collect());
    for (name, outcomes) in rows {
        let shares = fractions(outcomes, exact, 0.0);
        let least = shares.iter().copied().fold(f64::INFINITY, f64::min);
        let most = shares.iter().copied().fold(0.0, f64::max);
        let served = || outcomes.iter().filter(|o| o.rate > 0.0);
        let seconds = median(outcomes.iter().map(|o| o.seconds).collect());
        let _ = writeln!(
            table,
            "| {name} | {} | {} | {} | {} | {} | {} | {:.0} | {} | {:.0} |",
            outcomes.len(),
            fraction(least),
            fraction(median(shares)),
            fraction(most),
            differing(outcomes, exact),
            outcomes.iter().filter(|o| o.failed).count(),
            median(served().map(|o| f64::from(o.solves)).collect()),
            time(seconds),
            seconds / exact_time,
        );
    }
    table
}

fn corner_table(groups: &[(String, Vec<Problem>)]) -> Result<String> {
    let mut table = String::from("| slots | feasible by exact |");
    for (name, _) in &Method::ALL[1..] {
        let _ = write!(table, " {name} |");
    }
    table.push_str("\n|---|---|---|---|---|---|\n");
    for (name, slots) in groups {
        let solve = |method: Method| -> Result<Vec<_>> {
            slots.iter().map(|slot| method.solve(slot)).collect()
        };
        let exact = solve(Method::Exact)?;
        let feasible = exact.iter().filter(|o| o.feasible).count();
        let _ = write!(table, "| {name} | {feasible} of {} |", slots.len());
        for (_, method) in &Method::ALL[1..] {
            let outcomes = solve(*method)?;
            let shares = fractions(&outcomes, &exact, 0.0);
            let least = shares.into_iter().fold(f64::INFINITY, f64::min);
            let least = if least.is_finite() {
                format!("least {}", fraction(least))
            } else {
                "no rate".into()
            };
            let unfinished = match outcomes.iter().filter(|o| o.failed).count() {
                0 => String::new(),
                count => format!(", {count} not finished"),
            };
            let _ = write!(
                table,
                " {least}, {} differ{unfinished} |",
                differing(&outcomes, &exact)
            );
        }
        table.push('\n');
    }
    Ok(table)
}

/// What the product promises of these solvers; the message says what does not hold.
fn check(rows: &[(&str, Vec<Outcome>)]) -> Result<()> {
    let exact = &rows[0].1;
    let exact_time = median(exact.iter().map(|o| o.seconds).collect());
    for (name, outcomes) in rows {
        let (least_allowed, times_exact) = match *name {
            "alternating, xi = 1e-3" => (0.99, 0.0),
            "alternating, xi = 1e-6" => (0.9999, 0.0),
            "Clarabel (a): Alg. 1, xi = 1e-3" => (0.99, 1e4),
            "Clarabel (b): eq:p1 by bisection" => (1.0 - 1e-7, 1e3),
            _ => (0.0, 0.0),
        };
        let shares = fractions(outcomes, exact, 0.0);
        let least = shares.iter().copied().fold(f64::INFINITY, f64::min);
        let most = shares.iter().copied().fold(0.0, f64::max);
        let seconds = median(outcomes.iter().map(|o| o.seconds).collect());
        ensure!(most <= 1.0 + 1e-7, "{name} beats exact: {most}");
        ensure!(
            least >= least_allowed,
            "{name} reaches {least} of the optimum only"
        );
        let differing = differing(outcomes, exact);
        ensure!(
            differing == 0,
            "{name}: feasibility differs on {differing} slots"
        );
        let ratio = seconds / exact_time;
        ensure!(
            ratio >= times_exact,
            "{name} takes {ratio} times exact's time only"
        );
    }
    Ok(())
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let slots = random_slots(arguments.slots, arguments.seed)?;
    if let Some(path) = &arguments.dump {
        let lines: Result<String, _> = slots
            .iter()
            .map(|slot| serde_json::to_string(slot).map(|line| line + "\n"))
            .collect();
        fs::write(path, lines?).with_context(|| path.display().to_string())?;
        return Ok(());
    }
    let mut rows = Vec::new();
    for (name, method) in Method::ALL {
        eprintln!("{name} ...");
        let outcomes: Result<Vec<_>> = slots.iter().map(|slot| method.solve(slot)).collect();
        rows.push((name, outcomes?));
    }
    if let Some(path) = &arguments.cvxpy {
        let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
        let mut outcomes = Vec::new();
        for line in text.lines() {
            let line: CvxpyLine = serde_json::from_str(line)?;
            outcomes.push(Outcome {
                rate: line.rate,
                feasible: line.feasible,
                failed: line.failed,
                seconds: line.seconds,
                solves: line.solves,
            });
        }
        ensure!(
            outcomes.len() <= slots.len(),
            "more CVXPY results than slots"
        );
        rows.push(("CVXPY: Alg. 1, xi = 1e-3", outcomes));
    }
    let random = main_table(&rows);
    eprintln!("corners ...");
    let corners = corner_table(&corners(&slots)?)?;
    match &arguments.write {
        Some(path) => {
            for (name, table) in [("random slots", &random), ("corners", &corners)] {
                document::write_table(path, name, table).map_err(Error::msg)?;
            }
        }
        None => println!("{random}\n{corners}"),
    }
    check(&rows)
}
