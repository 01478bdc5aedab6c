//! The onboard planner on the host: plans a whole mission at once, and provides the policy that
//! flies it.
//!
//! The algorithm is [`firmware_core::planner`], in double precision, with memory from the heap.

pub mod ground_control;

use std::time::{Duration, Instant};

use firmware_core::{
    Mission, Position, SENSORS_MAX, USERS_MAX,
    planner::{Capacity, Planner, PlannerError},
};
use serde::Serialize;

use scenario::PlaceRates;

use crate::search::Plan;

/// The planner on the host: at the default capacities, with memory from the heap.
pub type HostPlanner = Planner<f64, (Vec<f64>, Vec<u8>), USERS_MAX, SENSORS_MAX>;

/// The number of operations after which planning stops. Missions of 90 slots need about 2 x 10^9
/// operations. A mission of thousands of slots would take minutes.
const OPERATIONS_MAX: u64 = 20_000_000_000;
/// The number of operations between two looks at the clock: about 1 ms.
const OPERATIONS_PER_STEP: u64 = 5_000_000;
/// The number of operations between two reports of progress: about 20 ms.
const OPERATIONS_PER_REPORT: u64 = 100_000_000;
/// The number of operations that the policy may spend on a slot in flight: about 5 ms.
const OPERATIONS_PER_SLOT: u64 = 20_000_000;

/// The number of slots that may be added to a mission in flight.
const SLOTS_TO_SPARE: usize = 60;

/// The progress of planning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanProgress {
    /// The sum of the rates of the present plan, bit/s/Hz.
    pub value: f64,
    /// An estimate of an upper bound on every plan, bit/s/Hz.
    pub upper_estimate: Option<f64>,
}

/// The plan of a whole mission.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedMission {
    /// The sum of the rates according to the channel model, bit/s/Hz.
    pub sum_rate: f64,
    /// An estimate of an upper bound on every plan, bit/s/Hz, or `None` if only one path can be
    /// flown. `host-sim bound` computes a certified bound.
    pub upper_estimate: Option<f64>,
    /// The relative gap, `(upper_estimate - sum_rate) / upper_estimate`.
    pub gap_estimate: Option<f64>,
    /// The time that planning took, seconds.
    pub seconds: f64,
    /// The number of operations that planning took.
    pub operations: u64,
    /// The memory of the planner, bytes.
    pub memory_bytes: usize,
    /// The waypoints `q_1` to `q_N`, metres.
    pub waypoints: Vec<Position<f64>>,
    /// The index of the served user in each slot.
    pub users: Vec<usize>,
}

impl From<PlannedMission> for Plan {
    fn from(planned: PlannedMission) -> Self {
        Self {
            waypoints: planned.waypoints,
            users: planned.users,
            sum_rate: planned.sum_rate,
        }
    }
}

/// Creates a planner for a mission. The planner has not done any work yet.
///
/// # Errors
/// Returns an error if the mission has more slots or users than a planner supports.
pub fn new_planner(
    mission: &Mission<f64, USERS_MAX, SENSORS_MAX>,
) -> Result<HostPlanner, PlannerError> {
    let capacity = capacity(mission);
    let memory = (vec![0.0; capacity.values()], vec![0; capacity.indices()]);
    let planner = Planner::new(mission, capacity, memory)?;
    Ok(planner.with_operations_per_slot(OPERATIONS_PER_SLOT))
}

/// Returns the capacity for a mission to which slots may be added in flight, and users join.
fn capacity(mission: &Mission<f64, USERS_MAX, SENSORS_MAX>) -> Capacity {
    let slots = mission.slots() as usize;
    Capacity {
        slots: slots + SLOTS_TO_SPARE,
        users: USERS_MAX,
        ..Capacity::new(slots, mission.user_count())
    }
}

/// Runs the planner until nothing is left to do, or up to 2 x 10^10 operations (some seconds).
/// Calls `progress` every 20 ms. Returns the number of operations.
pub fn finish(planner: &mut HostPlanner, progress: impl FnMut(&PlanProgress)) -> u64 {
    finish_within(planner, Duration::MAX, progress)
}

/// As [`finish`], and stops when `time` has passed.
fn finish_within(
    planner: &mut HostPlanner,
    time: Duration,
    mut progress: impl FnMut(&PlanProgress),
) -> u64 {
    let started = Instant::now();
    let mut operations = 0;
    let mut reported = 0;
    while operations < OPERATIONS_MAX && started.elapsed() < time {
        let advanced = planner.advance(OPERATIONS_PER_STEP);
        operations += advanced.operations;
        if advanced.finished {
            break;
        }
        if operations - reported >= OPERATIONS_PER_REPORT {
            reported = operations;
            progress(&PlanProgress {
                value: planner.value(),
                upper_estimate: planner.upper_estimate(),
            });
        }
    }
    operations
}

/// Plans a whole mission. Calls `progress` every 20 ms.
///
/// # Errors
/// Returns an error if the mission has more slots or users than a planner supports.
pub fn plan(
    mission: &Mission<f64, USERS_MAX, SENSORS_MAX>,
    progress: impl FnMut(&PlanProgress),
) -> Result<PlannedMission, PlannerError> {
    plan_within(mission, Duration::MAX, progress)
}

/// As [`plan`], and stops when `time` has passed. The last step may take some milliseconds longer,
/// so the plan that is found depends on the speed of the machine.
///
/// # Errors
/// Returns an error if the mission has more slots or users than a planner supports.
pub fn plan_within(
    mission: &Mission<f64, USERS_MAX, SENSORS_MAX>,
    time: Duration,
    progress: impl FnMut(&PlanProgress),
) -> Result<PlannedMission, PlannerError> {
    let started = Instant::now();
    let mut planner = new_planner(mission)?;
    let operations = finish_within(&mut planner, time, progress);
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
