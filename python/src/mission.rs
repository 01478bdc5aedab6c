//! Missions: scenarios as Python objects.

use std::{fs::File, path::PathBuf, sync::Arc};

use firmware_core::{Position, channel::GroundNode};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods};
use pyo3::{
    exceptions::{PyTypeError, PyValueError},
    prelude::*,
    types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple},
};
use scenario::{Changes, HostMission, Layout, PlaceRates, Scenario};

use crate::arrays::{ANY, readable};

/// The names of the built-in scenarios.
pub(crate) const SHIPPED: [&str; 3] = ["separated", "mixed", "slow"];

/// The largest depth of tables and lists in a scenario that is given as a dictionary.
const DEPTH_MAX: usize = 8;

/// A mission: positions, powers, limits. It cannot be changed.
#[pyclass(frozen, module = "aircomp_uav._native")]
#[derive(Clone, Debug)]
pub(crate) struct Mission {
    pub(crate) scenario: Arc<Scenario>,
}

impl Mission {
    fn new(scenario: Scenario) -> Self {
        Self {
            scenario: Arc::new(scenario),
        }
    }

    pub(crate) fn mission(&self) -> &HostMission {
        &self.scenario.mission
    }
}

/// Converts a message to a `ValueError`.
pub(crate) fn value_error(message: impl ToString) -> PyErr {
    PyValueError::new_err(message.to_string())
}

#[pymethods]
impl Mission {
    /// Reads a scenario file.
    #[staticmethod]
    fn from_path(path: PathBuf) -> PyResult<Self> {
        // A file that cannot be opened is an OSError, one with a wrong content a ValueError.
        if let Err(error) = File::open(&path) {
            let text = format!("{}: {error}", path.display());
            return Err(std::io::Error::new(error.kind(), text).into());
        }
        Scenario::load(&path).map(Self::new).map_err(value_error)
    }

    /// Returns a built-in scenario.
    #[staticmethod]
    fn shipped(name: &str) -> PyResult<Self> {
        Scenario::shipped(name).map(Self::new).ok_or_else(|| {
            value_error(format!(
                "no built-in scenario is named {name:?}; there are {}",
                SHIPPED.join(", ")
            ))
        })
    }

    /// Parses the text of a scenario file.
    #[staticmethod]
    #[pyo3(signature = (text, name = "scenario"))]
    fn from_toml(text: &str, name: &str) -> PyResult<Self> {
        Scenario::parse(name, text)
            .map(Self::new)
            .map_err(value_error)
    }

    /// Makes a mission from the tables of a scenario file as dictionaries.
    #[staticmethod]
    #[pyo3(signature = (tables, name = "scenario"))]
    fn from_dict(tables: &Bound<'_, PyDict>, name: &str) -> PyResult<Self> {
        let value = toml_value("scenario", tables.as_any(), DEPTH_MAX)?;
        let text = toml::to_string(&value).map_err(value_error)?;
        Self::from_toml(&text, name)
    }

    /// Draws a mission from the benchmark's distribution.
    #[staticmethod]
    #[pyo3(signature = (seed, layout = None))]
    fn random(py: Python<'_>, seed: u64, layout: Option<&str>) -> PyResult<Self> {
        let layout = layout.map(layout_named).transpose()?;
        let scenario = py.detach(|| scenario::random(seed, layout));
        scenario.map(Self::new).map_err(value_error)
    }

    /// Returns the mission with other parameters.
    #[pyo3(signature = (*, mse_threshold = None, noise_dbm = None, slots = None))]
    fn changed(
        &self,
        mse_threshold: Option<f64>,
        noise_dbm: Option<f64>,
        slots: Option<u32>,
    ) -> PyResult<Self> {
        let changes = Changes {
            mse_threshold,
            noise_dbm,
            slots,
        };
        let scenario = Scenario::clone(&self.scenario).changed(&changes);
        scenario.map(Self::new).map_err(value_error)
    }

    /// Returns the text of the scenario file.
    fn to_toml(&self) -> String {
        self.scenario.to_toml()
    }

    /// The name: the stem of the file, or how the mission was made.
    #[getter]
    fn name(&self) -> &str {
        &self.scenario.name
    }

