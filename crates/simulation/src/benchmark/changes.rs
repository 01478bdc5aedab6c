//! Missions that change in flight: what replanning reaches of what a planner reaches that knew the
//! events from the start.

use planning::{hindsight::hindsight, planner};
use scenario::{EventKind, Events, Scenario};
use serde::Serialize;
use vehicle::Profile;

use super::{Flown, fly_through};
use crate::policy::{HostPolicy, PolicyChoice};

/// A mission and what changes in it.
#[derive(Clone, Debug)]
pub struct ChangeMission {
    /// The mission before the events.
    pub scenario: Scenario,
    /// What kind of change it is.
    pub kind: EventKind,
    /// The events, at mid-mission.
    pub events: Events,
}

/// A flight through a mission that changes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChangeFlight {
    /// What kind of change it is.
    pub kind: EventKind,
    /// The flight.
    #[serde(flatten)]
    pub flown: Flown,
    /// The sum of the rates of a plan that knew the events, bit/s/Hz.
    pub hindsight: f64,
}

/// The flights of one policy through one kind of change.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChangeStatistics {
    /// The kind; `None` for all kinds together.
    pub kind: Option<EventKind>,
    /// The policy.
    pub policy: String,
    /// The number of flights.
    pub flown: usize,
    /// The mean share of hindsight.
    pub mean: f64,
    /// The smallest share.
    pub worst: f64,
    /// The mission with the smallest share.
    pub worst_mission: String,
    /// The mean fraction of the total of the reference policy on the same missions; NaN if it did
    /// not fly them all.
    pub reference_mean: f64,
    /// The smallest of these fractions.
    pub reference_worst: f64,
    /// The number of violated constraints, arrival and fairness included.
    pub violations: usize,
}

/// Returns `count` missions of a set with events, the kinds in turn. A mission is left out if it is
/// too small for its kind, or if its destination would be out of reach from where the plan without
/// events leads by then.
pub fn change_missions(scenarios: &[Scenario], count: usize) -> Vec<ChangeMission> {
    let mut left = scenarios.iter();
    let kinds = EventKind::ALL.into_iter().cycle().take(count);
    let chosen = kinds.map_while(|kind| {
        left.find_map(|scenario| {
            let seed = scenario.mission.slots().into();
            let events = kind.draw(&scenario.mission, seed)?;
            leaves_a_way(scenario, &events).then(|| ChangeMission {
                scenario: scenario.clone(),
                kind,
                events,
            })
        })
    });
    chosen.collect()
}

/// Returns whether the destination stays within reach of the plan without events.
fn leaves_a_way(scenario: &Scenario, events: &Events) -> bool {
    let timeline = events.timeline(&scenario.mission);
    let Ok(plan) = planner::plan(&scenario.mission, |_| {}) else {
        return false;
    };
    timeline.versions()[1..].iter().all(|(from_slot, mission)| {
        let done = from_slot - 1;
        let place = plan.waypoints[done as usize - 1];
        let slots_left = f64::from(mission.slots().saturating_sub(done) + 1);
        // A tenth of a slot to spare, for vehicles that are not exactly where the plan is.
        let reach_m = (slots_left - 0.1) * mission.reach_m();
        (place - mission.parameters().destination).norm() <= reach_m
    })
}

impl ChangeMission {
    /// Flies the mission with one policy, and plans it with hindsight.
    pub fn fly(&self, choice: &PolicyChoice, profile: Profile) -> ChangeFlight {
        let (flown, path) = fly_through(
            &self.scenario,
            &self.events,
            choice,
            profile,
            HostPolicy::load,
        );
        let known = hindsight(&self.scenario.mission, &self.events, &path);
        ChangeFlight {
            kind: self.kind,
            flown,
            hindsight: known.map_or(f64::NAN, |plan| plan.sum_rate),
        }
    }
}

impl ChangeStatistics {
    /// Returns the statistics of `policy` for one kind, or for all of them; `None` without flights.
    /// `reference` is the policy with whose totals its own are compared.
    pub fn of(
        flights: &[ChangeFlight],
        policy: &str,
        reference: &str,
        kind: Option<EventKind>,
    ) -> Option<Self> {
        let own = flights.iter().filter(|flight| {
            flight.flown.policy == policy && kind.is_none_or(|kind| flight.kind == kind)
        });
        let shares = own.clone().map(|flight| {
            let share = flight.flown.sum_rate / flight.hindsight;
            (share, flight.flown.mission.as_str())
        });
        let (worst, worst_mission) = shares.clone().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let count = own.clone().count();
        let of_reference: Vec<f64> = (own.clone())
            .map(|flight| {
                let same = flights.iter().find(|other| {
                    other.flown.policy == reference && other.flown.digest == flight.flown.digest
                });
                same.map_or(f64::NAN, |other| {
                    flight.flown.sum_rate / other.flown.sum_rate
                })
            })
            .collect();
        Some(Self {
            kind,
            policy: policy.into(),
            flown: count,
            mean: shares.map(|(share, _)| share).sum::<f64>() / count as f64,
            worst,
            worst_mission: worst_mission.into(),
            reference_mean: of_reference.iter().sum::<f64>() / count as f64,
            reference_worst: of_reference.into_iter().min_by(f64::total_cmp)?,
            violations: own.map(|flight| flight.flown.violations).sum(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight(policy: &str, mission: usize, sum_rate: f64) -> ChangeFlight {
        ChangeFlight {
            kind: EventKind::ALL[mission % 2],
            flown: Flown {
                mission: format!("m{mission}"),
                digest: format!("d{mission}"),
                policy: policy.into(),
                profile: "ideal".into(),
                sum_rate,
                violations: 0,
                inaccurate_slots: 0,
                preparation_s: 1.0,
                decision_us: 1.0,
            },
            hindsight: 10.0,
        }
    }

    /// A policy is compared with the reference on the missions of the kind, one by one.
    #[test]
    fn totals_are_compared_with_those_of_the_reference() {
        let mut flights = Vec::new();
        for (mission, own, planned) in [(0, 4.0, 8.0), (1, 9.0, 9.0), (2, 9.0, 10.0)] {
            flights.push(flight("any", mission, own));
            flights.push(flight("plan", mission, planned));
        }
        let of = |policy, kind| {
            ChangeStatistics::of(&flights, policy, "plan", kind).expect("statistics")
        };
        let all = of("any", None);
        assert_eq!((all.flown, all.worst), (3, 0.4));
        assert!((all.reference_mean - (0.5 + 1.0 + 0.9) / 3.0).abs() < 1e-12);
        assert_eq!(all.reference_worst, 0.5);
        let first = of("any", Some(EventKind::ALL[0]));
        assert!((first.reference_mean - 0.7).abs() < 1e-12);
        let plan = of("plan", None);
        assert_eq!((plan.reference_mean, plan.reference_worst), (1.0, 1.0));
        // The reference did not fly one of the missions.
        flights.pop();
        let part = ChangeStatistics::of(&flights, "any", "plan", None).expect("statistics");
        assert!(part.reference_mean.is_nan());
    }
}
