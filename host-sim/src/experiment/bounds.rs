//! Certified bounds of the figures' missions: stored in a table, or certified now.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use crate::processor_time::ProcessorTime;
use planning::bound;
use serde::{Deserialize, Serialize};

use super::{
    Watcher,
    cell::{Cell, Topology},
    table,
};

/// The name of the file of bounds, both in the directory of shipped policies and in that of the
/// results.
pub const BOUNDS: &str = "bounds.csv";

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

/// The bounds that are known.
#[derive(Debug)]
pub(super) struct KnownBounds {
    /// By the digest of the scenario.
    rows: BTreeMap<String, BoundRow>,
    /// The digests whose bounds were certified now rather than read.
    certified: BTreeSet<String>,
    /// The file that new bounds are written to.
    path: PathBuf,
}

impl KnownBounds {
    /// Reads the bounds of these files as far as they exist; a later file counts more. New bounds
    /// are written to `path`.
    ///
    /// # Errors
    /// Returns an error if a file is not valid.
    pub(super) fn read(files: &[PathBuf], path: PathBuf) -> Result<Self, String> {
        let mut rows = BTreeMap::new();
        for file in files.iter().filter(|file| file.exists()) {
            let read: Vec<BoundRow> = table::read(file)?;
            rows.extend(
                read.into_iter()
                    .map(|row| (row.scenario_digest.clone(), row)),
            );
        }
        Ok(Self {
            rows,
            certified: BTreeSet::new(),
            path,
        })
    }

    /// Returns the certificate of a cell. An unknown one is made now and written to the file.
    ///
    /// # Errors
    /// Returns an error if the mission cannot be bounded or the file cannot be written.
    pub(super) fn of(&mut self, cell: &Cell, watcher: &dyn Watcher) -> Result<BoundRow, String> {
        let scenario = cell.scenario()?;
        let digest = scenario.digest();
        if let Some(row) = self.rows.get(&digest) {
            return Ok(row.clone());
        }
        let settings = bound::BoundSettings::default();
        let processor_time = ProcessorTime::start();
        let certificate = bound::certify(&scenario.mission, &settings, |progress| {
            let bound::BoundProgress { upper, lower, .. } = progress;
            watcher.busy(&format!("bound of {cell}: {lower:.3} to {upper:.3}"));
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
            processor_seconds: processor_time.seconds(),
            threads: rayon::current_num_threads(),
        };
        self.certified.insert(digest.clone());
        self.rows.insert(digest, row.clone());
        self.save()?;
        Ok(row)
    }

    /// Returns whether a bound was read from a table rather than certified by this command.
    pub(super) fn is_stored(&self, bound: &BoundRow) -> bool {
        !self.certified.contains(&bound.scenario_digest)
    }

    /// Writes the bounds of the figures' cells in their order, followed by all others.
    fn save(&self) -> Result<(), String> {
        let mut left = self.rows.clone();
        let mut rows = Vec::new();
        for cell in Cell::all() {
            rows.extend(left.remove(&cell.scenario()?.digest()));
        }
        rows.extend(left.into_values());
        table::write(&self.path, &rows)
    }
}
