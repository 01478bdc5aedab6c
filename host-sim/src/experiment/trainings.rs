//! Policies and learning curves of trainings: shipped, trained before, or trained now by the program
//! `trainer`.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use rayon::prelude::*;

use super::{
    Watcher,
    cell::{Cell, Learner, MSE_THRESHOLD, Training},
    learning_rows::{LearningRow, is_among},
    seed_table::SeedRow,
    table,
};

/// The name of the file that a run writes if its loss diverged.
const DIVERGED: &str = "diverged.json";
/// The name of the file of learning curves, both in the directory of shipped policies and in that
/// of the results.
const LEARNING_CURVES: &str = "learning_curves.csv";
/// The subdirectory of shipped policies in the directory of models.
pub(super) const CELLS: &str = "cells";
/// The subdirectory of the results for policies that `--train` made.
const POLICIES: &str = "policies";
/// The subdirectory of the results for the runs that produced these policies.
const RUNS: &str = "runs";

/// A run of a learner: a policy to fly, or the stored result of its flight.
#[derive(Clone, Debug)]
pub enum Run {
    /// A policy whose file is there, or that the trainer makes.
    Policy(Training),
    /// A row of `seeds.csv` whose policy is not there.
    Stored(SeedRow),
}

/// Where trainings are found, and what makes those that are missing.
#[derive(Debug)]
pub struct Trainings<'a> {
    /// The directory of the results.
    pub(super) out: PathBuf,
    /// The directory of the shipped policies and learning curves.
    pub(super) models: PathBuf,
    /// The trainer; with `None` a missing policy is an error.
    pub(super) trainer: Option<PathBuf>,
    /// The largest seed of a training that is measured with several seeds.
    pub(super) seeds_max: u64,
    /// The rows of `seeds.csv`.
    pub(super) stored: Vec<SeedRow>,
    /// Is told what is trained.
    pub(super) watcher: &'a dyn Watcher,
}

impl Trainings<'_> {
    /// Returns the file of a trained policy if it exists: trained before, or shipped.
    pub fn find(&self, training: &Training) -> Option<PathBuf> {
        let name = format!("{training}.onnx");
        let Self { out, models, .. } = self;
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
        if let (Some(first), None) = (missing.first(), &self.trainer) {
            return Err(format!(
                "{} policies are missing, {first}.onnx first, neither in {} nor in {}: {}--train \
                 trains them",
                missing.len(),
                self.models.join(CELLS).display(),
                self.out.join(POLICIES).display(),
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
        for seed in 1..=seeds.min(self.seeds_max) {
            let training = Training::new(cell, learner, seed);
            if self.find(&training).is_some() {
                runs.push(Run::Policy(training));
            } else if let Some(row) = self.stored(&training)? {
                runs.push(Run::Stored(row.clone()));
            } else if self.trainer.is_some() {
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
        let mut rows = self.stored.iter();
        Ok(rows.find(|row| row.is_of(training, &digest)))
    }

    /// Trains as many policies at a time as there are processors. An interrupted training is
    /// resumed.
    ///
    /// # Errors
    /// Returns the error of the first training that fails.
    pub fn train(&self, trainings: &[&Training]) -> Result<(), String> {
        let Some(trainer) = &self.trainer else {
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
        let path = self.out.join(format!("{stem}.toml"));
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
            .map_err(|error| files::named(trainer, error))?;
        if !output.status.success() {
            let complaint = String::from_utf8_lossy(&output.stderr);
            return Err(format!("training {training}: {}", complaint.trim_end()));
        }
        let policies = self.out.join(POLICIES);
        fs::create_dir_all(&policies).map_err(|error| files::named(&policies, error))?;
        let made = run.join("policy.onnx");
        let bytes = fs::read(&made).map_err(|error| files::named(&made, error))?;
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
        let Self { out, models, .. } = self;
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
        let Some(trainer) = &self.trainer else {
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
            let has_diverged = || run.join(DIVERGED).exists();
            match has_diverged() {
                true => Ok(()),
                false => self
                    .train_one(trainer, training)
                    .or_else(|problem| has_diverged().then_some(()).ok_or(problem)),
            }
        })?;
        let output = Command::new(trainer)
            .arg("curves")
            .args(missing.iter().map(|training| self.run_directory(training)))
            .arg("--out")
            .arg(&made)
            .output()
            .map_err(|error| files::named(trainer, error))?;
        if !output.status.success() {
            let complaint = String::from_utf8_lossy(&output.stderr);
            return Err(format!("learning curves: {}", complaint.trim_end()));
        }
        rows.extend(table::read(&made)?);
        Ok(rows)
    }

    /// Returns what to try first if there are no shipped policies in the directory of models.
    fn elsewhere(&self) -> &'static str {
        match self.models.join(CELLS).is_dir() {
            true => "",
            false => {
                "--models DIR names the repository's directory models, which is looked for in the \
                 current directory; "
            }
        }
    }

    /// Returns the directory of a training's run.
    pub fn run_directory(&self, training: &Training) -> PathBuf {
        self.out.join(RUNS).join(training.to_string())
    }
}
