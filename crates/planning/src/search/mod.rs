//! A feasible mission close to the best one: the primal side of the certified bound.
//!
//! A path is priced with the multipliers of [`crate::bound`], its slots are assigned to users by an
//! optimal [assignment](assign), and path and assignment improve each other in turn down to
//! millimetres. The result is a [`Plan`], which satisfies every constraint with a margin.
//! [`SearchPolicy`] flies it.

mod assignment;
mod plan;
mod polish;
mod rearrange;

pub use assignment::assign;
pub use plan::{Plan, SearchPolicy};

pub(crate) use polish::PathRules;

use firmware_core::Position;

/// The spacing of the first stencils, as a fraction of `V_max delta`.
const FIRST_SPACING: f64 = 0.25;
/// The largest number of rounds at one spacing. A round that gains less than [`WORTHWHILE`] is the
/// last one.
const ROUNDS_PER_SPACING: usize = 12;
/// The relative gain below which a spacing is exhausted.
const WORTHWHILE: f64 = 1e-4;
/// The spacings of the stencils in which the order of service is changed, as fractions of
/// `V_max delta`.
const REARRANGE_SPACINGS: [f64; 2] = [0.25, 0.125];
/// The largest number of changes at one spacing.
const CHANGES_PER_SPACING: usize = 40;
/// The largest number of slots that a change of the order may span.
const CHANGE_SPAN: usize = 20;

/// Improves path and assignment in turn until neither gains at the finest spacing.
pub(crate) fn refine<const M: usize, const J: usize>(
    rules: &PathRules<'_, M, J>,
    mut plan: Plan,
    finest_m: f64,
) -> Plan {
    let mut spacing_m = FIRST_SPACING * rules.reach_m;
    while spacing_m >= finest_m {
        for _ in 0..ROUNDS_PER_SPACING {
            let candidates = rules.candidates(&plan.waypoints, spacing_m);
            let (_, path) = candidates.best_chain(&plan.users);
            let better = rules.assigned(path);
            let gain = better.sum_rate - plan.sum_rate;
            if gain > 0.0 {
                plan = better;
            }
            if gain <= WORTHWHILE * plan.sum_rate {
                break;
            }
        }
        spacing_m *= 0.5;
    }
    plan
}

/// Improves a plan by changing the order of service until no change is worthwhile.
pub(crate) fn rearrange<const M: usize, const J: usize>(
    rules: &PathRules<'_, M, J>,
    mut plan: Plan,
) -> Plan {
    for spacing in REARRANGE_SPACINGS {
        for _ in 0..CHANGES_PER_SPACING {
            let candidates = rules.candidates(&plan.waypoints, spacing * rules.reach_m);
            let least = plan.sum_rate * (1.0 + WORTHWHILE);
            let Some(users) = candidates.best_change(&plan.users, CHANGE_SPAN, least) else {
                break;
            };
            let (_, path) = candidates.best_chain(&users);
            let better = rules.assigned(path);
            if better.sum_rate <= least {
                break;
            }
            plan = better;
        }
    }
    plan
}

/// Turns any path into one that `rules` admits, changing it as little as one forward pass can: each
/// waypoint is projected to the nearest position that can be reached and from which the destination
/// can be reached. Returns `None` if the margin makes that impossible.
pub(crate) fn made_admissible<const M: usize, const J: usize>(
    rules: &PathRules<'_, M, J>,
    wished: &[Position<f64>],
) -> Option<Vec<Position<f64>>> {
    use firmware_core::shield::ReachableSet;
    let p = rules.mission.parameters();
    // Rounding to the lattice may move a waypoint out of the disc around the destination by less
    // than a quantum. A step is that much longer than the amount by which the disc shrinks.
    let step_m = |index: usize| rules.reach_in(index) - rules.quantum_m;
    let home_m = |index: usize| step_m(index) - rules.quantum_m;
    let mut from = p.start;
    let mut path = Vec::with_capacity(wished.len());
    for (index, wish) in wished.iter().enumerate() {
        let homeward: Vec<f64> = (index + 1..=wished.len()).map(home_m).collect();
        let runs = homeward.chunk_by(|a, b| a == b);
        let left_m = runs.map(|run| run.len() as f64 * run[0]).sum();
        let set = ReachableSet::new(p.area, from, step_m(index), p.destination, left_m);
        from = rules.on_lattice(set.nearest(wish)?)?;
        path.push(from);
    }
    rules.admits(&path).then_some(path)
}
