//! Reproduces Sec. VI of the paper: every figure by name as a CSV file and an SVG drawing, with the
//! claims that the paper makes about it and whether these numbers support them.
//!
//! | module | contents |
//! |---|---|
//! | [`cell`] | the missions that are flown, the trainings that produce policies, their names |
//! | [`approach`] | the approaches that are compared |
//! | [`context`] | what the figures are measured with: settings, policies, bounds, flights |
//! | [`trainings`] | policies and learning curves: shipped, trained before, or trained now |
//! | [`bounds`] | certified bounds: stored, or certified now |
//! | [`ideal_flight`] | the flight of a scenario on the ideal vehicle |
//! | [`seed_table`], [`seeds`] | the stored results of trainings, and the flights that make them |
//! | [`totals`] | figures of total rates: `approaches`, `noise`, `strategies`, `mission-time` |
//! | [`service`] | figures of single flights: trajectories, `schedule`, `data-per-user` |
//! | [`convergence`] | learning curves |
//! | [`robustness`] | worlds that are not known exactly |
//! | [`claims`] | the claims and the verdicts |
//! | [`report`] | `index.html`, `docs/results.md`, the table of `docs/bound.md` |
//!
//! A figure is measured once, into its CSV file; drawings, verdicts and reports are made from this
//! file.

pub mod approach;
pub mod bounds;
pub mod cell;
pub mod claims;
pub mod context;
mod convergence;
pub mod ideal_flight;
mod learning_rows;
pub mod report;
pub mod robustness;
pub mod seed_table;
pub mod seeds;
pub mod service;
pub mod statistics;
pub mod table;
pub mod totals;
pub mod trainings;

use std::{fmt::Debug, path::Path};

pub use context::{ExperimentContext, ExperimentSettings};

use claims::Claim;
use figures::chart::Chart;

/// A figure of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Experiment {
    /// The reward over the episodes for several learning rates.
    Convergence,
    /// Trajectories of SAC for several thresholds, Topo.1.
    TrajectoriesSeparated,
    /// Trajectories of SAC for several thresholds, Topo.2.
    TrajectoriesMixed,
    /// Trajectories of SAC, DDPG and the straight line.
    TrajectoriesCompared,
    /// The data that every user has sent, over the threshold.
    DataPerUser,
    /// The served user of every slot.
    Schedule,
    /// The total rates of all approaches over the threshold.
    Approaches,
    /// The total rates at two noise powers.
    Noise,
    /// The total rates with one quantity held fixed, over the threshold.
    Strategies,
    /// The total rates over the mission time.
    MissionTime,
}

impl Experiment {
    /// All figures, in the paper's order.
    pub const ALL: [Self; 10] = [
        Self::Convergence,
        Self::TrajectoriesSeparated,
        Self::TrajectoriesMixed,
        Self::TrajectoriesCompared,
        Self::DataPerUser,
        Self::Schedule,
        Self::Approaches,
        Self::Noise,
        Self::Strategies,
        Self::MissionTime,
    ];

