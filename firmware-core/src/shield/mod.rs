// SPDX-License-Identifier: MIT OR Apache-2.0
//! The safety shield: enforces the mission's hard constraints on every action of a policy
//! (`docs/mathematics.md`, section 4).
//!
//! Before slot `n` of `N`, from `q_{n-1}`, the displacement that the policy asks for is projected
//! (Euclidean, exact) onto
//!
//! ```text
//! F_n = { q in Lambda : ||q - q_{n-1}|| <= V delta,  ||q - q_f|| <= (N - n + 1) V delta }
//! ```
//!
//! and the user is the one with the highest score among those that leave enough slots for the
//! quotas of all users: `sum_k max(0, floor(N/M) - count_k) <= N - n` after the slot. So eq:a1,
//! eq:a2, eq:a3, eq:traj1 and eq:traj2 hold for every policy, whatever it returns. A NaN, an infinity
//! or a wrong number of scores counts as no displacement and the admissible user with the best rate,
//! and is reported.
//!
//! `F_n` is the intersection of two discs and a rectangle. The nearest point of such a set is
//! inside, or is the nearest point of one border, or a corner where two borders meet: at most 29
//! candidates, each checked. Worst case: 29 candidates times 6 constraints, no iteration.
//!
//! ```
//! use firmware_core::{
//!     Displacement, Mission, Position,
//!     mission::MissionParameters,
//!     shield::{Intervention, ReachableSet, admissible_waypoint},
//! };
//!
//! let mission = Mission::new(MissionParameters::<f64, 4, 8> {
//!     users: [Position::new(200.0, 700.0)].into_iter().collect(),
//!     sensors: [Position::new(700.0, 100.0)].into_iter().collect(),
//!     ..MissionParameters::table_one()
//! })?;
//! let start = mission.parameters().start;
//! let reachable = ReachableSet::of_slot(&mission, 1, start);
//! // A policy that asks for a kilometre to the west, out of the area, in a slot of 30 m.
//! let wish = Displacement::new(-1000.0, 0.0);
//! let mut changed = Intervention::default();
//! let waypoint = admissible_waypoint(&reachable, &wish, &mut changed);
//! assert!(changed.any());
//! assert!(reachable.contains(&waypoint));
//! assert!(mission.parameters().area.contains(&waypoint));
//! # Ok::<(), firmware_core::mission::MissionError<f64>>(())
//! ```

mod agility;
mod fairness;
mod geometry;
mod intervention;
mod reachable;
mod waypoint;

#[cfg(feature = "planner")]
pub(crate) use agility::ARRIVAL_FRACTION;
pub use agility::Agility;
#[cfg(feature = "planner")]
pub(crate) use fairness::reduce_to;
pub use fairness::{Fairness, admissible_user, scores_are_sound};
pub use intervention::Intervention;
pub use reachable::ReachableSet;
pub use waypoint::{admissible_waypoint, displacement_is_sound};
