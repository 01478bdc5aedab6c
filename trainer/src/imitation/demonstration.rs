//! A planned mission as examples: states, and what the planner would do in them.

use environment::Allocation;
use firmware_core::{
    USERS_MAX,
    mission::MissionChange,
    policy::{Action, MeasuredGains, Observation, PlanQuality, Policy},
};
use planning::planner::{HostPlanner, new_planner};
use pulp::Arch;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::HostMission;
use serde::{Deserialize, Serialize};

use super::{policy::SetPolicy, settings::ImitationSettings};
use crate::{evaluate::fly, learner::fill_normal, nn::sets::SetNetwork};

/// The planner's steps between two looks at whether it has finished.
const OPERATIONS_PER_STEP: u64 = 5_000_000;
/// The largest weight of a demonstration.
pub const WEIGHT_MAX: f64 = 25.0;
/// A fraction of the planner's total that the network loses adds 1 to the weight of a demonstration.
const LOSS_UNIT: f64 = 0.02;
/// Plans with a smaller total, bit/s/Hz, add no weight: fractions of it would mean little.
const TOTAL_MIN: f64 = 0.5;
/// The standard deviation of the disturbance of flights that follow the planner, in units of the
/// way of a slot.
const FLIGHT_DISTURBANCE: f64 = 0.3;

/// A state, and the planner's answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Example {
    /// The coming slot, 1 to `N`.
    pub slot: u32,
    /// The position, metres.
    pub position_m: [f64; 2],
    /// The number of slots that each user was served in.
    pub counts: Vec<u32>,
    /// The planner's waypoint, metres.
    pub waypoint_m: [f64; 2],
    /// The user that it serves.
    pub user: u8,
}

/// A planned mission.
#[derive(Clone, Debug)]
pub struct Demonstration {
    /// The seed of `scenario random`.
    pub seed: u64,
    /// The mission.
    pub mission: HostMission,
    /// How often its examples are drawn, compared with those of a mission that the network flies as
    /// well as the planner: 1 to [`WEIGHT_MAX`].
    pub weight: f64,
    /// The examples.
    pub examples: Vec<Example>,
}

/// What a checkpoint has of a demonstration: seed, weight and examples.
pub type SavedDemonstration = (u64, f64, Vec<Example>);

/// What the planner knows about a whole mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanSummary {
    /// The prices of fairness, one per user, bit/s/Hz.
    pub prices: Vec<f64>,
    /// The sum of the rates of the plan, bit/s/Hz.
    pub total: f64,
}

/// Returns the seed of a run's mission, for run seeds below 2^32 - 1 ([`ImitationSettings::check`])
/// and fewer than 2^32 missions. The benchmark's and the held-out missions have seeds below 2^32.
pub fn mission_seed(run_seed: u64, index: u64) -> u64 {
    (run_seed.wrapping_add(1) << 32).wrapping_add(index)
}

/// Plans a mission with about `operations` operations and returns the planner.
///
/// # Errors
/// Fails if the mission does not fit into a planner; those of `scenario random` do.
pub fn planned(mission: &HostMission, operations: u64) -> anyhow::Result<HostPlanner> {
    let mut planner = new_planner(mission)?.with_operations_per_slot(0);
    let mut spent = 0;
    while spent < operations {
        let progress = planner.advance(OPERATIONS_PER_STEP);
        spent += progress.operations;
        if progress.finished {
            break;
        }
    }
    Ok(planner)
}

impl Demonstration {
    /// Plans mission `index` of a run. The examples are the states of the plan, and those of a
    /// flight by `network`, or, without one, of a disturbed flight by the planner. `plan` is the plan
    /// of the run's only mission, if it has been made already.
    ///
    /// # Errors
    /// Fails if the seed gives no mission.
    pub fn new(
        settings: &ImitationSettings,
        index: u64,
        network: Option<&SetNetwork>,
        plan: Option<&HostPlanner>,
    ) -> anyhow::Result<Self> {
        Self::with_summary(settings, index, network, plan).map(|(demonstration, _)| demonstration)
    }