    /// Returns the name on the command line, which is also the stem of the files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Convergence => "convergence",
            Self::TrajectoriesSeparated => "trajectories-separated",
            Self::TrajectoriesMixed => "trajectories-mixed",
            Self::TrajectoriesCompared => "trajectories-compared",
            Self::DataPerUser => "data-per-user",
            Self::Schedule => "schedule",
            Self::Approaches => "approaches",
            Self::Noise => "noise",
            Self::Strategies => "strategies",
            Self::MissionTime => "mission-time",
        }
    }

    /// Returns the title, with the label of the paper's figure.
    pub fn title(self) -> &'static str {
        match self {
            Self::Convergence => "Return over episodes for four learning rates (fig:conver_r)",
            Self::TrajectoriesSeparated => "Paths in the separated topology (fig:topo1)",
            Self::TrajectoriesMixed => "Paths in the mixed topology (fig:topo2)",
            Self::TrajectoriesCompared => "Paths of the approaches compared (fig:topo_ddpg)",
            Self::DataPerUser => "Data sent by each user, over the threshold (fig:data)",
            Self::Schedule => "Served user of each slot (fig:access)",
            Self::Approaches => "Approaches to the outer problem, over the threshold (fig:alg)",
            Self::Noise => "SAC (tuned) at two noise powers (fig:sigma)",
            Self::Strategies => "One quantity held fixed, over the threshold (fig:diffing)",
            Self::MissionTime => "One quantity held fixed, over the mission time (fig:diffint)",
        }
    }

    /// Measures the figure and writes `NAME.csv`.
    ///
    /// # Errors
    /// Returns a message of one line if something is missing or fails.
    pub fn measure(self, context: &mut ExperimentContext<'_>) -> Result<(), String> {
        let path = self.csv(&context.settings().out);
        match self {
            Self::Convergence => table::write(&path, &convergence::measure(context)?),
            Self::TrajectoriesSeparated
            | Self::TrajectoriesMixed
            | Self::TrajectoriesCompared
            | Self::Schedule => table::write(&path, &service::measure(self, context)?),
            Self::DataPerUser => table::write(&path, &service::measure_data(context)?),
            Self::Approaches | Self::Noise | Self::Strategies | Self::MissionTime => {
                table::write(&path, &totals::measure(self, context)?)
            }
        }
    }

    /// Draws the contents of `NAME.csv` in a directory.
    ///
    /// # Errors
    /// Returns a message of one line if the file is missing or has other columns.
    pub fn draw(self, directory: &Path) -> Result<Chart, String> {
        let path = self.csv(directory);
        Ok(match self {
            Self::Convergence => convergence::chart(self.title(), &table::read(&path)?),
            Self::TrajectoriesSeparated | Self::TrajectoriesMixed | Self::TrajectoriesCompared => {
                service::map(self, &table::read(&path)?)?
            }
            Self::Schedule => service::timeline(&table::read(&path)?),
            Self::DataPerUser => service::data_chart(&table::read(&path)?),
            Self::Approaches | Self::Noise | Self::Strategies | Self::MissionTime => {
                totals::chart(self, &table::read(&path)?)
            }
        })
    }

    /// Returns the paper's claims about the figure with the verdicts from `NAME.csv` in a
    /// directory.
    ///
    /// # Errors
    /// Returns a message of one line if the file is missing or has other columns.
    pub fn claims(self, directory: &Path) -> Result<Vec<Claim>, String> {
        let path = self.csv(directory);
        Ok(match self {
            Self::Convergence => convergence::claims(&table::read(&path)?),
            Self::TrajectoriesSeparated | Self::TrajectoriesMixed => {
                service::claims_of_thresholds(self, &table::read(&path)?)?
            }
            Self::TrajectoriesCompared => service::claims_of_approaches(&table::read(&path)?),
            Self::Schedule => service::claims_of_schedule(&table::read(&path)?),
            Self::DataPerUser => service::claims_of_data(&table::read(&path)?),
            Self::Approaches => totals::claims_of_approaches(&table::read(&path)?),
            Self::Noise => totals::claims_of_noise(&table::read(&path)?),
            Self::Strategies => totals::claims_of_strategies(&table::read(&path)?),
            Self::MissionTime => totals::claims_of_mission_time(&table::read(&path)?),
        })
    }

    /// Returns the path of the CSV file in a directory.
    pub fn csv(self, directory: &Path) -> std::path::PathBuf {
        directory.join(format!("{}.csv", self.name()))
    }
}

/// Receives progress messages, from any thread.
pub trait Watcher: Sync + Debug {
    /// Reports that a task has begun.
    fn busy(&self, what: &str);
}

/// Ignores all messages.
impl Watcher for () {
    fn busy(&self, _: &str) {}
}

/// Rounds to a millionth: flights are reproducible to the last digit only on machines with the same
/// vector instructions.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
