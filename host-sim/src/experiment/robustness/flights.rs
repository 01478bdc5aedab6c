//! The flights of an experiment: missions that are planned once, flown in every world.

use std::path::Path;

use planning::planner::{self, HostPlanner};
use rayon::prelude::*;
use scenario::{Events, Scenario};

use super::{
    error_kind::ErrorKind,
    row::{Extent, Group, Pilot},
};
use crate::{
    experiment::ideal_flight::{self, IdealFlightSettings},
    policy::{HostPolicy, PolicyChoice},
};

/// A mission with the plan from before take-off, which is the same in every world.
#[derive(Debug)]
pub(super) struct PlannedMission {
    pub(super) scenario: Scenario,
    planner: HostPlanner,
}

impl PlannedMission {
    fn new(scenario: Scenario) -> Result<Self, String> {
        let planner = planner::new_planner(&scenario.mission);
        let mut planner = planner.map_err(|error| format!("{}: {error}", scenario.name))?;
        planner::finish(&mut planner, |_| {});
        Ok(Self { scenario, planner })
    }

    /// Returns a policy with its name. The planner has its plan already.
    pub(super) fn policy(&self, choice: &PolicyChoice) -> Result<(HostPolicy, String), String> {
        if *choice == PolicyChoice::Plan {
            let planner = Box::new(self.planner.clone());
            return Ok((HostPolicy::Plan(planner), choice.to_string()));
        }
        HostPolicy::load(choice, &self.scenario)
    }
}

/// One flight.
#[derive(Clone, Copy, Debug)]
struct Job<'a> {
    mission: &'a PlannedMission,
    kind: ErrorKind,
    level: f64,
    pilot: Pilot,
    robust: bool,
    seed: u64,
}

/// The result of one flight.
#[derive(Clone, Copy, Debug)]
pub(super) struct Flown {
    pub(super) sum_rate: f64,
    pub(super) lost: f64,
    pub(super) outage: f64,
    pub(super) excess: f64,
    pub(super) broken: usize,
}

impl Job<'_> {
    fn fly(&self) -> Result<Flown, String> {
        let world = self.kind.world(self.level, self.seed);
        let scenario = self.mission.scenario.clone().with_uncertainty(world)?;
        let settings = IdealFlightSettings {
            ignores_errors: !self.robust,
            seed: self.seed,
            ..IdealFlightSettings::default()
        };
        let policy = self.mission.policy(&self.pilot.policy())?;
        let record = ideal_flight::fly_loaded(&scenario, &Events::default(), policy, &settings);
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
    pub(super) groups: [(Group, Vec<PlannedMission>); 3],
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
        let planned = |scenarios: Vec<Scenario>| -> Result<Vec<PlannedMission>, String> {
            let planned = scenarios.into_par_iter().map(PlannedMission::new);
            planned.collect()
        };
        Ok(Self {
            groups: [
                (Group::Separated, planned(shipped("separated"))?),
                (Group::Mixed, planned(shipped("mixed"))?),
                (Group::Benchmark, planned(missions)?),
            ],
        })
    }

    /// Returns whether a group has this number of missions.
    pub(super) fn has(&self, group: Group, missions: usize) -> bool {
        (self.groups.iter()).any(|(of, planned)| *of == group && planned.len() == missions)
    }
}

/// Returns the planner's total of every mission in the known world.
pub(super) fn known_totals(missions: &[PlannedMission]) -> Result<Vec<f64>, String> {
    let totals = missions.par_iter().map(|mission| {
        let job = Job {
            mission,
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

/// Returns the number of seeds that are flown: one where no seed matters.
pub(super) fn seeds_of(kind: ErrorKind, level: f64, extent: Extent) -> u64 {
    if level > 0.0 && kind.is_random() {
        extent.seeds
    } else {
        1
    }
}

/// Returns the flights of every mission, seed by seed.
pub(super) fn fly_all(
    missions: &[PlannedMission],
    (kind, level): (ErrorKind, f64),
    (pilot, robust): (Pilot, bool),
    extent: Extent,
) -> Result<Vec<Vec<Flown>>, String> {
    let seeds = seeds_of(kind, level, extent);
    let flights = missions.par_iter().map(|mission| {
        let of_seed = (1..=seeds).into_par_iter().map(|seed| {
            let job = Job {
                mission,
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
