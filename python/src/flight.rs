//! `fly`: a policy on the ideal vehicle, with the controller that flies.

use std::sync::atomic::{AtomicBool, Ordering};

use environment::Allocation;
use firmware_core::controller::{ChannelState, Controller};
use numpy::IntoPyArray;
use pyo3::{prelude::*, types::PyDict};
use scenario::HostMission;

use crate::{
    interrupt,
    mission::{Mission, value_error},
    policy::Policy,
    threads,
};

/// A slot of a flight.
struct FlownSlot {
    slot: i64,
    east_m: f64,
    north_m: f64,
    served_user: i64,
    rate: f64,
    mse: f64,
    feasible: bool,
    intervened: bool,
    user_power_w: f64,
    normalizing_factor: f64,
}

/// Flies a policy through a mission and returns a column per quantity, and two truths of the
/// flight: whether it arrived, and whether it was fair.
#[pyfunction]
#[pyo3(signature = (mission, policy, *, inner = "exact", threads = None))]
pub(crate) fn fly<'py>(
    py: Python<'py>,
    mission: PyRef<'py, Mission>,
    policy: PyRef<'py, Policy>,
    inner: &str,
    threads: Option<usize>,
) -> PyResult<(Bound<'py, PyDict>, bool, bool)> {
    let allocation: Allocation = inner
        .parse()
        .map_err(|problem| value_error(format!("inner is {inner:?}: {problem}")))?;
    let scenario = mission.scenario.clone();
    allocation.check(&scenario.mission).map_err(value_error)?;
    let policy = policy.clone();
    let pool = threads::pool(threads::count(threads))?;
    let flown = interrupt::run(py, |stop| {
        pool.install(|| fly_slots(&scenario.mission, &policy, allocation, stop))
    })?;
    let (slots, arrived, fair) = flown.map_err(value_error)?;
    let table = PyDict::new(py);
    let floats = |value: fn(&FlownSlot) -> f64| slots.iter().map(value).collect::<Vec<f64>>();
    let whole = |value: fn(&FlownSlot) -> i64| slots.iter().map(value).collect::<Vec<i64>>();
    let truths = |value: fn(&FlownSlot) -> bool| slots.iter().map(value).collect::<Vec<bool>>();
    table.set_item("slot", whole(|slot| slot.slot).into_pyarray(py))?;
    table.set_item("east_m", floats(|slot| slot.east_m).into_pyarray(py))?;
    table.set_item("north_m", floats(|slot| slot.north_m).into_pyarray(py))?;
    table.set_item("user", whole(|slot| slot.served_user).into_pyarray(py))?;
    table.set_item("rate", floats(|slot| slot.rate).into_pyarray(py))?;
    table.set_item("mse", floats(|slot| slot.mse).into_pyarray(py))?;
    table.set_item("feasible", truths(|slot| slot.feasible).into_pyarray(py))?;
    table.set_item("shielded", truths(|slot| slot.intervened).into_pyarray(py))?;
    let user_power_w = floats(|slot| slot.user_power_w);
    table.set_item("user_power_w", user_power_w.into_pyarray(py))?;
    let factor = floats(|slot| slot.normalizing_factor);
    table.set_item("normalizing_factor", factor.into_pyarray(py))?;
    Ok((table, arrived, fair))
}

fn fly_slots(
    mission: &HostMission,
    policy: &Policy,
    inner: Allocation,
    stop: &AtomicBool,
) -> Result<(Vec<FlownSlot>, bool, bool), String> {
    let mut policy = policy.for_mission(mission)?;
    let mut controller =
        Controller::with_solver(mission.clone(), &mut *policy, inner.method(mission));
    let mut position = mission.parameters().start;
    let mut slots = Vec::new();
    while !controller.is_over() && !stop.load(Ordering::Relaxed) {
        let plan = controller
            .plan(position)
            .map_err(|error| error.to_string())?;
        position = plan.waypoint;
        let state = ChannelState::predicted(mission, plan.slot, &position);
        let command = controller
            .allocate(&state)
            .map_err(|error| error.to_string())?;
        slots.push(FlownSlot {
            slot: plan.slot.into(),
            east_m: position.x,
            north_m: position.y,
            served_user: command.served_user.map_or(-1, |user| user as i64),
            rate: command.rate,
            mse: command.mse,
            feasible: command.status.is_feasible(),
            intervened: plan.intervention.any(),
            user_power_w: command.user_power.0,
            normalizing_factor: command.normalizing_factor,
        });
    }
    let arrived = controller.mission().has_arrived(&position);
    let fair = controller.fairness().is_fair();
    Ok((slots, arrived, fair))
}
