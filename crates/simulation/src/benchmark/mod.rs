//! Compares policies over a set of missions, as fractions of certified upper bounds.
//!
//! A set is a directory with scenario files and `bounds.csv`, the certified bounds of their
//! missions. A bound belongs to a mission's digest, so a file that was changed afterwards has no
//! bound.

mod bounds;
mod changes;
mod groups;
mod statistics;

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::Instant,
};

use serde::{Deserialize, Serialize};

use crate::{
    flight::{self, ClientSettings, FlightSettings, Peer, RealTimeFactor, computer::InProcess},
    policy::{HostPolicy, OnnxConverter, PolicyChoice},
};
use environment::Allocation;
use firmware_core::Position;
use scenario::{Events, Scenario};
use vehicle::{Profile, Vehicle};

pub use bounds::{BoundRecord, Bounds, FILE_NAME as BOUNDS_FILE};
pub use changes::{ChangeFlight, ChangeMission, ChangeStatistics, change_missions};
pub use groups::{GroupStatistics, group_statistics};
pub use statistics::{PolicyStatistics, shares, statistics};

/// The largest certified gap at which a mission counts in the statistics of the fractions.
pub const COUNTED_GAP: f64 = 0.02;

/// Returns the scenarios of a directory, sorted by name.
///
/// # Errors
/// Returns a message of one line if the directory cannot be read or has no scenario, or if a
/// scenario is not valid.
pub fn missions(folder: &Path) -> Result<Vec<Scenario>, String> {
    let unreadable = |error: io::Error| format!("{}: {error}", folder.display());
    let entries = fs::read_dir(folder).map_err(unreadable)?;
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in entries {
        let path = entry.map_err(unreadable)?.path();
        if path.extension().is_some_and(|kind| kind == "toml") {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(format!(
            "{}: the directory contains no scenario (.toml file)",
            folder.display()
        ));
    }
    files.sort();
    files
        .iter()
        .map(|file| Scenario::load(file).map_err(|error| error.to_string()))
        .collect()
}

/// The result of one policy on one mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flown {
    /// The scenario's name.
    pub mission: String,
    /// The mission's digest.
    pub digest: String,
    /// The policy as it was requested.
    pub policy: String,
    /// The vehicle's profile.
    pub profile: String,
    /// The sum of the rates, bit/s/Hz; NaN if the policy does not fit the mission.
    pub sum_rate: f64,
    /// The number of violated constraints: speed, area, arrival and fairness; a flight that did not
    /// end as planned counts as one more.
    pub violations: usize,
    /// The number of slots whose average was less accurate than `Gamma`: at these positions no
    /// choice of powers meets it, and the users do not transmit.
    pub inaccurate_slots: usize,
    /// The wall-clock time to prepare the policy (a plan, a search), seconds.
    pub preparation_s: f64,
    /// The median time of a decision, microseconds.
    pub decision_us: f64,
}

/// Flies one mission with one policy and the built-in vehicle.
pub fn fly(scenario: &Scenario, choice: &PolicyChoice, profile: Profile) -> Flown {
    fly_through(
        scenario,
        &Events::default(),
        choice,
        profile,
        HostPolicy::load,
    )
    .0
}

/// Like [`fly`], but `.onnx` files are converted to `.policy` files and evaluated as these are.
pub fn fly_converted(
    scenario: &Scenario,
    choice: &PolicyChoice,
    profile: Profile,
    converter: OnnxConverter,
) -> Flown {
    let load = |choice: &PolicyChoice, scenario: &Scenario| {
        HostPolicy::load_converted(choice, scenario, converter)
    };
    fly_through(scenario, &Events::default(), choice, profile, load).0
}

/// Flies one mission in which these events happen, with the policy that `load` returns. Returns the
/// waypoints that were reached, too.
fn fly_through(
    scenario: &Scenario,
    events: &Events,
    choice: &PolicyChoice,
    profile: Profile,
    load: impl FnOnce(&PolicyChoice, &Scenario) -> Result<(HostPolicy, String), String>,
) -> (Flown, Vec<Position<f64>>) {
    let started = Instant::now();
    let loaded = load(choice, scenario);
    let mut flown = Flown {
        mission: scenario.name.clone(),
        digest: scenario.digest(),
        policy: choice.to_string(),
        profile: profile.to_string(),
        sum_rate: f64::NAN,
        violations: 0,
        inaccurate_slots: 0,
        preparation_s: started.elapsed().as_secs_f64(),
        decision_us: f64::NAN,
    };
    let Ok((policy, name)) = loaded else {
        return (flown, Vec::new());
    };
    let settings = FlightSettings {
        ground_link: None,
        policy: name,
        inner: Allocation::Exact,
        profile,
        real_time_factor: RealTimeFactor::Max,
        seed: 1,
        symbols_per_slot: 1,
        ignores_errors: false,
        events: events.clone(),
    };
    let vehicle = Vehicle::new(flight::vehicle_settings(scenario, profile));
    // The profiles' default parameters would clip the speed of most missions.
    let client = match profile {
        Profile::Ideal => ClientSettings::default(),
        _ => ClientSettings::default().with_parameters_set(),
    };
    let peer = Peer::built_in(vehicle);
    let record = match InProcess::new(scenario, policy, &settings, client, &peer) {
        Ok(mut computer) => flight::fly_with(scenario, &mut computer, &settings, peer, &mut ()),
        Err(error) => Err(error.into()),
    };
    let record = match record {
        Ok(record) => Some(Box::new(record)),
        Err(failed) => {
            flown.violations += 1;
            failed.record
        }
    };
    let mut path = Vec::new();
    if let Some(record) = record {
        path = record.slots.iter().map(|slot| slot.flown).collect();
        let summary = record.summary();
        flown.sum_rate = summary.sum_rate;
        flown.violations += summary.constraint_violations
            + usize::from(!summary.arrived)
            + usize::from(!summary.fair);
        flown.inaccurate_slots = summary.mse_violations;
        flown.decision_us = summary.plan_us.median;
    }
    (flown, path)
}
