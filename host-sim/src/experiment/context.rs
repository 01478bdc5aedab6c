//! What the figures are measured with: the settings, the trainings, the bounds and the flights.

use std::{fs, path::PathBuf};

use super::{
    Watcher,
    bounds::{BOUNDS, BoundRow, KnownBounds},
    cell::Cell,
    ideal_flight,
    seed_table::SEEDS,
    table,
    trainings::Trainings,
};
use crate::{policy::PolicyChoice, record::FlightRecord};
use environment::Allocation;
use scenario::Events;

/// The settings of an experiment.
#[derive(Clone, Debug)]
pub struct ExperimentSettings {
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

/// Provides the data of the figures.
#[derive(Debug)]
pub struct ExperimentContext<'a> {
    settings: ExperimentSettings,
    trainings: Trainings<'a>,
    bounds: KnownBounds,
    watcher: &'a dyn Watcher,
}

impl<'a> ExperimentContext<'a> {
    /// Reads the known bounds and the stored results of trainings.
    ///
    /// # Errors
    /// Returns an error if a file of bounds or the table of trainings is not valid, or a directory
    /// cannot be created.
    pub fn open(settings: ExperimentSettings, watcher: &'a dyn Watcher) -> Result<Self, String> {
        let ExperimentSettings { out, models, .. } = &settings;
        fs::create_dir_all(out).map_err(|error| files::named(out, error))?;
        let files = match settings.fresh {
            true => Vec::new(),
            false => vec![models.join(BOUNDS), out.join(BOUNDS)],
        };
        let bounds = KnownBounds::read(&files, out.join(BOUNDS))?;
        let stored = match models.join(SEEDS) {
            path if path.exists() => table::read(&path)?,
            _ => Vec::new(),
        };
        let trainings = Trainings {
            out: out.clone(),
            models: models.clone(),
            trainer: settings.trainer.clone(),
            seeds_max: settings.seeds,
            stored,
            watcher,
        };
        Ok(Self {
            settings,
            trainings,
            bounds,
            watcher,
        })
    }

    /// Returns the settings.
    pub fn settings(&self) -> &ExperimentSettings {
        &self.settings
    }

    /// Returns the policies and learning curves.
    pub fn trainings(&self) -> &Trainings<'a> {
        &self.trainings
    }

    /// Returns the certificate of a cell. An unknown one is made now and written to the file.
    ///
    /// # Errors
    /// Returns an error if the mission cannot be bounded or a file cannot be written.
    pub fn bound(&mut self, cell: &Cell) -> Result<BoundRow, String> {
        self.bounds.of(cell, self.watcher)
    }

    /// Returns whether a bound was read from a table rather than certified by this command.
    pub fn is_stored(&self, bound: &BoundRow) -> bool {
        self.bounds.is_stored(bound)
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
        ideal_flight::fly(&cell.scenario()?, &Events::default(), policy, inner)
            .map_err(|problem| format!("{cell} under {policy}: {problem}"))
    }
}
