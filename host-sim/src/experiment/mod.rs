//! The paper's Sec. VI again: every figure by name, each as a CSV file and an SVG drawing, what the
//! paper claims of it, and whether these numbers show it.
//!
//! | room | what it owns |
//! |---|---|
//! | [`cell`] | the missions that are flown, the trainings that policies come from, their names |
//! | [`context`] | policies (shipped or trained now), certified bounds, flights |
//! | [`totals`] | figures of total rates: `approaches`, `noise`, `strategies`, `mission-time` |
//! | [`service`] | figures of single flights: trajectories, `schedule`, `data-per-user` |
//! | [`convergence`] | learning curves |
//! | [`claims`] | what is claimed, and the verdict |
//! | [`report`] | `index.html`, `docs/results.md`, the table of `docs/bound.md` |
//!
//! A figure is measured once, into its CSV file; drawings, verdicts and reports are made from
//! what stands there.

pub mod cell;
pub mod claims;
pub mod context;
mod convergence;
mod figure;
mod learning_rows;
pub mod report;
pub mod service;
pub mod statistics;
pub mod table;
pub mod totals;

use std::{fmt::Debug, path::Path};

pub use context::{ExperimentContext, Settings};

use claims::Claim;

/// A figure of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Experiment {
    /// Reward over episodes for several learning rates.
    Convergence,
    /// Paths of SAC for several thresholds, Topo.1.
    TrajectoriesSeparated,
    /// Paths of SAC for several thresholds, Topo.2.
    TrajectoriesMixed,
    /// Paths of SAC, DDPG and the straight line.
    TrajectoriesCompared,
    /// What every user has sent, over the threshold.
    DataPerUser,
    /// Who is served when.
    Schedule,
    /// Total rates of all approaches over the threshold.
    Approaches,
    /// Total rates at two noise powers.
    Noise,
    /// Total rates with something held fixed, over the threshold.
    Strategies,
    /// Total rates over the mission time.
    MissionTime,
}

impl Experiment {
    /// All, in the paper's order.
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

    /// Its name on the command line, and its files' stem.
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

    /// What it shows, and the label of the paper's figure.
    pub fn title(self) -> &'static str {
        match self {
            Self::Convergence => "Return over episodes for four learning rates (fig:conver_r)",
            Self::TrajectoriesSeparated => "Paths in the separated topology (fig:topo1)",
            Self::TrajectoriesMixed => "Paths in the mixed topology (fig:topo2)",
            Self::TrajectoriesCompared => "Paths of the approaches compared (fig:topo_ddpg)",
            Self::DataPerUser => "What each user has sent, over the threshold (fig:data)",
            Self::Schedule => "Who is served when (fig:access)",
            Self::Approaches => "Approaches to the outer problem, over the threshold (fig:alg)",
            Self::Noise => "SAC at two noise powers (fig:sigma)",
            Self::Strategies => "With something held fixed, over the threshold (fig:diffing)",
            Self::MissionTime => "With something held fixed, over the mission time (fig:diffint)",
        }
    }

    /// Measures it and writes `NAME.csv`.
    ///
    /// # Errors
    /// What is missing or fails, in one line.
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

    /// Draws what `NAME.csv` in a directory holds.
    ///
    /// # Errors
    /// A file that is missing or has other columns, in one line.
    pub fn draw(self, directory: &Path) -> Result<String, String> {
        let path = self.csv(directory);
        let figure = match self {
            Self::Convergence => convergence::figure(&table::read(&path)?),
            Self::TrajectoriesSeparated | Self::TrajectoriesMixed | Self::TrajectoriesCompared => {
                service::map(self, &table::read(&path)?)?
            }
            Self::Schedule => service::timeline(&table::read(&path)?),
            Self::DataPerUser => service::data_figure(&table::read(&path)?),
            Self::Approaches | Self::Noise | Self::Strategies | Self::MissionTime => {
                totals::figure(self, &table::read(&path)?)
            }
        };
        figure.to_svg()
    }

    /// What the paper claims of it, beside what `NAME.csv` in a directory says.
    ///
    /// # Errors
    /// A file that is missing or has other columns, in one line.
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

    /// Its CSV file in a directory.
    pub fn csv(self, directory: &Path) -> std::path::PathBuf {
        directory.join(format!("{}.csv", self.name()))
    }
}

/// Told what is being done, from any thread.
pub trait Watcher: Sync + Debug {
    /// This has begun.
    fn busy(&self, what: &str);
}

/// Watches nothing.
impl Watcher for () {
    fn busy(&self, _: &str) {}
}

/// To a millionth: flights repeat to the last digits only on machines with the same vector
/// instructions.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
