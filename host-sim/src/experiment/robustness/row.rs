//! What is measured: missions, pilots, and a row of the table.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::error_kind::ErrorKind;
use crate::policy::PolicyChoice;

/// The name on the command line, and the stem of the files.
pub const NAME: &str = "robustness";
/// The stem of the file of flights with moving users and silent sensors.
pub(super) const MOVING: &str = "moving";
/// The stem of the drawing of outages.
pub(super) const OUTAGE: &str = "robustness-outage";

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

    pub(super) fn policy(self) -> PolicyChoice {
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

    pub(super) fn title(self) -> &'static str {
        match self {
            Self::Separated => "separated",
            Self::Mixed => "mixed",
            Self::Benchmark => "benchmark",
        }
    }

    pub(super) fn pilots(self) -> &'static [Pilot] {
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
