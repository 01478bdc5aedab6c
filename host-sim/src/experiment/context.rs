//! Provides policies, bounds and flights: shipped, trained before, or made now.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    Watcher,
    cell::{Cell, Learner, MSE_THRESHOLD, Topology, Training},
    learning_rows::{LearningRow, is_among},
    seed_table::{SEEDS, SeedRow},
    table,
};
use crate::{
    flight::{self, FlightSettings, Pace, Peer},
    policy::{HostPolicy, PolicyChoice},
    record::FlightRecord,
};
use environment::Allocation;
use planning::bound;
use scenario::{Events, Scenario};
use vehicle::{Profile, Vehicle};

/// The settings of an experiment.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The directory of the results, including trainings and new bounds.
    pub out: PathBuf,
    /// The directory of the shipped policies, bounds and learning curves.
    pub models: PathBuf,
    /// The trainer that produces missing policies; with `None` a missing policy is an error.
    pub trainer: Option<PathBuf>,
    /// The number of seeds, from 1, of each training that is measured with several seeds: without a
    /// trainer the available ones among them, with a trainer all of them.
    pub seeds: u64,
    /// Whether to certify every bound again.
    pub fresh: bool,
}

/// The certificate of a cell: a row of `bounds.csv`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoundRow {
    /// The topology of the mission.
    pub topology: Topology,
    /// `T`, seconds.
    pub mission_time_s: u32,
    /// `sigma^2`, dBm.
    pub noise_dbm: f64,
    /// `Gamma`.
    pub mse_threshold: f64,
    /// The digest of the scenario, by which the row is found.
    pub scenario_digest: String,
    /// The upper bound of the sum of rates of any mission, bit/s/Hz.
    pub upper: f64,
    /// The sum of rates of the best known mission, bit/s/Hz.
    pub lower: f64,
    /// The side of the smallest cells, metres.
    pub cell_m: f64,
    /// The number of parts that the missions were divided into.
    pub parts: usize,
    /// The wall-clock time on the machine that made the row, seconds.
    pub seconds: f64,
    /// The processor time over all processors, seconds; more meaningful on a shared machine. The
    /// wall-clock time if the system does not report it.
    pub processor_seconds: f64,
    /// The number of threads.
    pub threads: usize,
}

/// Provides the data of the figures.
#[derive(Debug)]
pub struct ExperimentContext<'a> {
    settings: Settings,
    bounds: BTreeMap<String, BoundRow>,
    /// The digests whose bounds were certified now rather than read.
    certified: BTreeSet<String>,
    seeds: Vec<SeedRow>,
    watcher: &'a dyn Watcher,
}

/// A run of a learner: a policy to fly, or the stored result of its flight.
#[derive(Clone, Debug)]
pub enum Run {
    /// A policy whose file is there, or that the trainer makes.
    Policy(Training),
    /// A row of `seeds.csv` whose policy is not there.
    Stored(SeedRow),
}

/// The name of the file of bounds, both in the directory of shipped policies and in that of the
/// results.
pub const BOUNDS: &str = "bounds.csv";

impl<'a> ExperimentContext<'a> {
    /// Reads the known bounds and the stored results of trainings.
    ///
    /// # Errors
    /// Returns an error if a file of bounds or the table of trainings is not valid, or a directory
    /// cannot be created.
    pub fn open(settings: Settings, watcher: &'a dyn Watcher) -> Result<Self, String> {
        fs::create_dir_all(&settings.out).map_err(|error| table::named(&settings.out, error))?;
        let mut bounds = BTreeMap::new();
        let places = [&settings.models, &settings.out].map(|place| place.join(BOUNDS));
        for path in places
            .iter()
            .filter(|path| !settings.fresh && path.exists())
        {
            let rows: Vec<BoundRow> = table::read(path)?;
            bounds.extend(
                rows.into_iter()
                    .map(|row| (row.scenario_digest.clone(), row)),
            );
        }
        let seeds = match settings.models.join(SEEDS) {
            path if path.exists() => table::read(&path)?,
            _ => Vec::new(),
        };
        Ok(Self {
            settings,
            bounds,
            certified: BTreeSet::new(),
            seeds,
            watcher,
        })
    }

