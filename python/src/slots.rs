//! `solve_slots`: the exact allocation of many slots.

use std::sync::atomic::{AtomicBool, Ordering};

use firmware_core::{
    PowerGain, Watt,
    inner::{ExactSolver, LimitedBy, PrefixSum, SensorField, SlotAllocation, SlotLimits},
};
use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods};
use pyo3::{prelude::*, types::PyDict};
use rayon::prelude::*;

use crate::{
    arrays::{ANY, readable},
    interrupt,
    mission::value_error,
    threads,
};

/// The number of slots that a thread solves at a time.
const CHUNK: usize = 256;

/// The result of a slot.
#[derive(Clone, Copy, Default)]
struct Solved {
    rate: f64,
    mse: f64,
    least_mse: f64,
    user_power_w: f64,
    normalizing_factor: f64,
    feasible: bool,
    limited_by: u8,
}

/// The arrays of the problems: a row of `sensors` gains, a user's gain and four limits per slot.
struct Problems<'a> {
    sensors: usize,
    sensor_gains: &'a [f64],
    user_gains: &'a [f64],
    limits: &'a [f64],
}

/// Solves slots: `sensor_gains` is `(n, J)`, `user_gains` is `(n)`, and `limits` is `(n, 4)` with
/// the powers of sensors and users, the noise (watts) and `Gamma`.
#[pyfunction]
#[pyo3(signature = (sensor_gains, user_gains, limits, threads = None))]
pub(crate) fn solve_slots<'py>(
    py: Python<'py>,
    sensor_gains: &Bound<'py, PyArrayDyn<f64>>,
    user_gains: &Bound<'py, PyArrayDyn<f64>>,
    limits: &Bound<'py, PyArrayDyn<f64>>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let sensor_gains = readable("sensor_gains", sensor_gains, &[ANY, ANY])?;
    let [count, sensors] = *sensor_gains.as_array().shape() else {
        return Err(value_error("sensor_gains must have two dimensions"));
    };
    let user_gains = readable("user_gains", user_gains, &[count])?;
    let limits = readable("limits", limits, &[count, 4])?;
    if sensors == 0 {
        return Err(value_error(
            "sensor_gains has no columns, but at least one sensor must be averaged",
        ));
    }
    let problems = Problems {
        sensors,
        sensor_gains: sensor_gains.as_slice()?,
        user_gains: user_gains.as_slice()?,
        limits: limits.as_slice()?,
    };
    let pool = threads::pool(threads::count(threads))?;
    let solved = interrupt::run(py, |stop| pool.install(|| problems.solve(stop)))?;
    let (slots, coefficients) = solved.map_err(value_error)?;
    let result = PyDict::new(py);
    let floats = |value: fn(&Solved) -> f64| slots.iter().map(value).collect::<Vec<f64>>();
    for (name, column) in [
        ("rate", floats(|slot| slot.rate)),
        ("mse", floats(|slot| slot.mse)),
        ("least_mse", floats(|slot| slot.least_mse)),
        ("user_power_w", floats(|slot| slot.user_power_w)),
        ("normalizing_factor", floats(|slot| slot.normalizing_factor)),
    ] {
        result.set_item(name, column.into_pyarray(py))?;
    }
    let feasible: Vec<bool> = slots.iter().map(|slot| slot.feasible).collect();
    result.set_item("feasible", feasible.into_pyarray(py))?;
    let limited_by: Vec<u8> = slots.iter().map(|slot| slot.limited_by).collect();
    result.set_item("limited_by", limited_by.into_pyarray(py))?;
    let coefficients = coefficients.into_pyarray(py).reshape([count, sensors])?;
    result.set_item("sensor_coefficients", coefficients)?;
    Ok(result)
}

impl Problems<'_> {
    /// Solves all slots, or as many as are done when `stop` is set.
    fn solve(&self, stop: &AtomicBool) -> Result<(Vec<Solved>, Vec<f64>), String> {
        let mut slots = vec![Solved::default(); self.user_gains.len()];
        let mut coefficients = vec![0.0; self.sensor_gains.len()];
        let chunks = slots.par_chunks_mut(CHUNK);
        let rows = coefficients.par_chunks_mut(CHUNK * self.sensors);
        let chunks = chunks.zip(rows).enumerate();
        chunks.try_for_each(|(chunk, (slots, rows))| {
            let mut amplitudes = vec![0.0; self.sensors];
            let mut sums = vec![PrefixSum::default(); self.sensors];
            let rows = rows.chunks_mut(self.sensors);
            for (index, (slot, row)) in slots.iter_mut().zip(rows).enumerate() {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                let index = chunk * CHUNK + index;
                *slot = self
                    .solve_one(index, row, &mut amplitudes, &mut sums)
                    .map_err(|problem| format!("slot {index}: {problem}"))?;
            }
            Ok::<(), String>(())
        })?;
        Ok((slots, coefficients))
    }

    fn solve_one(
        &self,
        index: usize,
        coefficients: &mut [f64],
        amplitudes: &mut [f64],
        sums: &mut [PrefixSum<f64>],
    ) -> Result<Solved, String> {
        let gains = &self.sensor_gains[index * self.sensors..][..self.sensors];
        let gains: Vec<_> = gains.iter().copied().map(PowerGain).collect();
        let limits = SlotLimits {
            sensor_power_max: Watt(self.limits[4 * index]),
            user_power_max: Watt(self.limits[4 * index + 1]),
            noise_power: Watt(self.limits[4 * index + 2]),
            mse_threshold: self.limits[4 * index + 3],
        };
        let field = SensorField::new(&limits, &gains, amplitudes, sums)
            .map_err(|error| error.to_string())?;
        let amplitude_gains: Vec<f64> = gains.iter().map(|gain| gain.amplitude()).collect();
        let user = Some(PowerGain(self.user_gains[index]));
        let SlotAllocation { solution, mse } = field
            .allocate(&ExactSolver, &amplitude_gains, user, coefficients)
            .map_err(|error| error.to_string())?;
        Ok(Solved {
            rate: solution.rate,
            mse,
            least_mse: field.least_mse(),
            user_power_w: solution.user_power.0,
            normalizing_factor: solution.normalizing_factor,
            feasible: solution.status.is_feasible(),
            limited_by: match solution.status.limited_by() {
                LimitedBy::None => 0,
                LimitedBy::Accuracy => 1,
                LimitedBy::Power => 2,
            },
        })
    }
}
