//! The benchmark of policies. Flights, bounds and statistics are those of the crate `simulation`, which
//! `host-sim benchmark` prints.

use std::{
    io,
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
};

use numpy::IntoPyArray;
use pyo3::{prelude::*, types::PyDict};
use rayon::prelude::*;
use scenario::Scenario;
use simulation::{
    benchmark::{self, BoundRecord, Flown},
    policy::PolicyChoice,
};
use vehicle::Profile;

use crate::{
    interrupt,
    mission::{Mission, value_error},
    threads,
};

/// The certified bounds of missions.
#[pyclass(module = "aircomp_uav._native")]
#[derive(Clone, Debug)]
pub(crate) struct BenchmarkBounds {
    bounds: benchmark::Bounds,
}

#[pymethods]
impl BenchmarkBounds {
    /// Returns the bounds of the benchmark's 200 missions.
    #[staticmethod]
    fn shipped() -> Self {
        let bounds = benchmark::Bounds::shipped();
        Self { bounds }
    }

    /// Reads `bounds.csv` of a directory.
    #[staticmethod]
    fn read(directory: PathBuf) -> PyResult<Self> {
        let bounds = benchmark::Bounds::read(&directory).map_err(value_error)?;
        Ok(Self { bounds })
    }

    /// Returns the upper bound and the certified gap of a mission, or `None` if they are not known.
    fn of(&self, mission: PyRef<'_, Mission>) -> Option<(f64, f64)> {
        let record = self.bounds.of(&mission.scenario.digest())?;
        Some((record.upper, record.gap))
    }

    /// Computes the bound of a mission.
    #[pyo3(signature = (mission, threads = None))]
    fn certify(
        &mut self,
        py: Python<'_>,
        mission: PyRef<'_, Mission>,
        threads: Option<usize>,
    ) -> PyResult<()> {
        let scenario = Arc::clone(&mission.scenario);
        let pool = threads::pool(threads::count(threads))?;
        let record: Result<BoundRecord, String> = interrupt::run(py, |stop| {
            let stop = || stop.load(Ordering::Relaxed);
            pool.install(|| benchmark::Bounds::certify_until(&scenario, &stop))
        })?;
        self.bounds.insert(record.map_err(value_error)?);
        Ok(())
    }
}

/// The flights of one policy.
#[pyclass(module = "aircomp_uav._native")]
#[derive(Clone, Debug)]
pub(crate) struct BenchmarkFlights {
    policy: String,
    flights: Vec<Flown>,
}

#[pymethods]
impl BenchmarkFlights {
    /// Returns no flights, of a policy with this name.
    #[new]
    fn new(policy: String) -> Self {
        let flights = Vec::new();
        Self { policy, flights }
    }

    /// The name of the policy.
    #[getter]
    fn policy(&self) -> &str {
        &self.policy
    }

    /// Adds a flight that was flown through the environment; NaN is the sum rate of a policy that does
    /// not fit the mission.
    #[pyo3(signature = (mission, *, sum_rate, violations, inaccurate_slots, preparation_s, decision_us))]
    fn add(
        &mut self,
        mission: PyRef<'_, Mission>,
        sum_rate: f64,
        violations: usize,
        inaccurate_slots: usize,
        preparation_s: f64,
        decision_us: f64,
    ) {
        self.flights.push(Flown {
            mission: mission.scenario.name.clone(),
            digest: mission.scenario.digest(),
            policy: self.policy.clone(),
            profile: Profile::Ideal.to_string(),
            sum_rate,
            violations,
            inaccurate_slots,
            preparation_s,
            decision_us,
        });
    }

