//! A feasible mission close to the best: the primal side of the certified bound.
//!
//! A path is priced by the multipliers of [`crate::bound`], its slots are given to users by an
//! optimal [assignment](assign), and path and assignment improve each other in turn down to
//! millimetres. What comes out is a [`Plan`]: it keeps every constraint with a margin, and
//! [`SearchPolicy`] flies it.

mod assignment;
mod plan;
mod polish;
mod rearrange;

pub use assignment::assign;
pub use plan::{Plan, SearchPolicy};

pub(crate) use polish::PathRules;

use firmware_core::Position;

/// Side of the first stencils, as a fraction of `V_max delta`.
const FIRST_SPACING: f64 = 0.25;
/// Rounds at one spacing, at most: a round that gains less than [`WORTHWHILE`] ends it.
const ROUNDS_PER_SPACING: usize = 12;
/// Relative gain below which a spacing is exhausted.
const WORTHWHILE: f64 = 1e-4;
/// Spacings of the stencils in which the order of service is changed, as fractions of
/// `V_max delta`.
const REARRANGE_SPACINGS: [f64; 2] = [0.25, 0.125];
/// Changes at one spacing, at most.
const CHANGES_PER_SPACING: usize = 40;
/// Slots that a change of order may span.
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
            let stencils = rules.stencils(&plan.waypoints, spacing_m);
            let (_, path) = stencils.best_chain(&plan.users);
            let better = Plan::assigned(rules.mission, path);
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

/// Improves a plan by changes of the order of service until none is worthwhile.
pub(crate) fn rearrange<const M: usize, const J: usize>(
    rules: &PathRules<'_, M, J>,
    mut plan: Plan,
) -> Plan {
    for spacing in REARRANGE_SPACINGS {
        for _ in 0..CHANGES_PER_SPACING {
            let stencils = rules.stencils(&plan.waypoints, spacing * rules.reach_m);
            let least = plan.sum_rate * (1.0 + WORTHWHILE);
            let Some(users) = stencils.best_change(&plan.users, CHANGE_SPAN, least) else {
                break;
            };
            let (_, path) = stencils.best_chain(&users);
            let better = Plan::assigned(rules.mission, path);
            if better.sum_rate <= least {
                break;
            }
            plan = better;
        }
    }
    plan
}

/// Turns any path into one that `rules` admit and that bends it as little as one pass forward
/// can: each waypoint is drawn to the nearest place that can be reached and from which the
/// destination can. `None` where the margin leaves no way.
pub(crate) fn made_admissible<const M: usize, const J: usize>(
    rules: &PathRules<'_, M, J>,
    wished: &[Position<f64>],
) -> Option<Vec<Position<f64>>> {
    use firmware_core::shield::ReachableSet;
    let p = rules.mission.parameters();
    // Rounding to the lattice may leave the disc around the destination by less than a quantum:
    // a step is that much longer than what the disc shrinks by.
    let step_m = rules.reach_m - rules.quantum_m;
    let home_m = step_m - rules.quantum_m;
    let mut from = p.start;
    let mut path = Vec::with_capacity(wished.len());
    for (index, wish) in wished.iter().enumerate() {
        let left = (wished.len() - index) as f64;
        let set = ReachableSet::new(p.area, from, step_m, p.destination, left * home_m);
        from = rules.on_lattice(set.nearest(wish)?)?;
        path.push(from);
    }
    rules.admits(&path).then_some(path)
}
