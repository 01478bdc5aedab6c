// SPDX-License-Identifier: MIT OR Apache-2.0
//! A planner for any mission: where to fly and whom to serve in the slots that remain, close to
//! the optimum, improved step by step while there is time.
//!
//! The outer problem (`docs/mathematics.md`, section 4) is a path (eq:traj1, eq:traj2) and a fair
//! assignment of users to its slots (eq:a1 to eq:a3) with the largest sum of rates, each slot
//! being solved exactly ([`crate::inner`]). The planner combines
//!
//! * prices on the users' quotas with backward dynamic programming over (stage, node) and a
//!   forward pass from the vehicle's actual position,
//! * the optimal assignment of users to the slots of a path,
//! * the dynamic programme for a fixed order of service, in turn with the assignment,
//! * continuous improvement of the waypoints in small stencils, and
//! * changes of the order of service.
//!
//! # Anytime
//!
//! From its creation a [`Planner`] has a feasible plan (at worst the fair straight line), and
//! [`Planner::advance`] improves it, in steps of bounded work. A plan is only ever replaced by one
//! with a larger sum of rates. The planner needs no allocator and no clock: the caller provides the
//! [`Memory`] and decides how much work to ask for and when.
//!
//! # In flight
//!
//! [`Planner::restart`] continues from any state: slot, measured position, slots served so far and
//! what the vehicle can do. On a vehicle with inertia, plans avoid turns that it cannot fly, and turn
//! back to the destination in time. [`Planner::change_mission`] takes over changes of users, sensors, threshold, noise or
//! speed. Both keep the prices and as much of the old plan as stays feasible. As a [`Policy`](crate::policy::Policy), the
//! planner follows its plan, corrected for the vehicle's position; the [shield](crate::shield)
//! still checks every action.
//!
//! The channel model may be wrong about a node. The planner compares the gains that are measured in
//! flight with the model's ([`Policy::note_gains`](crate::policy::Policy::note_gains)), and plans with
//! a bias per node as soon as it is more than chance. Under fading it plans with the rates at these
//! gains, not with expected rates, which have a nearly common factor: `cargo run --release -p planning
//! --example expected_rates` prints how little the difference matters.
//!
//! ```
//! # use firmware_core::{Mission, Position, Watt, mission::*, planner::*};
//! # let place = |x: f32, y: f32| Position::new(x, y);
//! # let parameters = MissionParameters::<f32, 16, 64> {
//! #     slots: 20, slot_duration_s: 1.0, start: place(100.0, 100.0), destination: place(500.0, 300.0),
//! #     area: Area { east_m: 600.0, north_m: 600.0 }, altitude_m: 100.0, max_speed_mps: 40.0,
//! #     carrier_hz: 2e9, radio_model: RadioModel::ProbabilisticLos,
//! #     environment: Environment { a: 9.613, b: 0.158 },
//! #     excess_loss_db: ExcessLoss { los: 1.0, nlos: 20.0 }, noise_power: Watt::from_dbm(-95.0),
//! #     mse_threshold: 0.1, user_power_max: Watt(0.2), sensor_power_max: Watt(0.05),
//! #     users: [place(100.0, 500.0), place(500.0, 100.0)].into_iter().collect(),
//! #     sensors: [place(300.0, 300.0), place(350.0, 200.0), place(200.0, 250.0)].into_iter().collect(),
//! # };
//! # let mission = Mission::new(parameters)?;
//! let capacity = Capacity::new(20, 2);
//! let memory = (vec![0.0_f32; capacity.values()], vec![0_u8; capacity.indices()]);
//! let mut planner = Planner::new(&mission, capacity, memory)?;
//! while !planner.advance(100_000).finished {}
//! let (first, gap) = (planner.waypoint(1), planner.gap_estimate());
//! assert!(first.is_some() && gap.is_some_and(|gap| gap < 0.1));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod anytime;
mod assignment;
mod inertia;
mod lattice;
mod learned_gains;
mod memory;
mod order;
mod place_rates;
mod polish;
mod polish_pairs;
mod prices;
mod route;
mod search;
mod service;
mod settings;
mod stages;

pub use anytime::{OperationsInFlight, Planner, PlannerState, Progress};
pub use memory::{Capacity, Memory, PlannerError};
pub use settings::PlannerSettings;
