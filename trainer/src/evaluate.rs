//! Evaluation flights: `firmware-core`'s controller on the ideal vehicle with the channel gains of the
//! model, in double precision.

use environment::Allocation;
use firmware_core::{
    Position, USERS_MAX,
    controller::{ChannelState, Controller},
    policy::Policy,
};
use scenario::HostMission;
use serde::{Deserialize, Serialize};

/// The result of an evaluation flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flight {
    /// Sum of `R_n`, bit/s/Hz.
    pub sum_rate: f64,
    /// Whether it ended within one slot of the destination.
    pub arrived: bool,
    /// Whether every user had its quota.
    pub fair: bool,
    /// Number of slots that missed the MSE threshold `Gamma`.
    pub mse_violations: u32,
    /// Number of slots in which the shield changed the action.
    pub shield_interventions: u32,
    /// Distance from the destination at the end, metres.
    pub arrival_distance_m: f64,
    /// Position at the end of every slot, metres.
    pub path_m: Vec<[f64; 2]>,
    /// The user served in every slot.
    pub served_users: Vec<usize>,
}

impl Flight {
    /// Returns whether the flight satisfies every constraint of eq:p0.
    pub fn is_admissible(&self) -> bool {
        self.arrived && self.fair && self.mse_violations == 0
    }

    /// Returns whether the flight satisfies every constraint that a policy can satisfy under `inner`:
    /// with sensors of fixed power, `Gamma` may be missed at every position.
    pub fn is_admissible_under(&self, inner: Allocation) -> bool {
        match inner {
            Allocation::FixedSensorPower(_) => self.arrived && self.fair,
            _ => self.is_admissible(),
        }
    }
}

/// Flies `policy` through the mission with powers chosen by `inner`.
///
/// # Errors
/// Returns the controller's error. A valid mission causes none.
pub fn fly(
    mission: &HostMission,
    policy: impl Policy<f64, USERS_MAX>,
    inner: Allocation,
) -> anyhow::Result<Flight> {
    let mut controller = Controller::with_solver(mission.clone(), policy, inner.method(mission));
    let mut flight = Flight {
        sum_rate: 0.0,
        arrived: false,
        fair: false,
        mse_violations: 0,
        shield_interventions: 0,
        arrival_distance_m: 0.0,
        path_m: Vec::new(),
        served_users: Vec::new(),
    };
    let mut position: Position<f64> = mission.parameters().start;
    while !controller.is_over() {
        let plan = controller.plan(position)?;
        position = plan.waypoint;
        let state = ChannelState::predicted(mission, plan.slot, &position);
        let command = controller.allocate(&state)?;
        flight.sum_rate += command.rate;
        flight.mse_violations += u32::from(!command.status.is_feasible());
        flight.shield_interventions += u32::from(plan.intervention.any());
        flight.path_m.push([position.x, position.y]);
        flight.served_users.push(plan.served_user);
    }
    flight.arrived = controller.mission().has_arrived(&position);
    flight.fair = controller.fairness().is_fair();
    flight.arrival_distance_m = (position - mission.parameters().destination).norm();
    Ok(flight)
}
