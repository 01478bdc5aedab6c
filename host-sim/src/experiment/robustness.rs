//! What happens to totals and outage when the world is not known exactly: one kind of error at a
//! time, for planner, SAC and straight line, with allocations that know the statistics of the errors
//! (robust) and that ignore them (naive).
//!
//! Measured once into `robustness.csv` and `moving.csv`; drawings and tables are made from these.

mod drawing;
mod moving;
mod page;

use std::{fmt, path::Path};

use rayon::prelude::*;
use scenario::{Events, Motion, MotionModel, MovingNodes, PerNode, Scenario, Uncertainty};
use serde::{Deserialize, Serialize};

use super::{Watcher, ideal_flight, rounded, statistics, table};
use crate::policy::PolicyChoice;

pub use moving::{MovingRow, measure_moving};
pub use page::section;

/// The name on the command line, and the stem of the files.
pub const NAME: &str = "robustness";
/// The stem of the file of flights with moving users and silent sensors.
const MOVING: &str = "moving";

/// One kind of error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorKind {
    /// The relative error variance of all channel estimates.
    ChannelError,
    /// The standard deviation of the sensors' phase errors, rad.
    PhaseError,
    /// The standard deviation of shadowing, dB.
    Shadowing,
    /// The power of the scattered paths over that of the direct one, `1 / K`.
    Fading,
    /// The probability that a sensor is silent in a slot.
    Silence,
    /// The standard deviation of the nodes' positions in each direction, m.
    PositionError,
    /// The largest speed of the users, m/s.
    Motion,
    /// The probability that the channel state of a slot is lost.
    StateLoss,
}

impl ErrorKind {
    /// All kinds.
    pub const ALL: [Self; 8] = [
        Self::ChannelError,
        Self::PhaseError,
        Self::Shadowing,
        Self::Fading,
        Self::Silence,
        Self::PositionError,
        Self::Motion,
        Self::StateLoss,
    ];

    /// Returns the levels that are flown; 0 is the known world.
    pub fn levels(self) -> [f64; 4] {
        match self {
            Self::ChannelError => [0.0, 0.02, 0.05, 0.1],
            Self::PhaseError => [0.0, 0.15, 0.3, 0.45],
            Self::Shadowing => [0.0, 2.0, 4.0, 8.0],
            Self::Fading => [0.0, 0.1, 0.3, 1.0],
            Self::Silence => [0.0, 0.02, 0.05, 0.1],
            Self::PositionError => [0.0, 10.0, 30.0, 60.0],
            Self::Motion => [0.0, 1.0, 2.5, 5.0],
            Self::StateLoss => [0.0, 0.05, 0.1, 0.2],
        }
    }

    /// Returns the name of the level, with its unit.
    pub fn axis(self) -> &'static str {
        match self {
            Self::ChannelError => "relative error variance",
            Self::PhaseError => "phase error, rad",
            Self::Shadowing => "shadowing, dB",
            Self::Fading => "scattered over direct power",
            Self::Silence => "silence probability",
            Self::PositionError => "position error, m",
            Self::Motion => "users' largest speed, m/s",
            Self::StateLoss => "probability of a lost state",
        }
    }

    /// Returns whether the vehicle is told statistics of this error, so that robust and naive
    /// allocations differ.
    fn has_statistics(self) -> bool {
        matches!(self, Self::ChannelError | Self::PhaseError)
    }

    /// Returns the world with this level of the error.
    fn world(self, level: f64, seed: u64) -> Uncertainty {
        let mut world = Uncertainty {
            seed,
            ..Uncertainty::default()
        };
        if level == 0.0 {
            return world;
        }
        match self {
            Self::ChannelError => {
                world.sensor_error_variance = PerNode::All(level);
                world.user_error_variance = PerNode::All(level);
            }
            Self::PhaseError => world.sensor_phase_error_rad = PerNode::All(level),
            Self::Shadowing => world.shadowing_db = level,
            Self::Fading => world.rician_k_db = Some(-10.0 * level.log10()),
            Self::Silence => world.silence_probability = PerNode::All(level),
            Self::PositionError => world.position_error_m = level,
            Self::Motion => world.motion = Some(walking(level)),
            Self::StateLoss => world.state_loss_probability = level,
        }
        world
    }
}

/// Returns random-waypoint motion of the users with this largest speed.
fn walking(speed_mps: f64) -> Motion {
    Motion {
        model: MotionModel::RandomWaypoint,
        nodes: MovingNodes::Users,
        speed_mps: Some(speed_mps),
        memory_s: None,
        csv: None,
        told_after_m: None,
    }
}

/// Who flies, and what the allocation knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pilot {
    /// The onboard planner, which plans again in flight.
    Planner,
    /// The shipped policy: SAC with Table I's settings, trained for the known world. For the shipped
    /// missions only.
    Sac,
    /// The fair straight line.
    StraightLine,
}

impl Pilot {
    /// All pilots.
    pub const ALL: [Self; 3] = [Self::Planner, Self::Sac, Self::StraightLine];

