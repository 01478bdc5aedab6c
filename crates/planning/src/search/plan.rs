//! A whole mission that is decided in advance, and the policy that flies it.

use firmware_core::{
    Mission, Position,
    policy::{Action, Observation, Policy},
};
use serde::{Deserialize, Serialize};

use scenario::{ABSENT_RATE, PlaceRates};

use super::assign;

/// The waypoint and the served user of every slot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The waypoints `q_1` to `q_N`, metres.
    pub waypoints: Vec<Position<f64>>,
    /// The index of the served user in each slot.
    pub users: Vec<usize>,
    /// The sum of the rates, bit/s/Hz.
    pub sum_rate: f64,
}

impl Plan {
    /// Returns the plan of a path with the best fair assignment of users to its slots.
    pub fn assigned<const M: usize, const J: usize>(
        mission: &Mission<f64, M, J>,
        waypoints: Vec<Position<f64>>,
    ) -> Self {
        Self::assigned_in(|_| mission, mission, waypoints)
    }

    /// As [`assigned`](Self::assigned) for a mission that changes: `mission_in` returns it as it is
    /// in the slot of a waypoint, `at_end` has its users and quotas at the end.
    pub(crate) fn assigned_in<'m, const M: usize, const J: usize>(
        mission_in: impl Fn(usize) -> &'m Mission<f64, M, J>,
        at_end: &'m Mission<f64, M, J>,
        waypoints: Vec<Position<f64>>,
    ) -> Self {
        let users = at_end.user_count();
        let mut rates = vec![ABSENT_RATE; waypoints.len() * users];
        for (index, place) in waypoints.iter().enumerate() {
            let row = &mut rates[index * users..][..users];
            PlaceRates::new(mission_in(index)).write(place, row);
        }
        let quotas = (0..users).map(|user| at_end.quota_of(user) as usize);
        let quotas: Vec<usize> = quotas.collect();
        let served = assign(&rates, &quotas);
        let slot_rates = served.iter().zip(rates.chunks(users));
        let sum_rate = slot_rates.map(|(&user, row)| row[user]).sum();
        Self {
            waypoints,
            users: served,
            sum_rate,
        }
    }
}

/// Flies a [`Plan`]: in each slot, the action is the displacement from the vehicle's position to
/// the plan's waypoint, and the plan's user.
#[derive(Clone, Debug)]
pub struct SearchPolicy {
    plan: Plan,
}

impl SearchPolicy {
    /// Creates a policy that flies this plan.
    pub fn new(plan: Plan) -> Self {
        Self { plan }
    }

    /// Returns the plan that is flown.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }
}

impl<const M: usize> Policy<f64, M> for SearchPolicy {
    /// After the end of the plan, the vehicle stays where it is and every user has the same score.
    fn decide(&mut self, observation: &Observation<'_, f64>) -> Action<f64, M> {
        let index = (observation.slot as usize).saturating_sub(1);
        let here = observation.position;
        let target = self.plan.waypoints.get(index).unwrap_or(&here);
        let served = self.plan.users.get(index).copied();
        let scores = (0..observation.counts.len()).map(|user| f64::from(served == Some(user)));
        Action {
            displacement: target - here,
            user_scores: scores.collect(),
        }
    }

    /// The plan is kept; the shield sees to what a change demands.
    fn revise(&mut self, _: &firmware_core::mission::MissionChange<f64>, _: u32) {}

    fn note_gains(&mut self, _: &firmware_core::policy::MeasuredGains<'_, f64>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<firmware_core::policy::PlanQuality> {
        None
    }
}