    /// SHA-256 of the mission, hexadecimal.
    #[getter]
    fn digest(&self) -> String {
        self.scenario.digest()
    }

    /// `N`, the number of slots.
    #[getter]
    fn slots(&self) -> u32 {
        self.mission().slots()
    }

    /// `M`, the number of users.
    #[getter]
    fn users(&self) -> usize {
        self.mission().user_count()
    }

    /// `J`, the number of sensors.
    #[getter]
    fn sensors(&self) -> usize {
        self.mission().sensor_count()
    }

    /// The number of slots in which every user must be served.
    #[getter]
    fn quota(&self) -> u32 {
        self.mission().quota()
    }

    /// `V_max delta`, metres.
    #[getter]
    fn reach_m(&self) -> f64 {
        self.mission().reach_m()
    }

    /// The altitude of flight, metres.
    #[getter]
    fn altitude_m(&self) -> f64 {
        self.mission().parameters().altitude_m
    }

    /// The duration of a slot, seconds.
    #[getter]
    fn slot_duration_s(&self) -> f64 {
        self.mission().parameters().slot_duration_s
    }

    /// The highest speed, m/s.
    #[getter]
    fn max_speed_mps(&self) -> f64 {
        self.mission().parameters().max_speed_mps
    }

    /// `Gamma`.
    #[getter]
    fn mse_threshold(&self) -> f64 {
        self.mission().parameters().mse_threshold
    }

    /// `sigma^2`, watts.
    #[getter]
    fn noise_power_w(&self) -> f64 {
        self.mission().parameters().noise_power.0
    }

    /// `p^max`, watts.
    #[getter]
    fn user_power_max_w(&self) -> f64 {
        self.mission().parameters().user_power_max.0
    }

    /// `p_b^max`, watts.
    #[getter]
    fn sensor_power_max_w(&self) -> f64 {
        self.mission().parameters().sensor_power_max.0
    }

    /// The rate that no position can exceed, bit/s/Hz per slot.
    #[getter]
    fn slot_rate_limit(&self) -> f64 {
        self.mission().slot_rate_limit()
    }

    /// The start, metres east and north.
    #[getter]
    fn start_m(&self) -> (f64, f64) {
        let place = self.mission().parameters().start;
        (place.x, place.y)
    }

    /// The destination, metres east and north.
    #[getter]
    fn destination_m(&self) -> (f64, f64) {
        let place = self.mission().parameters().destination;
        (place.x, place.y)
    }

    /// The extent of the area to the east and north, metres.
    #[getter]
    fn area_m(&self) -> (f64, f64) {
        let area = self.mission().parameters().area;
        (area.east_m, area.north_m)
    }

    /// The positions of the users, metres, `(M, 2)`.
    #[getter]
    fn user_positions_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        places(py, &self.mission().parameters().users)
    }

    /// The positions of the sensors, metres, `(J, 2)`.
    #[getter]
    fn sensor_positions_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        places(py, &self.mission().parameters().sensors)
    }

    /// Returns the power gains of users and sensors from positions `(n, 2)`.
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn gains<'py>(
        &self,
        py: Python<'py>,
        positions_m: &Bound<'py, PyArrayDyn<f64>>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)> {
        let positions = finite_positions(positions_m)?;
        let mission = self.mission();
        let gains = |nodes: Vec<GroundNode>| {
            let rows = positions.iter().flat_map(|place| {
                let nodes = nodes.iter();
                nodes.map(move |&node| mission.power_gain(node, place).0)
            });
            let numbers: Vec<f64> = rows.collect();
            numbers
                .into_pyarray(py)
                .reshape([positions.len(), nodes.len()])
        };
        let users = (0..mission.user_count()).map(GroundNode::User);
        let sensors = (0..mission.sensor_count()).map(GroundNode::Sensor);
        Ok((gains(users.collect())?, gains(sensors.collect())?))
    }

    /// Returns the rates of all users, bit/s/Hz, with the vehicle at positions `(n, 2)`.
    fn rates<'py>(
        &self,
        py: Python<'py>,
        positions_m: &Bound<'py, PyArrayDyn<f64>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let positions = finite_positions(positions_m)?;
        let users = self.users();
        let rates = crate::interrupt::run(py, |stop| {
            let mut rates = vec![0.0; positions.len() * users];
            let mut place_rates = PlaceRates::new(self.mission());
            for (place, row) in positions.iter().zip(rates.chunks_mut(users)) {
                if stop.load(std::sync::atomic::Ordering::Relaxed) {
                    break;
                }
                place_rates.write(place, row);
            }
            rates
        })?;
        rates.into_pyarray(py).reshape([positions.len(), users])
    }

    fn __repr__(&self) -> String {
        format!(
            "Mission({:?}, slots={}, users={}, sensors={})",
            self.name(),
            self.slots(),
            self.users(),
            self.sensors()
        )
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other
            .cast::<Self>()
            .is_ok_and(|other| *other.get().scenario == *self.scenario)
    }

    fn __hash__(&self) -> u64 {
        let digest = self.scenario.digest();
        u64::from_str_radix(&digest[..16], 16).unwrap_or_default()
    }
}

