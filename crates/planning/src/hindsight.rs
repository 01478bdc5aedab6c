//! What a planner would reach that knew from the start how a mission changes in flight: the
//! standard for replanning.
//!
//! The events of a mission are known, so path and assignment can be optimised together over all
//! slots, each with the mission as it is then. The result is the best of local searches from several
//! paths; it is not certified, and there may be better ones.

use firmware_core::Position;
use scenario::{Events, HostMission, Timeline};

use crate::{
    planner,
    search::{PathRules, Plan, made_admissible, rearrange, refine},
};

/// The spacings down to which all paths, and the best of them, are improved, metres.
const COARSEST_M: f64 = 3.0;
const FINEST_M: f64 = 0.5;
/// The number of versions of the mission for which paths are planned, at most: users that walk make
/// a new version in nearly every slot.
const VERSIONS_MAX: usize = 6;
/// The number of paths that are improved to the end.
const FINALISTS: usize = 2;

/// Returns the best plan that was found for a mission with these events, or `None` if no path is
/// admissible. `flown` is a path that was flown without knowing the events beforehand: the plan is
/// at least as good.
pub fn hindsight(mission: &HostMission, events: &Events, flown: &[Position<f64>]) -> Option<Plan> {
    let timeline = events.timeline(mission);
    let later = &timeline.versions()[1..];
    let rules = PathRules::changing(mission, later);
    let admissible = first_paths(&timeline, flown)
        .into_iter()
        .filter_map(|path| made_admissible(&rules, &path));
    let mut plans: Vec<Plan> = admissible
        .map(|path| refine(&rules, rules.assigned(path), COARSEST_M))
        .collect();
    plans.sort_by(|a, b| b.sum_rate.total_cmp(&a.sum_rate));
    plans.truncate(FINALISTS);
    let improved = plans.into_iter().map(|plan| {
        let plan = rearrange(&rules, refine(&rules, plan, FINEST_M));
        refine(&rules, plan, FINEST_M)
    });
    improved.max_by(|a, b| a.sum_rate.total_cmp(&b.sum_rate))
}

/// Returns the paths from which the search starts: the one that was flown, those that are planned
/// for each version of the mission as if it held from the start, and those that lead from the first
/// to the last of these within a few slots around each event.
fn first_paths(timeline: &Timeline, flown: &[Position<f64>]) -> Vec<Vec<Position<f64>>> {
    let slots = timeline.at_end().slots() as usize;
    let mut paths = vec![flown.to_vec()];
    let mut planned = Vec::new();
    let versions = timeline.versions();
    let last = versions.len() - 1;
    let chosen = last.min(VERSIONS_MAX - 1);
    let versions: Vec<_> = (0..=chosen)
        .map(|index| &versions[index * last / chosen.max(1)])
        .collect();
    for (_, version) in &versions {
        if let Ok(plan) = planner::plan(version, |_| {}) {
            planned.push(plan.waypoints);
        }
    }
    if let [first, .., last] = planned.as_slice() {
        for (from_slot, _) in &versions[1..] {
            for spread in [1.0, 5.0, 10.0] {
                let blend = (0..slots).map(|index| {
                    let after = (index as f64 + 1.0 - f64::from(*from_slot)) / spread;
                    let weight = (0.5 + 0.5 * after).clamp(0.0, 1.0);
                    let place = |path: &[Position<f64>]| path[index.min(path.len() - 1)];
                    let (a, b) = (place(first), place(last));
                    a + (b - a) * weight
                });
                paths.push(blend.collect());
            }
        }
    }
    paths.extend(planned);
    for path in &mut paths {
        let end = path.last().copied().unwrap_or_else(Position::origin);
        path.resize(slots, end);
    }
    paths
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::Scenario;

    /// With hindsight a mission carries at least what was flown; without events it carries what a
    /// plan does.
    #[test]
    fn hindsight_is_no_worse_than_foresight() {
        let mission = &Scenario::shipped("mixed").expect("shipped").mission;
        let plan = planner::plan(mission, |_| {}).expect("within capacity");
        let events = Events::parse(
            "[[event]]\nslot = 31\nuser = 2\nposition_m = [100.0, 900.0]\n\
             [[event]]\nslot = 31\nsensor = 4\nleaves = true\n\
             [[event]]\nslot = 40\nmse_threshold = 0.012\n",
            mission,
        )
        .expect("valid events");
        for (events, least) in [(Events::default(), plan.sum_rate), (events, 0.0)] {
            let found = hindsight(mission, &events, &plan.waypoints).expect("admissible");
            let timeline = events.timeline(mission);
            let rules = PathRules::changing(mission, &timeline.versions()[1..]);
            assert!(rules.admits(&found.waypoints));
            let as_flown = made_admissible(&rules, &plan.waypoints).expect("admissible");
            assert!(found.sum_rate >= rules.assigned(as_flown).sum_rate);
            assert!(
                found.sum_rate >= least * 0.999,
                "{} {least}",
                found.sum_rate
            );
        }
    }
}
