//! Certified bounds as a file: `bounds.csv` in the directory of the scenarios.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::processor_time::ProcessorTime;
use planning::bound;
use scenario::Scenario;

/// The name of the file.
pub const FILE_NAME: &str = "bounds.csv";

/// The certified bound of one mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoundRecord {
    /// The scenario's name.
    pub mission: String,
    /// The mission's digest.
    pub digest: String,
    /// No mission has a larger sum of rates, bit/s/Hz.
    pub upper: f64,
    /// The sum of rates of the mission that the bound's own search found, bit/s/Hz.
    pub lower: f64,
    /// `(upper - lower) / upper`.
    pub gap: f64,
    /// The processor time of the certification over all processors, seconds; 0 in files of earlier
    /// versions, which do not state it.
    #[serde(default)]
    pub processor_seconds: f64,
}

impl BoundRecord {
    /// Returns what this record and another one of the same mission prove together.
    pub fn tighter(self, other: &Self) -> Self {
        let (upper, lower) = (self.upper.min(other.upper), self.lower.max(other.lower));
        // Rounding may put the bounds of a mission that carries nothing in the wrong order.
        let gap = if self.gap == 0.0 {
            0.0
        } else {
            (upper - lower) / upper
        };
        Self {
            upper,
            lower,
            gap,
            processor_seconds: self.processor_seconds + other.processor_seconds,
            ..self
        }
    }
}

/// The bounds of the 200 missions of the benchmark.
const SHIPPED: &str = include_str!("../../../../benchmarks/bounds.csv");

/// The bounds of a set of missions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bounds {
    records: Vec<BoundRecord>,
}

impl Bounds {
    /// Returns the certified bounds of the benchmark's missions, `benchmarks/bounds.csv`.
    pub fn shipped() -> Self {
        let records = csv::Reader::from_reader(SHIPPED.as_bytes()).into_deserialize();
        let records: Result<Vec<BoundRecord>, _> = records.collect();
        Self {
            records: records.expect("the file in the repository is read by a test"),
        }
    }

    /// Reads `bounds.csv` of a directory; returns no bounds if there is no such file.
    ///
    /// # Errors
    /// Returns a message of one line if the file is not readable.
    pub fn read(folder: &Path) -> Result<Self, String> {
        let path = folder.join(FILE_NAME);
        if !path.exists() {
            return Ok(Self::default());
        }
        let named = |error: csv::Error| format!("{}: {error}", path.display());
        let mut reader = csv::Reader::from_path(&path).map_err(named)?;
        let records: Result<Vec<BoundRecord>, _> = reader.deserialize().collect();
        Ok(Self {
            records: records.map_err(named)?,
        })
    }

    /// Writes `bounds.csv` into a directory, sorted by the name of the mission.
    ///
    /// # Errors
    /// Returns a message of one line if the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), String> {
        let path = folder.join(FILE_NAME);
        let named = |error: csv::Error| format!("{}: {error}", path.display());
        let mut writer = csv::Writer::from_path(&path).map_err(named)?;
        for record in &self.records {
            writer.serialize(record).map_err(named)?;
        }
        writer
            .flush()
            .map_err(|error| format!("{}: {error}", path.display()))
    }

    /// Returns the number of bounds.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Returns whether there are no bounds.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Returns the bound of the mission with this digest.
    pub fn of(&self, digest: &str) -> Option<&BoundRecord> {
        self.records.iter().find(|record| record.digest == digest)
    }

    /// Adds a record; it replaces a record for the same scenario name.
    pub fn insert(&mut self, record: BoundRecord) {
        self.records.retain(|known| known.mission != record.mission);
        self.records.push(record);
        self.records.sort_by(|a, b| a.mission.cmp(&b.mission));
    }

    /// Certifies the bound of a scenario with the default settings, on all threads of the present
    /// pool. This takes seconds to minutes. The processor time is that of the whole process.
    ///
    /// # Errors
    /// Returns a message of one line if the mission is too large to be bounded.
    pub fn certify(scenario: &Scenario) -> Result<BoundRecord, String> {
        Self::certify_until(scenario, &|| false)
    }

    /// Like [`Bounds::certify`], and stops as soon as `stop` returns true. The bound is then valid, but
    /// not as tight.
    ///
    /// # Errors
    /// Like [`Bounds::certify`].
    pub fn certify_until(
        scenario: &Scenario,
        stop: &(impl Fn() -> bool + Sync),
    ) -> Result<BoundRecord, String> {
        let processor_time = ProcessorTime::start();
        let settings = bound::BoundSettings::default();
        let bound = bound::certify_until(&scenario.mission, &settings, stop, |_| {})
            .map_err(|error| format!("{}: {error}", scenario.name))?;
        Ok(BoundRecord {
            mission: scenario.name.clone(),
            digest: scenario.digest(),
            upper: bound.upper,
            lower: bound.lower,
            gap: bound.gap,
            processor_seconds: processor_time.seconds(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The missions of the benchmark need no files: they are drawn from their seeds.
    #[test]
    fn the_shipped_bounds_are_those_of_seeds_1_to_200() {
        let bounds = Bounds::shipped();
        assert_eq!(bounds.len(), 200);
        for seed in 1..=200 {
            let scenario = scenario::random(seed, None).expect("a mission");
            let record = bounds.of(&scenario.digest()).expect("a bound");
            assert_eq!(record.mission, scenario.name);
        }
    }
}
