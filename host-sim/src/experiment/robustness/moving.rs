//! Moving users and silent sensors: what replanning keeps of a planner that knows the future.

use firmware_core::inner::Method;
use planning::hindsight::hindsight;
use rayon::prelude::*;
use scenario::{Events, PerNode, Uncertainty};
use serde::{Deserialize, Serialize};

use super::{
    error_kind::walking,
    flights::{Missions, PlannedMission},
    row::{Extent, Group},
};
use crate::{
    experiment::{
        Watcher,
        ideal_flight::{self, IdealFlightSettings},
        rounded, statistics,
    },
    policy::PolicyChoice,
    world::World,
};

/// The users' largest speed, m/s.
const SPEED_MPS: f64 = 5.0;
/// The probability that a sensor is silent in a slot.
const SILENCE: f64 = 0.1;

/// A row of `moving.csv`: the mean over missions and seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MovingRow {
    /// The missions.
    pub group: Group,
    /// The policy's name on the command line.
    pub policy: String,
    /// The number of missions.
    pub missions: usize,
    /// The number of seeds of the world, from 1.
    pub seeds: usize,
    /// The total rate over that of the plan that knew all motion from the start.
    pub share: f64,
    /// Half the width of its 95 % confidence interval, over all flights.
    pub share_interval_95: Option<f64>,
    /// The smallest share.
    pub worst: f64,
    /// The fraction of slots above the threshold.
    pub outage: f64,
    /// The number of violated constraints of all flights, arrival and fairness included.
    pub broken: usize,
}

/// The policies, the planner first: the planner that replans, its plan from before take-off, and the
/// straight line.
fn policies() -> [PolicyChoice; 3] {
    [
        PolicyChoice::Plan,
        PolicyChoice::PlanOnce(None),
        PolicyChoice::StraightLine,
    ]
}

/// The flights of one mission in one world: per policy share, outage and violations.
type Shares = [(f64, f64, usize); 3];

/// Flies the missions of groups that a table of earlier measurements lacks with users that walk and
/// sensors that are silent, and hands each longer table to `save`.
///
/// # Errors
/// Returns a message of one line if a mission cannot be flown, or the error of `save`.
pub(super) fn measure(
    missions: &Missions,
    extent: Extent,
    mut rows: Vec<MovingRow>,
    watcher: &dyn Watcher,
    save: &dyn Fn(&[MovingRow]) -> Result<(), String>,
) -> Result<(), String> {
    for (group, planned) in &missions.groups {
        if rows.iter().any(|row| row.group == *group) {
            continue;
        }
        watcher.busy(&format!(
            "{}: walking users and silent sensors",
            group.title()
        ));
        let jobs: Vec<(&PlannedMission, u64)> = (planned.iter())
            .flat_map(|mission| (1..=extent.seeds).map(move |seed| (mission, seed)))
            .collect();
        let flown: Result<Vec<Shares>, String> = jobs
            .par_iter()
            .map(|&(mission, seed)| shares(mission, seed))
            .collect();
        let flown = flown?;
        for (index, policy) in policies().iter().enumerate() {
            let of_policy = || flown.iter().map(move |flights| flights[index]);
            let values: Vec<f64> = of_policy().map(|(share, ..)| share).collect();
            let outages: Vec<f64> = of_policy().map(|(_, outage, _)| outage).collect();
            rows.push(MovingRow {
                group: *group,
                policy: policy.to_string(),
                missions: planned.len(),
                seeds: extent.seeds as usize,
                share: rounded(statistics::mean(&values)),
                share_interval_95: statistics::half_width_95(&values).map(rounded),
                worst: rounded(values.iter().copied().fold(f64::INFINITY, f64::min)),
                outage: rounded(statistics::mean(&outages)),
                broken: of_policy().map(|(.., broken)| broken).sum(),
            });
        }
        save(&rows)?;
    }
    Ok(())
}

/// Flies one mission in one world under every policy, and plans it with hindsight.
fn shares(mission: &PlannedMission, seed: u64) -> Result<Shares, String> {
    let scenario = mission.scenario.clone().with_uncertainty(Uncertainty {
        seed,
        motion: Some(walking(SPEED_MPS)),
        silence_probability: PerNode::All(SILENCE),
        ..Uncertainty::default()
    })?;
    let events = scenario.with_motion(&Events::default())?;
    let settings = IdealFlightSettings::default();
    let mut flown = Vec::new();
    let mut path = Vec::new();
    for policy in policies() {
        let loaded = mission.policy(&policy)?;
        let record = ideal_flight::fly_loaded(&scenario, &events, loaded, &settings)
            .map_err(|problem| format!("{} under {policy}: {problem}", scenario.name))?;
        if path.is_empty() {
            path = record.slots.iter().map(|slot| slot.flown).collect();
        }
        flown.push(record.summary());
    }
    let best = hindsight(&scenario.mission, &events, &path);
    // The plan knows where everybody will be; who will be silent is not in it, but in its rates.
    let world = World::new(&scenario, &events, seed, 1);
    let known = best.map_or(0.0, |plan| {
        let slots = (1..).zip(plan.waypoints.iter().zip(&plan.users));
        let rates = slots.map(|(slot, (waypoint, &user))| {
            world.rate_at(&Method::Exact, slot, Some(user), waypoint)
        });
        rates.sum()
    });
    // Hindsight is a search: what was flown may be better.
    let known = flown
        .iter()
        .map(|summary| summary.sum_rate)
        .fold(known, f64::max);
    let result: Vec<_> = flown
        .iter()
        .map(|summary| {
            (
                summary.sum_rate / known,
                summary.mse_violations as f64 / summary.slots.max(1) as f64,
                summary.constraint_violations
                    + usize::from(!summary.arrived)
                    + usize::from(!summary.fair),
            )
        })
        .collect();
    Ok([result[0], result[1], result[2]])
}