    /// Returns the settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the certificate of a cell. An unknown one is made now and written to the file.
    ///
    /// # Errors
    /// Returns an error if the mission cannot be bounded or a file cannot be written.
    pub fn bound(&mut self, cell: &Cell) -> Result<BoundRow, String> {
        let scenario = cell.scenario()?;
        let digest = scenario.digest();
        if let Some(row) = self.bounds.get(&digest) {
            return Ok(row.clone());
        }
        let settings = bound::BoundSettings::default();
        let before_s = processor_seconds();
        let certificate = bound::certify(&scenario.mission, &settings, |progress| {
            let bound::BoundProgress { upper, lower, .. } = progress;
            self.watcher
                .busy(&format!("bound of {cell}: {lower:.3} to {upper:.3}"));
        })
        .map_err(|error| error.to_string())?;
        let row = BoundRow {
            topology: cell.topology,
            mission_time_s: cell.slots,
            noise_dbm: cell.noise_dbm,
            mse_threshold: cell.mse_threshold,
            scenario_digest: digest.clone(),
            upper: certificate.upper,
            lower: certificate.lower,
            cell_m: certificate.cell_m,
            parts: certificate.leaves,
            seconds: certificate.seconds,
            processor_seconds: match (before_s, processor_seconds()) {
                (Some(before_s), Some(after_s)) => after_s - before_s,
                _ => certificate.seconds,
            },
            threads: rayon::current_num_threads(),
        };
        self.certified.insert(digest.clone());
        self.bounds.insert(digest, row.clone());
        self.save_bounds()?;
        Ok(row)
    }

    /// Returns whether a bound was read from a table rather than certified by this command.
    pub fn is_stored(&self, bound: &BoundRow) -> bool {
        !self.certified.contains(&bound.scenario_digest)
    }

    /// Writes the bounds of the figures' cells in their order, followed by all others.
    fn save_bounds(&self) -> Result<(), String> {
        let mut left = self.bounds.clone();
        let mut rows = Vec::new();
        for cell in Cell::all() {
            rows.extend(left.remove(&cell.scenario()?.digest()));
        }
        rows.extend(left.into_values());
        table::write(&self.settings.out.join(BOUNDS), &rows)
    }

    /// Returns the file of a trained policy if it exists: trained before, or shipped.
    pub fn find(&self, training: &Training) -> Option<PathBuf> {
        let name = format!("{training}.onnx");
        let Settings { out, models, .. } = &self.settings;
        let places = [out.join(POLICIES), models.join(CELLS)];
        places
            .into_iter()
            .map(|place| place.join(&name))
            .find(|path| path.is_file())
    }

    /// Makes sure that every training is finished, and returns the path of each policy.
    ///
    /// # Errors
    /// Returns an error if a policy is missing and there is no trainer, or if a training fails.
    pub fn policies(&self, trainings: &[Training]) -> Result<Vec<PathBuf>, String> {
        let missing: Vec<&Training> = trainings
            .iter()
            .filter(|training| self.find(training).is_none())
            .collect();
        if let (Some(first), None) = (missing.first(), &self.settings.trainer) {
            return Err(format!(
                "{} policies are missing, {first}.onnx first, neither in {} nor in {}: {}--train \
                 trains them",
                missing.len(),
                self.settings.models.join(CELLS).display(),
                self.settings.out.join(POLICIES).display(),
                self.elsewhere(),
            ));
        }
        self.train(&missing)?;
        let place = |training: &Training| {
            let found = self.find(training);
            found.ok_or_else(|| format!("the trainer left no policy {training}.onnx"))
        };
        trainings.iter().map(place).collect()
    }

