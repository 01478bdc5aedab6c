//! The onboard planner on the host: a whole mission planned at once, and the policy that flies it.
//!
//! The algorithm is [`firmware_core::planner`], in double precision, with memory from the heap.

pub mod ground_control;

use std::time::Instant;

use firmware_core::{
    Mission, Position, SENSORS_MAX, USERS_MAX,
    planner::{Capacity, Planner, PlannerError},
};
use serde::Serialize;

use scenario::PlaceRates;

/// The planner of the host: at the default capacities, with memory from the heap.
pub type HostPlanner = Planner<f64, (Vec<f64>, Vec<u8>), USERS_MAX, SENSORS_MAX>;

/// Operations after which planning stops. Missions of 90 slots need about 2 x 10^9, a mission of
/// thousands of slots would take minutes.
const OPERATIONS_MAX: u64 = 20_000_000_000;
/// Operations between two reports of progress: some 20 ms.
const OPERATIONS_PER_REPORT: u64 = 100_000_000;
/// Operations that the policy may spend on a slot in flight: some 5 ms.
const OPERATIONS_PER_SLOT: u64 = 20_000_000;

/// What planning has found so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanProgress {
    /// The sum of the rates of the plan, bit/s/Hz.
    pub value: f64,
    /// An estimate of what no plan exceeds, bit/s/Hz.
    pub upper_estimate: Option<f64>,
}

/// A whole mission, planned.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedMission {
    /// The sum of the rates, bit/s/Hz, by the channel model.
    pub sum_rate: f64,
    /// An estimate of what no plan exceeds, bit/s/Hz; `None` where there is only one way to fly.
    /// `host-sim bound` certifies a bound.
    pub upper_estimate: Option<f64>,
    /// `(upper_estimate - sum_rate) / upper_estimate`.
    pub gap_estimate: Option<f64>,
    /// What it took, seconds.
    pub seconds: f64,
    /// What it took, operations of the planner.
    pub operations: u64,
    /// Memory of the planner, bytes.
    pub memory_bytes: usize,
    /// `q_1` to `q_N`, metres.
    pub waypoints: Vec<Position<f64>>,
    /// The served user of each slot, from 0.
    pub users: Vec<usize>,
}

/// A planner for a mission, which has not begun to work.
///
/// # Errors
/// More slots or users than a planner holds.
pub fn new_planner(
    mission: &Mission<f64, USERS_MAX, SENSORS_MAX>,
) -> Result<HostPlanner, PlannerError> {
    let capacity = capacity(mission);
    let memory = (vec![0.0; capacity.values()], vec![0; capacity.indices()]);
    let planner = Planner::new(mission, capacity, memory)?;
    Ok(planner.with_operations_per_slot(OPERATIONS_PER_SLOT))
}

fn capacity(mission: &Mission<f64, USERS_MAX, SENSORS_MAX>) -> Capacity {
    Capacity::new(mission.slots() as usize, mission.user_count())
}

/// Works until nothing is left to do, or up to 2 x 10^10 operations (some seconds). Calls
/// `progress` every 20 ms. Returns the operations.
pub fn finish(planner: &mut HostPlanner, mut progress: impl FnMut(&PlanProgress)) -> u64 {
    let mut operations = 0;
    loop {
        let advanced = planner.advance(OPERATIONS_PER_REPORT);
        operations += advanced.operations;
        if advanced.finished || operations >= OPERATIONS_MAX {
            return operations;
        }
        progress(&PlanProgress {
            value: planner.value(),
            upper_estimate: planner.upper_estimate(),
        });
    }
}

/// Plans a whole mission. Calls `progress` every 20 ms.
///
/// # Errors
/// More slots or users than a planner holds.
pub fn plan(
    mission: &Mission<f64, USERS_MAX, SENSORS_MAX>,
    progress: impl FnMut(&PlanProgress),
) -> Result<PlannedMission, PlannerError> {
    let started = Instant::now();
    let mut planner = new_planner(mission)?;
    let operations = finish(&mut planner, progress);
    let seconds = started.elapsed().as_secs_f64();
    let mut place_rates = PlaceRates::new(mission);
    let mut row = [0.0; USERS_MAX];
    let mut planned = PlannedMission {
        sum_rate: 0.0,
        upper_estimate: planner.upper_estimate(),
        gap_estimate: None,
        seconds,
        operations,
        memory_bytes: capacity(mission).memory_bytes::<f64>(),
        waypoints: Vec::new(),
        users: Vec::new(),
    };
    for slot in 1..=mission.slots() {
        let (Some(place), Some(user)) = (planner.waypoint(slot), planner.served_user(slot)) else {
            break;
        };
        place_rates.write(&place, &mut row[..mission.user_count()]);
        planned.sum_rate += row.get(user).copied().unwrap_or(0.0);
        planned.waypoints.push(place);
        planned.users.push(user);
    }
    planned.gap_estimate = planned
        .upper_estimate
        .filter(|&upper| upper > 0.0)
        .map(|upper| ((upper - planned.sum_rate) / upper).max(0.0));
    Ok(planned)
}