/// Returns positions as an array `(n, 2)`.
pub(crate) fn places<'py>(
    py: Python<'py>,
    places: &[Position<f64>],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let numbers = places.iter().flat_map(|place| [place.x, place.y]);
    let numbers: Bound<'py, PyArray1<f64>> = numbers.collect::<Vec<_>>().into_pyarray(py);
    numbers.reshape([places.len(), 2])
}

/// Returns the rows of an array `(n, 2)`, which must be finite.
fn finite_positions(positions_m: &Bound<'_, PyArrayDyn<f64>>) -> PyResult<Vec<Position<f64>>> {
    let numbers = readable("positions_m", positions_m, &[ANY, 2])?;
    let (rows, _) = numbers.as_slice()?.as_chunks::<2>();
    if let Some(row) = rows
        .iter()
        .position(|row| row.iter().any(|x| !x.is_finite()))
    {
        return Err(value_error(format!(
            "positions_m[{row}] is {:?}, but must be finite",
            rows[row]
        )));
    }
    let places = rows.iter().map(|&[east, north]| Position::new(east, north));
    Ok(places.collect())
}

fn layout_named(name: &str) -> PyResult<Layout> {
    match name {
        "uniform" => Ok(Layout::Uniform),
        "clustered" => Ok(Layout::Clustered),
        "ring" => Ok(Layout::Ring),
        "line" => Ok(Layout::Line),
        "corner" => Ok(Layout::Corner),
        _ => Err(value_error(format!(
            "layout is {name:?}, but must be uniform, clustered, ring, line or corner"
        ))),
    }
}

/// Converts a Python value to TOML's: dictionaries, lists, tuples, arrays, strings and numbers.
fn toml_value(name: &str, value: &Bound<'_, PyAny>, depth: usize) -> PyResult<toml::Value> {
    if depth == 0 {
        return Err(value_error(format!("{name} is nested too deeply")));
    }
    // `bool` is a subclass of `int`.
    if value.is_instance_of::<PyBool>() {
        return Ok(toml::Value::Boolean(value.extract()?));
    }
    if value.is_instance_of::<PyInt>() {
        let number = value.extract::<i64>();
        return number
            .map(toml::Value::Integer)
            .map_err(|_| value_error(format!("{name} is {value}, which is too large")));
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(toml::Value::Float(value.extract()?));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(toml::Value::String(value.extract()?));
    }
    if let Ok(table) = value.cast::<PyDict>() {
        let mut entries = toml::Table::new();
        for (key, value) in table {
            let key: String = key.extract().map_err(|_| {
                PyTypeError::new_err(format!("{name} has the key {key}, which is no string"))
            })?;
            let value = toml_value(&format!("{name}.{key}"), &value, depth - 1)?;
            entries.insert(key, value);
        }
        return Ok(toml::Value::Table(entries));
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let items = value.try_iter()?.enumerate();
        let items =
            items.map(|(index, item)| toml_value(&format!("{name}[{index}]"), &item?, depth - 1));
        return items.collect::<PyResult<_>>().map(toml::Value::Array);
    }
    // Arrays and numbers of NumPy.
    if value.hasattr("tolist")? {
        return toml_value(name, &value.call_method0("tolist")?, depth - 1);
    }
    Err(PyTypeError::new_err(format!(
        "{name} is a {}, but must be a dict, list, string or number",
        value.get_type().name()?
    )))
}