    /// Returns a column per quantity, a row per mission.
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let flights = &self.flights;
        let floats = |value: fn(&Flown) -> f64| -> Vec<f64> { flights.iter().map(value).collect() };
        let whole = |value: fn(&Flown) -> usize| -> Vec<i64> {
            flights.iter().map(|flown| value(flown) as i64).collect()
        };
        let words = |value: fn(&Flown) -> &String| -> Vec<String> {
            flights.iter().map(|flown| value(flown).clone()).collect()
        };
        let table = PyDict::new(py);
        table.set_item("mission", words(|flown| &flown.mission))?;
        table.set_item("digest", words(|flown| &flown.digest))?;
        table.set_item("sum_rate", floats(|flown| flown.sum_rate).into_pyarray(py))?;
        let violations = whole(|flown| flown.violations);
        table.set_item("violations", violations.into_pyarray(py))?;
        let inaccurate = whole(|flown| flown.inaccurate_slots);
        table.set_item("inaccurate_slots", inaccurate.into_pyarray(py))?;
        let preparation = floats(|flown| flown.preparation_s);
        table.set_item("preparation_s", preparation.into_pyarray(py))?;
        let decision = floats(|flown| flown.decision_us);
        table.set_item("decision_us", decision.into_pyarray(py))?;
        Ok(table)
    }

    /// Returns the statistics over all missions.
    fn statistics<'py>(
        &self,
        py: Python<'py>,
        bounds: PyRef<'_, BenchmarkBounds>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let found = benchmark::statistics(
            &self.policy,
            &self.policy,
            &self.flights,
            &[],
            &bounds.bounds,
        );
        let result = PyDict::new(py);
        result.set_item("policy", found.policy)?;
        for (name, count) in [
            ("flown", found.flown),
            ("refused", found.refused),
            ("counted", found.counted),
            ("violations", found.violations),
            ("inaccurate_slots", found.inaccurate_slots),
        ] {
            result.set_item(name, count)?;
        }
        for (name, number) in [
            ("mean", found.mean),
            ("quantile_5", found.quantile_5),
            ("worst", found.worst),
            ("preparation_median_s", found.preparation_median_s),
            ("preparation_max_s", found.preparation_max_s),
            ("decision_median_us", found.decision_median_us),
        ] {
            result.set_item(name, number)?;
        }
        result.set_item("worst_mission", found.worst_mission)?;
        Ok(result)
    }
}

/// Returns the missions of a directory, sorted by name.
#[pyfunction]
pub(crate) fn benchmark_missions(directory: PathBuf) -> PyResult<Vec<Mission>> {
    // A directory that cannot be opened is an OSError, wrong content a ValueError.
    std::fs::read_dir(&directory).map_err(|error| os_error(&directory, &error))?;
    let scenarios = benchmark::missions(&directory).map_err(value_error)?;
    let missions = scenarios.into_iter().map(|scenario| Mission {
        scenario: Arc::new(scenario),
    });
    Ok(missions.collect())
}

/// Flies a policy of `host-sim benchmark --policy` through missions, `jobs` of them at the same time.
#[pyfunction]
#[pyo3(signature = (missions, policy, *, profile = "ideal", jobs = 1))]
pub(crate) fn benchmark_fly(
    py: Python<'_>,
    missions: Vec<PyRef<'_, Mission>>,
    policy: &str,
    profile: &str,
    jobs: usize,
) -> PyResult<BenchmarkFlights> {
    let choice: PolicyChoice = policy
        .parse()
        .map_err(|problem| value_error(format!("policy is {policy:?}, but {problem}")))?;
    let missing = choice.check_path();
    missing.map_err(|(path, error)| os_error(path, &error))?;
    let profile: Profile = profile
        .parse()
        .map_err(|problem| value_error(format!("profile is {profile:?}: {problem}")))?;
    let scenarios: Vec<Arc<Scenario>> = missions
        .iter()
        .map(|mission| Arc::clone(&mission.scenario))
        .collect();
    let pool = threads::pool(jobs.clamp(1, threads::THREADS_MAX))?;
    let flights = interrupt::run(py, |stop| {
        let fly = |scenario: &Arc<Scenario>| {
            (!stop.load(Ordering::Relaxed)).then(|| fly(scenario, &choice, profile))
        };
        pool.install(|| scenarios.par_iter().filter_map(fly).collect())
    })?;
    Ok(BenchmarkFlights {
        policy: choice.to_string(),
        flights,
    })
}

#[cfg(feature = "onnx")]
fn fly(scenario: &Scenario, choice: &PolicyChoice, profile: Profile) -> Flown {
    benchmark::fly(scenario, choice, profile)
}

#[cfg(not(feature = "onnx"))]
fn fly(scenario: &Scenario, choice: &PolicyChoice, profile: Profile) -> Flown {
    let convert =
        |onnx: &[u8]| trainer::onnx::to_policy_file(onnx).map_err(|error| format!("{error:#}"));
    benchmark::fly_converted(scenario, choice, profile, convert)
}

fn os_error(path: &Path, error: &io::Error) -> PyErr {
    io::Error::new(error.kind(), format!("{}: {error}", path.display())).into()
}
