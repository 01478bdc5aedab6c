//! A mission to be flown: the planner's prices, and the value function of the relaxed mission.
//!
//! The prices are those of the onboard planner, which has planned the mission anyway, and not the
//! certified ones of `docs/bound.md`, which take seconds. Any prices give a valid shaping.

use std::sync::Arc;

use environment::{Environment, EnvironmentSettings, ValueToGo};
use firmware_core::USERS_MAX;
use scenario::{HostMission, PlaceRates};

use crate::{
    imitation::{
        demonstration::{Demonstration, PlanSummary, SavedDemonstration},
        settings::ImitationSettings,
    },
    nn::sets::SetNetwork,
};

/// Rewards of missions with a smaller total, bit/s/Hz, are in units of this total.
const TOTAL_MIN: f64 = 0.5;

/// A mission to be flown.
#[derive(Clone, Debug)]
pub struct Task {
    /// The planned mission, with the examples of its plan and of a flight.
    pub demonstration: Demonstration,
    /// What the planner knew.
    pub summary: PlanSummary,
    values: Arc<ValueToGo>,
}

/// What a checkpoint has of a task.
pub type SavedTask = (SavedDemonstration, PlanSummary);

/// Returns the environment of a mission with prices, without value shaping.
fn priced(mission: &HostMission, summary: &PlanSummary) -> Environment<f64> {
    let settings = EnvironmentSettings {
        // Arrival is certain under the shield.
        trajectory_weight: 0.0,
        ..EnvironmentSettings::default()
    };
    Environment::new(mission.clone(), &settings).with_prices(&summary.prices)
}

/// Solves the relaxed mission.
fn value_to_go(mission: &HostMission, environment: &Environment<f64>) -> ValueToGo {
    let mut rates = PlaceRates::new(mission);
    let mut row = [0.0; USERS_MAX];
    ValueToGo::new(mission, |place| {
        let row = &mut row[..mission.user_count()];
        rates.write(&place, row);
        let worth = row.iter().zip(environment.prices());
        worth
            .map(|(rate, price)| rate + price)
            .fold(f64::NEG_INFINITY, f64::max)
    })
}

impl Task {
    fn new(demonstration: Demonstration, summary: PlanSummary) -> Self {
        let environment = priced(&demonstration.mission, &summary);
        let values = value_to_go(&demonstration.mission, &environment);
        Self {
            demonstration,
            summary,
            values: Arc::new(values),
        }
    }

    /// Returns a function that prepares tasks by index.
    pub fn preparation(
        settings: &ImitationSettings,
    ) -> impl FnMut(u64, Option<&SetNetwork>) -> anyhow::Result<Self> + Send + use<> {
        let mut prepare = Demonstration::preparation(settings);
        move |index, network| {
            let (demonstration, summary) = prepare(index, network)?;
            Ok(Self::new(demonstration, summary))
        }
    }

    /// Returns what a checkpoint needs to restore the task.
    pub fn saved(&self) -> SavedTask {
        (self.demonstration.saved(), self.summary.clone())
    }

    /// Restores a task.
    ///
    /// # Errors
    /// Fails if the seed gives no mission.
    pub fn restored(
        settings: &ImitationSettings,
        (demonstration, summary): SavedTask,
    ) -> anyhow::Result<Self> {
        let demonstration = Demonstration::restored(settings, demonstration)?;
        Ok(Self::new(demonstration, summary))
    }

    /// Returns the environment, with prices and value shaping.
    pub fn environment(&self) -> Environment<f64> {
        let environment = priced(&self.demonstration.mission, &self.summary);
        environment.with_values(self.values.clone())
    }

    /// Returns the mean rate of a slot of the plan, the unit of rewards, bit/s/Hz.
    pub fn mean_rate(&self) -> f64 {
        let slots = f64::from(self.demonstration.mission.slots());
        self.summary.total.max(TOTAL_MIN) / slots
    }
}
