//! `certified_bound`: an upper bound that no admissible mission exceeds.

use std::{
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use numpy::IntoPyArray;
use planning::bound::{BoundSettings, certify_until};
use pyo3::{prelude::*, types::PyDict};

use crate::{
    interrupt,
    mission::{Mission, places, value_error},
    threads,
};

/// The longest time limit, seconds.
const TIME_LIMIT_MAX_S: f64 = 1e7;

/// Returns a time limit.
pub(crate) fn time_limit(seconds: Option<f64>) -> PyResult<Duration> {
    let Some(seconds) = seconds else {
        return Ok(Duration::MAX);
    };
    if !(0.0..=TIME_LIMIT_MAX_S).contains(&seconds) {
        return Err(value_error(format!(
            "time_limit_s is {seconds}, but must be 0 to {TIME_LIMIT_MAX_S} seconds"
        )));
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// Certifies an upper bound on the sum of rates of every admissible mission.
#[pyfunction]
#[pyo3(signature = (mission, *, gap, time_limit_s = None, threads = None))]
pub(crate) fn certified_bound<'py>(
    py: Python<'py>,
    mission: PyRef<'py, Mission>,
    gap: f64,
    time_limit_s: Option<f64>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    if !(1e-6..1.0).contains(&gap) {
        return Err(value_error(format!(
            "gap is {gap}, but must be at least 1e-6 and below 1"
        )));
    }
    let limit = time_limit(time_limit_s)?;
    let settings = BoundSettings {
        gap,
        ..BoundSettings::default()
    };
    let scenario = mission.scenario.clone();
    let pool = threads::pool(threads::count(threads))?;
    let bound = interrupt::run(py, |stop| {
        let started = Instant::now();
        let stop = || stop.load(Ordering::Relaxed) || started.elapsed() >= limit;
        pool.install(|| certify_until(&scenario.mission, &settings, &stop, |_| {}))
    })?;
    let bound = bound.map_err(value_error)?;
    let result = PyDict::new(py);
    for (name, number) in [
        ("upper", bound.upper),
        ("lower", bound.lower),
        ("gap", bound.gap),
        ("cell_m", bound.cell_m),
        ("seconds", bound.seconds),
    ] {
        result.set_item(name, number)?;
    }
    result.set_item("multipliers", bound.multipliers.into_pyarray(py))?;
    result.set_item("waypoints_m", places(py, &bound.plan.waypoints)?)?;
    result.set_item("users", numbers(py, &bound.plan.users))?;
    Ok(result)
}

/// Returns users as an array.
pub(crate) fn numbers<'py>(py: Python<'py>, users: &[usize]) -> Bound<'py, numpy::PyArray1<i64>> {
    let users = users.iter().map(|&user| user as i64);
    users.collect::<Vec<i64>>().into_pyarray(py)
}
