//! Flies a policy the way it would fly: firmware-core's controller on the ideal vehicle, the
//! channels of the model, double precision.

use firmware_core::{
    Position, USERS_MAX,
    controller::{ChannelState, Controller},
    policy::Policy,
};
use host_sim::allocation::Allocation;
use scenario::HostMission;
use serde::{Deserialize, Serialize};

/// What a flight came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flight {
    /// Sum of `R_n`, bit/s/Hz.
    pub sum_rate: f64,
    /// Whether it ended within one slot of the destination.
    pub arrived: bool,
    /// Whether every user had its quota.
    pub fair: bool,
    /// Slots that missed `Gamma`.
    pub mse_violations: u32,
    /// Slots in which the shield changed something.
    pub shield_interventions: u32,
    /// From the destination at the end, metres.
    pub arrival_distance_m: f64,
    /// Where it was at every slot's end, metres.
    pub path_m: Vec<[f64; 2]>,
    /// Who was served.
    pub served_users: Vec<usize>,
}

impl Flight {
    /// Whether it keeps every constraint of eq:p0.
    pub fn is_admissible(&self) -> bool {
        self.arrived && self.fair && self.mse_violations == 0
    }

    /// Whether it keeps every constraint that `inner` lets a policy keep: sensors of fixed power
    /// may miss `Gamma` wherever they are heard from.
    pub fn is_admissible_under(&self, inner: Allocation) -> bool {
        match inner {
            Allocation::FixedSensorPower(_) => self.arrived && self.fair,
            _ => self.is_admissible(),
        }
    }
}

/// Flies `policy` through the mission, powers chosen by `inner`.
///
/// # Errors
/// What the controller refuses; nothing, for a valid mission.
pub fn fly(
    mission: &HostMission,
    policy: impl Policy<f64, USERS_MAX>,
    inner: Allocation,
) -> anyhow::Result<Flight> {
    let mut controller =
        Controller::new(mission.clone(), policy).with_method(inner.method(mission));
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