    /// Like [`Demonstration::new`], and returns what the planner knew before the flight.
    ///
    /// # Errors
    /// Fails if the seed gives no mission.
    pub fn with_summary(
        settings: &ImitationSettings,
        index: u64,
        network: Option<&SetNetwork>,
        plan: Option<&HostPlanner>,
    ) -> anyhow::Result<(Self, PlanSummary)> {
        let seed = mission_seed(settings.seed, index);
        let mission = settings.mission(seed)?;
        let mut planner = match plan {
            Some(plan) => plan.clone(),
            None => planned(&mission, settings.planning_operations)?,
        };
        let summary = PlanSummary {
            prices: planner.prices().to_vec(),
            total: planner.value(),
        };
        let mut examples = plan_examples(&mission, &mut planner);
        planner = planner.with_operations_per_slot(settings.correction_operations);
        let mut flight = Flight {
            planner,
            pilot: network.map(|network| SetPolicy::new(network, mission.clone(), Arch::new())),
            rng: Pcg64Mcg::seed_from_u64(seed),
            reach_m: mission.reach_m(),
            examples: Vec::new(),
        };
        let flown = fly(&mission, &mut flight, Allocation::default())?;
        examples.append(&mut flight.examples);
        let weight = match network {
            Some(_) if summary.total > TOTAL_MIN => weight(1.0 - flown.sum_rate / summary.total),
            _ => 1.0,
        };
        let demonstration = Self {
            seed,
            mission,
            weight,
            examples,
        };
        Ok((demonstration, summary))
    }

    /// Returns a function that prepares demonstrations by index. It plans the mission of a run that
    /// has only one before the first.
    pub fn preparation(
        settings: &ImitationSettings,
    ) -> impl FnMut(u64, Option<&SetNetwork>) -> anyhow::Result<(Self, PlanSummary)> + Send + use<>
    {
        let settings = settings.clone();
        let mut only_plan = None;
        move |index, network| {
            if settings.scenario.is_some() && only_plan.is_none() {
                let mission = settings.mission(0)?;
                only_plan = Some(planned(&mission, settings.planning_operations)?);
            }
            Self::with_summary(&settings, index, network, only_plan.as_ref())
        }
    }

    /// Returns what a checkpoint needs to restore the demonstration.
    pub fn saved(&self) -> SavedDemonstration {
        (self.seed, self.weight, self.examples.clone())
    }

    /// Restores a demonstration of a run from its seed, weight and examples.
    ///
    /// # Errors
    /// Fails if the seed gives no mission.
    pub fn restored(
        settings: &ImitationSettings,
        (seed, weight, examples): SavedDemonstration,
    ) -> anyhow::Result<Self> {
        Ok(Self {
            seed,
            mission: settings.mission(seed)?,
            weight,
            examples,
        })
    }
}

/// Returns the weight of a mission of which the network lost a fraction.
fn weight(lost: f64) -> f64 {
    (1.0 + lost / LOSS_UNIT).clamp(1.0, WEIGHT_MAX)
}

/// Returns the states along a plan.
fn plan_examples(mission: &HostMission, planner: &mut HostPlanner) -> Vec<Example> {
    let mut examples = Vec::new();
    let mut position = mission.parameters().start;
    let mut counts = vec![0; mission.user_count()];
    for slot in 1..=mission.slots() {
        let (Some(waypoint), Some(user)) = (planner.waypoint(slot), planner.served_user(slot))
        else {
            break;
        };
        examples.push(Example {
            slot,
            position_m: [position.x, position.y],
            counts: counts.clone(),
            waypoint_m: [waypoint.x, waypoint.y],
            user: user as u8,
        });
        counts[user] += 1;
        position = waypoint;
    }
    examples
}

/// A policy that records the planner's answers, and flies the pilot's or the planner's disturbed.
struct Flight<'a> {
    planner: HostPlanner,
    pilot: Option<SetPolicy<'a>>,
    rng: Pcg64Mcg,
    reach_m: f64,
    examples: Vec<Example>,
}

impl Policy<f64, USERS_MAX> for Flight<'_> {
    fn decide(&mut self, observation: &Observation<'_, f64>) -> Action<f64, USERS_MAX> {
        let mut action = self.planner.decide(observation);
        let here = observation.position;
        let waypoint = here + action.displacement;
        let user = action.user_scores.iter().position(|&score| score > 0.0);
        if let Some(user) = user {
            self.examples.push(Example {
                slot: observation.slot,
                position_m: [here.x, here.y],
                counts: observation.counts.to_vec(),
                waypoint_m: [waypoint.x, waypoint.y],
                user: user as u8,
            });
        }
        if let Some(pilot) = &mut self.pilot {
            return pilot.decide(observation);
        }
        let mut offset = [0.0_f32; 2];
        fill_normal(&mut self.rng, &mut offset);
        if self.rng.random_bool(0.5) {
            let scale = FLIGHT_DISTURBANCE * self.reach_m;
            action.displacement.x += f64::from(offset[0]) * scale;
            action.displacement.y += f64::from(offset[1]) * scale;
        }
        action
    }

    fn revise(&mut self, _: &MissionChange<f64>, _: u32) {}

    fn note_gains(&mut self, _: &MeasuredGains<'_, f64>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<PlanQuality> {
        None
    }
}
