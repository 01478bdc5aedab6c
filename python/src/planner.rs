//! `Planner`: the onboard planner.

use std::{sync::atomic::Ordering, time::Instant};

use firmware_core::Position;
use numpy::{PyArray1, PyArray2};
use planning::planner::{HostPlanner, new_planner};
use pyo3::prelude::*;

use crate::{
    bound::{numbers, time_limit},
    interrupt,
    mission::{Mission, places, value_error},
};

/// The number of operations between two looks at the clock: about 1 ms.
const OPERATIONS_PER_STEP: u64 = 5_000_000;
/// The number of operations after which planning stops.
pub(crate) const OPERATIONS_MAX: u64 = 20_000_000_000;

/// The onboard planner for a mission: an anytime algorithm, which always has a feasible plan.
#[pyclass(module = "aircomp_uav._native")]
#[derive(Debug)]
pub(crate) struct Planner {
    planner: Box<HostPlanner>,
    slots: u32,
    finished: bool,
}

#[pymethods]
impl Planner {
    #[new]
    fn new(mission: PyRef<'_, Mission>) -> PyResult<Self> {
        let planner = new_planner(mission.mission()).map_err(value_error)?;
        Ok(Self {
            planner: Box::new(planner),
            slots: mission.mission().slots(),
            finished: false,
        })
    }

    /// Improves the plan by about this number of operations, and returns whether it is finished.
    fn advance(&mut self, py: Python<'_>, operations: u64) -> PyResult<bool> {
        self.improve(py, operations, None)
    }

    /// Improves the plan until nothing is left to do or the time is over; returns whether it is
    /// finished.
    #[pyo3(signature = (time_limit_s = None))]
    fn finish(&mut self, py: Python<'_>, time_limit_s: Option<f64>) -> PyResult<bool> {
        self.improve(py, OPERATIONS_MAX, time_limit_s)
    }

    /// Whether nothing is left to do.
    #[getter]
    fn finished(&self) -> bool {
        self.finished
    }

    /// The sum of the rates of the plan, bit/s/Hz.
    #[getter]
    fn value(&self) -> f64 {
        self.planner.value()
    }

    /// An estimate of an upper bound on every plan, bit/s/Hz, or `None`.
    #[getter]
    fn upper_estimate(&self) -> Option<f64> {
        self.planner.upper_estimate()
    }

    /// The waypoints of the plan, metres, `(N, 2)`.
    fn waypoints_m<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let waypoints: Vec<Position<f64>> = (1..=self.slots)
            .map_while(|slot| self.planner.waypoint(slot))
            .collect();
        places(py, &waypoints)
    }

    /// The served user of every slot.
    fn users<'py>(&mut self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let users: Vec<usize> = (1..=self.slots)
            .map_while(|slot| self.planner.served_user(slot))
            .collect();
        numbers(py, &users)
    }
}

impl Planner {
    fn improve(
        &mut self,
        py: Python<'_>,
        operations: u64,
        time_limit_s: Option<f64>,
    ) -> PyResult<bool> {
        let limit = time_limit(time_limit_s)?;
        let planner = &mut self.planner;
        self.finished = interrupt::run(py, |stop| {
            let started = Instant::now();
            let mut left = operations;
            while left > 0 && !stop.load(Ordering::Relaxed) && started.elapsed() < limit {
                let progress = planner.advance(left.min(OPERATIONS_PER_STEP));
                if progress.finished {
                    return true;
                }
                left = left.saturating_sub(progress.operations.max(1));
            }
            false
        })?;
        Ok(self.finished)
    }
}