    /// Returns the runs of a learner on a mission, for seeds from 1 to `seeds` at most: the policy
    /// if its file is there, or else its row in `seeds.csv`, or else, with a trainer, a policy that
    /// is to be trained. If there is none, the policy of seed 1, which [`Self::policies`] then
    /// reports as missing.
    ///
    /// # Errors
    /// Returns an error if the mission is not valid.
    pub fn runs(&self, cell: Cell, learner: Learner, seeds: u64) -> Result<Vec<Run>, String> {
        let mut runs = Vec::new();
        for seed in 1..=seeds.min(self.settings.seeds) {
            let training = Training::new(cell, learner, seed);
            if self.find(&training).is_some() {
                runs.push(Run::Policy(training));
            } else if let Some(row) = self.stored(&training)? {
                runs.push(Run::Stored(row.clone()));
            } else if self.settings.trainer.is_some() {
                runs.push(Run::Policy(training));
            }
        }
        if runs.is_empty() {
            runs.push(Run::Policy(Training::new(cell, learner, 1)));
        }
        Ok(runs)
    }

    /// Returns the row of a training in `seeds.csv`.
    ///
    /// # Errors
    /// Returns an error if the mission is not valid.
    pub fn stored(&self, training: &Training) -> Result<Option<&SeedRow>, String> {
        let digest = training.cell.scenario()?.digest();
        let mut rows = self.seeds.iter();
        Ok(rows.find(|row| row.is_of(training, &digest)))
    }

    /// Trains as many policies at a time as there are processors. An interrupted training is
    /// resumed.
    ///
    /// # Errors
    /// Returns the error of the first training that fails.
    pub fn train(&self, trainings: &[&Training]) -> Result<(), String> {
        let Some(trainer) = &self.settings.trainer else {
            return Ok(());
        };
        trainings.par_iter().try_for_each(|training| {
            self.watcher.busy(&format!("training {training}"));
            self.train_one(trainer, training)
        })
    }

    /// Returns the value of `--scenario`: a shipped scenario, or a file that is written now.
    fn scenario_of(&self, training: &Training) -> Result<String, String> {
        let Some(stem) = training.scenario_stem() else {
            return Ok(training.cell.topology.name().to_owned());
        };
        // The threshold is a separate argument, so cells share the file.
        let cell = training.cell.at_threshold(MSE_THRESHOLD);
        let path = self.settings.out.join(format!("{stem}.toml"));
        table::write_text(&path, &cell.scenario()?.to_toml())?;
        Ok(path.display().to_string())
    }

    fn train_one(&self, trainer: &Path, training: &Training) -> Result<(), String> {
        let run = self.run_directory(training);
        let arguments = match run.join("checkpoint.bin").exists() {
            // The scenario and the settings are stored in the run.
            true => vec!["train".into(), "--resume".into()],
            false => training.arguments(&self.scenario_of(training)?),
        };
        let output = Command::new(trainer)
            .args(&arguments)
            .arg("--out")
            .arg(&run)
            .arg("--quiet")
            .stdin(Stdio::null())
            .output()
            .map_err(|error| table::named(trainer, error))?;
        if !output.status.success() {
            let complaint = String::from_utf8_lossy(&output.stderr);
            return Err(format!("training {training}: {}", complaint.trim_end()));
        }
        let policies = self.settings.out.join(POLICIES);
        fs::create_dir_all(&policies).map_err(|error| table::named(&policies, error))?;
        let made = run.join("policy.onnx");
        let bytes = fs::read(&made).map_err(|error| table::named(&made, error))?;
        // Only a finished training has its policy here: the file is written at once, as the last
        // step.
        table::write_bytes(&policies.join(format!("{training}.onnx")), &bytes)
    }