    fn policy(self) -> PolicyChoice {
        match self {
            Self::Planner => PolicyChoice::Plan,
            Self::Sac => PolicyChoice::Shipped,
            Self::StraightLine => PolicyChoice::StraightLine,
        }
    }
}

impl fmt::Display for Pilot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Planner => "planner",
            Self::Sac => "SAC",
            Self::StraightLine => "straight line",
        })
    }
}

/// The missions that are averaged over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Group {
    /// The shipped mission of Topo.1.
    Separated,
    /// The shipped mission of Topo.2.
    Mixed,
    /// Missions of the benchmark.
    Benchmark,
}

impl Group {
    /// All groups.
    pub const ALL: [Self; 3] = [Self::Separated, Self::Mixed, Self::Benchmark];

    fn title(self) -> &'static str {
        match self {
            Self::Separated => "separated",
            Self::Mixed => "mixed",
            Self::Benchmark => "benchmark",
        }
    }

    fn pilots(self) -> &'static [Pilot] {
        match self {
            Self::Benchmark => &[Pilot::Planner, Pilot::StraightLine],
            _ => &Pilot::ALL,
        }
    }
}

/// A row of `robustness.csv`: the mean over missions and seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobustnessRow {
    /// The missions.
    pub group: Group,
    /// The kind of error.
    pub kind: ErrorKind,
    /// Its level.
    pub level: f64,
    /// Who flew.
    pub pilot: Pilot,
    /// The vehicle knew the statistics of the errors.
    pub robust: bool,
    /// The number of missions.
    pub missions: usize,
    /// The number of seeds of the world, from 1.
    pub seeds: usize,
    /// The total rate over that of the planner in the known world.
    pub share: f64,
    /// Half the width of its 95 % confidence interval: over the seeds of a shipped mission, over the
    /// missions of the benchmark.
    pub share_interval_95: Option<f64>,
    /// The fraction of slots with an expected MSE above the threshold.
    pub outage: f64,
    /// Half the width of its 95 % confidence interval.
    pub outage_interval_95: Option<f64>,
    /// The rate that is lost against perfect knowledge at the same places, over the planner's total
    /// in the known world.
    pub lost_share: f64,
    /// The largest excess of an expected MSE over its threshold, relative to the threshold.
    pub excess: f64,
    /// The number of violated constraints of all flights, arrival and fairness included.
    pub broken: usize,
}

/// How much is flown.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// The number of benchmark missions, from the first.
    pub missions: usize,
    /// The number of seeds, from 1.
    pub seeds: u64,
}

/// One flight.
#[derive(Clone, Copy, Debug)]
struct Job<'a> {
    scenario: &'a Scenario,
    kind: ErrorKind,
    level: f64,
    pilot: Pilot,
    robust: bool,
    seed: u64,
}

/// The result of one flight.
#[derive(Clone, Copy, Debug)]
struct Flown {
    sum_rate: f64,
    lost: f64,
    outage: f64,
    excess: f64,
    broken: usize,
}

impl Job<'_> {
    fn fly(&self) -> Result<Flown, String> {
        let world = self.kind.world(self.level, self.seed);
        let scenario = self.scenario.clone().with_uncertainty(world)?;
        let settings = ideal_flight::Settings {
            ignores_errors: !self.robust,
            seed: self.seed,
            ..ideal_flight::Settings::default()
        };
        let record = ideal_flight::fly_under(
            &scenario,
            &Events::default(),
            &self.pilot.policy(),
            &settings,
        );
        let record = record.map_err(|problem| {
            let Self {
                kind,
                level,
                pilot,
                seed,
                ..
            } = self;
            format!(
                "{}, {kind:?} {level}, seed {seed}, {pilot}: {problem}",
                scenario.name
            )
        })?;
        let summary = record.summary();
        let timeline = record.timeline();
        let excess = record
            .slots
            .iter()
            .map(|slot| slot.mse / timeline.in_slot(slot.slot).parameters().mse_threshold - 1.0);
        Ok(Flown {
            sum_rate: summary.sum_rate,
            lost: summary
                .knowledge
                .as_ref()
                .map_or(0.0, |knowledge| knowledge.rate_lost),
            outage: summary.mse_violations as f64 / summary.slots.max(1) as f64,
            excess: excess.fold(0.0, f64::max),
            broken: summary.constraint_violations
                + usize::from(!summary.arrived)
                + usize::from(!summary.fair),
        })
    }
}

/// The missions of each group.
pub(super) struct Missions {
    groups: [(Group, Vec<Scenario>); 3],
}

impl Missions {
    /// Reads the missions.
    ///
    /// # Errors
    /// Returns a message of one line if the benchmark cannot be read.
    pub(super) fn read(benchmark: &Path, extent: Extent) -> Result<Self, String> {
        let shipped = |name| vec![Scenario::shipped(name).expect("shipped")];
        let mut missions = crate::benchmark::missions(benchmark)?;
        missions.truncate(extent.missions);
        Ok(Self {
            groups: [
                (Group::Separated, shipped("separated")),
                (Group::Mixed, shipped("mixed")),
                (Group::Benchmark, missions),
            ],
        })
    }
}

