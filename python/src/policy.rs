//! Policies that decide in Rust: rules, the planner, and `.policy` files.

use std::{fs, path::PathBuf, sync::Arc};

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    policy::{
        FixedPosition, Policy as Decide, StraightLine, format_version,
        mlp::{self, Mlp},
        sets::{self, NetworkWithWork, SetsNetwork, SetsPolicy, SetsWork},
    },
};
use planning::{
    bound,
    planner::{finish, new_planner},
    search::SearchPolicy,
};
use pyo3::prelude::*;
use scenario::HostMission;

use crate::mission::value_error;

/// The shipped policy for any mission.
const ANY: &[u8] = include_bytes!("../../models/any.policy");

/// The rules and planners, by name.
const NAMES: [&str; 5] = ["straight-line", "fixed", "plan", "search", "any"];

/// A policy on the host.
pub(crate) type HostPolicy = Box<dyn Decide<f64, USERS_MAX> + Send>;

#[derive(Debug)]
enum Kind {
    StraightLine,
    Fixed,
    Plan,
    Search,
    OneMission(Box<Mlp<Vec<u8>>>),
    AnyMission(Box<SetsNetwork<Vec<u8>>>),
}

/// A policy that decides in Rust.
#[pyclass(frozen, module = "aircomp_uav._native")]
#[derive(Clone, Debug)]
pub(crate) struct Policy {
    name: String,
    kind: Arc<Kind>,
}

/// Loads a `.policy` file.
#[pyfunction]
pub(crate) fn load_policy(path: PathBuf) -> PyResult<Policy> {
    let named = |problem: String| value_error(format!("{}: {problem}", path.display()));
    let file = fs::read(&path).map_err(|error| {
        let text = format!("{}: {error}", path.display());
        std::io::Error::new(error.kind(), text)
    })?;
    let kind = read(file).map_err(named)?;
    let name = path.file_name().unwrap_or_default();
    Ok(Policy {
        name: name.to_string_lossy().into_owned(),
        kind: Arc::new(kind),
    })
}

fn read(file: Vec<u8>) -> Result<Kind, String> {
    match format_version(&file).map_err(|error| error.to_string())? {
        mlp::FORMAT_VERSION | mlp::FORMAT_VERSION_FUNCTIONS => {
            let policy = Mlp::load(file).map_err(|error| error.to_string())?;
            Ok(Kind::OneMission(Box::new(policy)))
        }
        sets::FORMAT_VERSION => {
            let mut work = Box::<SetsWork>::default();
            let network = SetsNetwork::load(file, &mut work).map_err(|error| error.to_string())?;
            Ok(Kind::AnyMission(Box::new(network)))
        }
        other => Err(format!(
            "format version is {other}, but this build reads {}, {} and {}",
            mlp::FORMAT_VERSION,
            sets::FORMAT_VERSION,
            mlp::FORMAT_VERSION_FUNCTIONS
        )),
    }
}

#[pymethods]
impl Policy {
    /// Returns a policy by its name.
    #[staticmethod]
    fn named(name: &str) -> PyResult<Self> {
        let kind = match name {
            "straight-line" => Kind::StraightLine,
            "fixed" => Kind::Fixed,
            "plan" => Kind::Plan,
            "search" => Kind::Search,
            "any" => read(ANY.to_vec()).map_err(value_error)?,
            _ => {
                return Err(value_error(format!(
                    "no policy is named {name:?}; there are {}, and files that end in .policy or .onnx",
                    NAMES.join(", ")
                )));
            }
        };
        Ok(Self {
            name: name.into(),
            kind: Arc::new(kind),
        })
    }

    /// The name, or that of the file.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// The format version of the file, or `None` for a rule or planner.
    #[getter]
    fn format_version(&self) -> Option<u16> {
        match *self.kind {
            Kind::OneMission(ref policy) => Some(policy.header().functions.format_version()),
            Kind::AnyMission(_) => Some(sets::FORMAT_VERSION),
            _ => None,
        }
    }

    fn __repr__(&self) -> String {
        format!("Policy({:?})", self.name)
    }
}

impl Policy {
    /// Prepares the policy for a mission, which takes some time where it plans.
    pub(crate) fn for_mission(&self, mission: &HostMission) -> Result<HostPolicy, String> {
        Ok(match &*self.kind {
            Kind::StraightLine => Box::new(StraightLine::new(mission)),
            Kind::Fixed => Box::new(FixedPosition::central(mission)),
            Kind::Plan => {
                let mut planner = new_planner(mission).map_err(|error| error.to_string())?;
                finish(&mut planner, |_| {});
                Box::new(planner)
            }
            Kind::Search => {
                let plan = bound::search(mission, |_| {}).map_err(|error| error.to_string())?;
                Box::new(SearchPolicy::new(plan))
            }
            Kind::OneMission(policy) => {
                let fits = policy.provenance().check(mission);
                fits.map_err(|mismatch| format!("{}: {mismatch}", self.name))?;
                policy.clone()
            }
            Kind::AnyMission(network) => {
                let network = NetworkWithWork {
                    network: SetsNetwork::clone(network),
                    work: Box::<SetsWork>::default(),
                };
                let policy: SetsPolicy<f64, _, USERS_MAX, SENSORS_MAX> =
                    SetsPolicy::new(network, mission).map_err(|mismatch| mismatch.to_string())?;
                Box::new(policy)
            }
        })
    }
}