    /// Returns the learning curves of the trainings: shipped ones, or those of the runs that are
    /// made now.
    ///
    /// # Errors
    /// Returns an error if curves are missing and there is no trainer, or if a training fails.
    pub(super) fn learning_curves(
        &self,
        trainings: &[Training],
    ) -> Result<Vec<LearningRow>, String> {
        let Settings { out, models, .. } = &self.settings;
        let made = out.join(LEARNING_CURVES);
        let mut rows = Vec::new();
        for path in [models.join(LEARNING_CURVES), made.clone()] {
            if path.exists() {
                rows.extend(table::read(&path)?);
            }
        }
        let missing: Vec<&Training> = trainings
            .iter()
            .filter(|training| !is_among(training, &rows))
            .collect();
        let Some(first) = missing.first() else {
            return Ok(rows);
        };
        let Some(trainer) = &self.settings.trainer else {
            if missing.iter().all(|training| training.seed > 1) {
                return Ok(rows);
            }
            return Err(format!(
                "{} learning curves are missing, that of {first} first, in {}: {}--train trains \
                 them",
                missing.len(),
                models.join(LEARNING_CURVES).display(),
                self.elsewhere(),
            ));
        };
        // A learning rate that is too large may make a run diverge: the curve ends there.
        missing.par_iter().try_for_each(|training| {
            let run = self.run_directory(training);
            let broken_off = || run.join(BROKEN_OFF).exists();
            match broken_off() {
                true => Ok(()),
                false => self
                    .train_one(trainer, training)
                    .or_else(|problem| broken_off().then_some(()).ok_or(problem)),
            }
        })?;
        let output = Command::new(trainer)
            .arg("curves")
            .args(missing.iter().map(|training| self.run_directory(training)))
            .arg("--out")
            .arg(&made)
            .output()
            .map_err(|error| table::named(trainer, error))?;
        if !output.status.success() {
            let complaint = String::from_utf8_lossy(&output.stderr);
            return Err(format!("learning curves: {}", complaint.trim_end()));
        }
        rows.extend(table::read(&made)?);
        Ok(rows)
    }

    /// Returns what to try first if there are no shipped policies in the directory of models.
    fn elsewhere(&self) -> &'static str {
        match self.settings.models.join(CELLS).is_dir() {
            true => "",
            false => {
                "--models DIR names the repository's directory models, which is looked for in the \
                 current directory; "
            }
        }
    }

    /// Returns the directory of a training's run.
    pub fn run_directory(&self, training: &Training) -> PathBuf {
        self.settings.out.join(RUNS).join(training.to_string())
    }

    /// Flies a cell through the whole loop: controller, ground link, MAVLink, the ideal vehicle.
    ///
    /// # Errors
    /// Returns a message of one line if the policy cannot be loaded or does not fit, or if the
    /// flight was aborted.
    pub fn fly(
        &self,
        cell: &Cell,
        policy: &PolicyChoice,
        inner: Allocation,
    ) -> Result<FlightRecord, String> {
        self.watcher.busy(&format!("flying {cell}: {policy}"));
        fly(&cell.scenario()?, &Events::default(), policy, inner)
            .map_err(|problem| format!("{cell} under {policy}: {problem}"))
    }
}

/// Returns the time that this process has used on all processors.
#[cfg(unix)]
fn processor_seconds() -> Option<f64> {
    let used = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(used.tv_sec as f64 + 1e-9 * used.tv_nsec as f64)
}

#[cfg(not(unix))]
fn processor_seconds() -> Option<f64> {
    None
}

/// Flies a scenario on the built-in ideal vehicle.
///
/// # Errors
/// Returns a message of one line if the policy cannot be loaded or does not fit, or if the flight
/// was aborted.
pub fn fly(
    scenario: &Scenario,
    events: &Events,
    policy: &PolicyChoice,
    inner: Allocation,
) -> Result<FlightRecord, String> {
    let (policy, name) = HostPolicy::load(policy, scenario)?;
    let settings = FlightSettings {
        policy: name,
        inner,
        profile: Profile::Ideal,
        pace: Pace::Max,
        seed: 1,
        // The rates are analytic; the signals are drawn by `host-sim run`.
        symbols_per_slot: 1,
        events: events.clone(),
    };
    let vehicle = Vehicle::new(flight::vehicle_settings(scenario, Profile::Ideal));
    let flown = flight::fly(
        scenario,
        policy,
        &settings,
        Peer::built_in(vehicle),
        &mut (),
    );
    flown.map_err(|failed| failed.error.to_string())
}

/// The name of the file that a run writes if its loss diverged.
const BROKEN_OFF: &str = "diverged.json";
/// The name of the file of learning curves, both in the directory of shipped policies and in that
/// of the results.
const LEARNING_CURVES: &str = "learning_curves.csv";
/// The subdirectory of shipped policies in the directory of models.
pub(super) const CELLS: &str = "cells";
/// The subdirectory of the results for policies that `--train` made.
const POLICIES: &str = "policies";
/// The subdirectory of the results for the runs that produced these policies.
const RUNS: &str = "runs";