/// Flies everything. `benchmark` is the directory with the benchmark's missions.
///
/// # Errors
/// Returns a message of one line if a mission cannot be read or flown.
pub fn measure(
    benchmark: &Path,
    extent: Extent,
    watcher: &dyn Watcher,
) -> Result<Vec<RobustnessRow>, String> {
    let missions = Missions::read(benchmark, extent)?;
    let mut rows = Vec::new();
    for (group, scenarios) in &missions.groups {
        let known = known_totals(scenarios)?;
        for kind in ErrorKind::ALL {
            watcher.busy(&format!("{}: {}", group.title(), kind.axis()));
            for level in kind.levels() {
                for &pilot in group.pilots() {
                    let naive = (kind.has_statistics() && level > 0.0).then_some(false);
                    for robust in [Some(true), naive].into_iter().flatten() {
                        let flown = fly_all(scenarios, (kind, level), (pilot, robust), extent)?;
                        rows.push(row(*group, (kind, level), (pilot, robust), &flown, &known));
                    }
                }
            }
        }
    }
    Ok(rows)
}

/// Returns the planner's total of every mission in the known world.
fn known_totals(scenarios: &[Scenario]) -> Result<Vec<f64>, String> {
    let totals = scenarios.par_iter().map(|scenario| {
        let job = Job {
            scenario,
            kind: ErrorKind::ChannelError,
            level: 0.0,
            pilot: Pilot::Planner,
            robust: true,
            seed: 1,
        };
        job.fly().map(|flown| flown.sum_rate)
    });
    totals.collect()
}

/// Returns the flights of every mission, seed by seed. The known world is flown once: no seed
/// matters there.
fn fly_all(
    scenarios: &[Scenario],
    (kind, level): (ErrorKind, f64),
    (pilot, robust): (Pilot, bool),
    extent: Extent,
) -> Result<Vec<Vec<Flown>>, String> {
    let seeds = if level == 0.0 { 1 } else { extent.seeds };
    let flights = scenarios.par_iter().map(|scenario| {
        let of_seed = (1..=seeds).into_par_iter().map(|seed| {
            let job = Job {
                scenario,
                kind,
                level,
                pilot,
                robust,
                seed,
            };
            job.fly()
        });
        of_seed.collect()
    });
    flights.collect()
}

fn row(
    group: Group,
    (kind, level): (ErrorKind, f64),
    (pilot, robust): (Pilot, bool),
    flown: &[Vec<Flown>],
    known: &[f64],
) -> RobustnessRow {
    let all = || flown.iter().flatten();
    // The interval is over what varies: seeds of one mission, or missions.
    let samples = |value: &dyn Fn(&Flown, f64) -> f64| -> Vec<f64> {
        let of_mission = flown.iter().zip(known).map(|(flights, &known)| {
            let values: Vec<f64> = flights.iter().map(|flight| value(flight, known)).collect();
            values
        });
        match flown {
            [_] => of_mission.flatten().collect(),
            _ => of_mission.map(|values| statistics::mean(&values)).collect(),
        }
    };
    let shares = samples(&|flight, known| flight.sum_rate / known);
    let outages = samples(&|flight, _| flight.outage);
    RobustnessRow {
        group,
        kind,
        level,
        pilot,
        robust,
        missions: flown.len(),
        seeds: flown.first().map_or(0, Vec::len),
        share: rounded(statistics::mean(&shares)),
        share_interval_95: statistics::half_width_95(&shares).map(rounded),
        outage: rounded(statistics::mean(&outages)),
        outage_interval_95: statistics::half_width_95(&outages).map(rounded),
        lost_share: rounded(statistics::mean(&samples(&|flight, known| {
            flight.lost / known
        }))),
        excess: rounded(all().map(|flight| flight.excess).fold(0.0, f64::max)),
        broken: all().map(|flight| flight.broken).sum(),
    }
}

/// Measures everything into the CSV files of a directory.
///
/// # Errors
/// Returns a message of one line if a mission cannot be read or flown, or a file cannot be written.
pub fn write(
    benchmark: &Path,
    extent: Extent,
    out: &Path,
    watcher: &dyn Watcher,
) -> Result<(), String> {
    let rows = measure(benchmark, extent, watcher)?;
    table::write(&out.join(format!("{NAME}.csv")), &rows)?;
    watcher.busy("moving users and silent sensors");
    let rows = measure_moving(benchmark, extent)?;
    table::write(&out.join(format!("{MOVING}.csv")), &rows)
}

/// Draws the CSV file of a directory: `robustness.svg`.
///
/// # Errors
/// Returns a message of one line if the file is missing or has other columns.
pub fn write_drawing(out: &Path) -> Result<(), String> {
    let rows: Vec<RobustnessRow> = table::read(&out.join(format!("{NAME}.csv")))?;
    let svg = drawing::chart(&rows).to_svg();
    table::write_text(&out.join(format!("{NAME}.svg")), &svg)
}
