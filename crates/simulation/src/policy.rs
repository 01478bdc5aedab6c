//! The policies that can be selected on the command line.

mod choice;
mod trained;

use std::{path::Path, time::Duration};

#[cfg(feature = "onnx")]
use firmware_core::policy::onnx::{OnnxNetwork, OnnxPolicy, SetsOnnx};
use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    mission::MissionChange,
    policy::{
        Action, FixedPosition, MeasuredGains, Observation, PlanQuality, Policy, Provenance,
        StraightLine, format_version,
        mlp::{self, Mlp},
        sets::{
            self, EvaluateSets, NetworkWithWork, SetsNetwork, SetsObservation, SetsOutput,
            SetsPolicy, SetsWork,
        },
    },
};

use files::{input, named};
use planning::bound;
use planning::planner::{self, HostPlanner, PlanProgress};
use planning::{search::SearchPolicy, waypoint_file};
use scenario::Scenario;

pub use choice::PolicyChoice;
pub use trained::for_any_mission;
use trained::{FOR_ANY_MISSION, shipped, trained_for};

/// Converts the content of an `.onnx` file to that of a `.policy` file. A program that is built without
/// tract can load `.onnx` files with it; the error is a message of one line.
pub type OnnxConverter = fn(&[u8]) -> Result<Vec<u8>, String>;

/// A trained network for any mission.
#[derive(Debug)]
pub enum AnyMissionNetwork {
    /// A `.policy` file, evaluated by the same code as on the microcontroller.
    File(NetworkWithWork<Vec<u8>, Box<SetsWork>>),
    /// An `.onnx` file, evaluated by tract.
    #[cfg(feature = "onnx")]
    Onnx(SetsOnnx),
}

impl EvaluateSets for AnyMissionNetwork {
    fn evaluate(&mut self, observation: &SetsObservation) -> Option<SetsOutput> {
        match self {
            Self::File(network) => network.evaluate(observation),
            #[cfg(feature = "onnx")]
            Self::Onnx(network) => network.evaluate(observation),
        }
    }
}

/// A trained policy for any mission on the host.
pub type AnyMissionPolicy = SetsPolicy<f64, AnyMissionNetwork, USERS_MAX, SENSORS_MAX>;

/// A policy of any kind that has been loaded for a mission.
#[derive(Debug)]
pub enum HostPolicy {
    /// Flies straight to the destination and serves the nearest user.
    StraightLine(StraightLine<f64, USERS_MAX>),
    /// Hovers over one position and serves the nearest user.
    Fixed(FixedPosition<f64, USERS_MAX>),
    /// A mission that was planned in advance.
    Search(SearchPolicy),
    /// The onboard planner.
    Plan(Box<HostPlanner>),
    /// A `.policy` file, evaluated by the same code as on the microcontroller.
    Mlp(Box<Mlp<Vec<u8>>>),
    /// A `.policy` or `.onnx` file for any mission.
    AnyMission(Box<AnyMissionPolicy>),
    /// An `.onnx` file, evaluated by tract.
    #[cfg(feature = "onnx")]
    Onnx(Box<OnnxPolicy>),
}

/// The progress of the preparation of a policy.
#[derive(Clone, Copy, Debug)]
pub enum LoadProgress<'a> {
    /// The progress of [`PolicyChoice::Search`].
    Search(&'a bound::BoundProgress),
    /// The progress of [`PolicyChoice::Plan`].
    Plan(&'a PlanProgress),
}

impl HostPolicy {
    /// Loads the selected policy for a mission, and returns it with its name for records.
    ///
    /// # Errors
    /// Returns a message of one line if a file cannot be read, is not a policy, or does not fit the
    /// mission.
    pub fn load(choice: &PolicyChoice, scenario: &Scenario) -> Result<(Self, String), String> {
        Self::load_watched(choice, scenario, |_| {})
    }

    /// Like [`HostPolicy::load`], but `.onnx` files are converted to `.policy` files and evaluated as
    /// these are.
    ///
    /// # Errors
    /// Like [`HostPolicy::load`].
    pub fn load_converted(
        choice: &PolicyChoice,
        scenario: &Scenario,
        converter: OnnxConverter,
    ) -> Result<(Self, String), String> {
        Self::load_with(choice, scenario, Some(converter), |_| {})
    }

    /// Like [`HostPolicy::load`], and calls `progress` during a search or a plan.
    ///
    /// # Errors
    /// Like [`HostPolicy::load`].
    pub fn load_watched(
        choice: &PolicyChoice,
        scenario: &Scenario,
        progress: impl FnMut(LoadProgress<'_>),
    ) -> Result<(Self, String), String> {
        Self::load_with(choice, scenario, None, progress)
    }

    fn load_with(
        choice: &PolicyChoice,
        scenario: &Scenario,
        converter: Option<OnnxConverter>,
        mut progress: impl FnMut(LoadProgress<'_>),
    ) -> Result<(Self, String), String> {
        let from_file =
            |path: &Path, file: Vec<u8>| Self::from_file(path, file, scenario, converter);
        let mission = &scenario.mission;
        let policy = match choice {
            PolicyChoice::Shipped => {
                let reads_onnx = cfg!(feature = "onnx") || converter.is_some();
                if let Some((name, file)) = shipped(scenario).filter(|_| reads_onnx) {
                    let policy = from_file(Path::new(name), file.to_vec())?;
                    return Ok((policy, name.into()));
                }
                return Self::load_with(&PolicyChoice::Plan, scenario, converter, progress);
            }
            PolicyChoice::Any => {
                let (name, file) = FOR_ANY_MISSION;
                from_file(Path::new(name), file.to_vec())?
            }
            PolicyChoice::StraightLine => Self::StraightLine(StraightLine::new(mission)),
            PolicyChoice::Fixed => Self::Fixed(FixedPosition::central(mission)),
            PolicyChoice::Search => {
                let plan = bound::search(mission, |step| progress(LoadProgress::Search(step)))
                    .map_err(|error| error.to_string())?;
                Self::Search(SearchPolicy::new(plan))
            }
            PolicyChoice::Plan => {
                let mut planner =
                    planner::new_planner(mission).map_err(|error| error.to_string())?;
                planner::finish(&mut planner, |step| progress(LoadProgress::Plan(step)));
                Self::Plan(Box::new(planner))
            }
            PolicyChoice::PlanOnce(time) => {
                let time = time.unwrap_or(Duration::MAX);
                let report = |step: &PlanProgress| progress(LoadProgress::Plan(step));
                let plan = planner::plan_within(mission, time, report);
                let plan = plan.map_err(|error| error.to_string())?;
                Self::Search(SearchPolicy::new(plan.into()))
            }
            PolicyChoice::Trained(folder) => {
                let (path, file) = trained_for(folder, scenario)?;
                let policy = from_file(&path, file)?;
                return Ok((policy, PolicyChoice::File(path).to_string()));
            }
            PolicyChoice::File(path) => {
                let file = input::read(path).map_err(|error| named(path, error))?;
                from_file(path, file)?
            }
            PolicyChoice::Waypoints(path) => {
                let file = input::read(path).map_err(|error| named(path, error))?;
                let plan = waypoint_file::read(path, &file, scenario);
                Self::Search(SearchPolicy::new(plan.map_err(|error| named(path, error))?))
            }
        };
        Ok((policy, choice.to_string()))
    }

    /// Returns a warning if the policy was trained for another mission, or `None` if it was trained for
    /// this one or is not a trained policy.
    pub fn foreign_mission(&self, scenario: &Scenario) -> Option<String> {
        scenario.foreign_policy(&self.provenance()?.scenario_digest)
    }

    fn from_file(
        path: &Path,
        file: Vec<u8>,
        scenario: &Scenario,
        converter: Option<OnnxConverter>,
    ) -> Result<Self, String> {
        let is_onnx = path.extension().is_some_and(|kind| kind == "onnx");
        let policy = match (is_onnx, converter) {
            (true, None) => Self::read_onnx(&file, scenario),
            (true, Some(convert)) => {
                convert(&file).and_then(|file| Self::read_policy(file, scenario))
            }
            (false, _) => Self::read_policy(file, scenario),
        };
        let policy = policy.map_err(|error| named(path, error))?;
        if let Some(provenance) = policy.provenance() {
            let fits = provenance.check(&scenario.mission);
            fits.map_err(|mismatch| named(path, mismatch))?;
        }
        Ok(policy)
    }

    fn read_policy(file: Vec<u8>, scenario: &Scenario) -> Result<Self, String> {
        match format_version(&file).map_err(|error| error.to_string())? {
            mlp::FORMAT_VERSION | mlp::FORMAT_VERSION_FUNCTIONS => {
                let policy = Mlp::load(file).map_err(|error| error.to_string())?;
                Ok(Self::Mlp(Box::new(policy)))
            }
            sets::FORMAT_VERSION => {
                let mut work = Box::<SetsWork>::default();
                let network =
                    SetsNetwork::load(file, &mut work).map_err(|error| error.to_string())?;
                let network = AnyMissionNetwork::File(NetworkWithWork { network, work });
                Self::for_any_mission(network, scenario)
            }
            other => Err(format!(
                "format version is {other}, but this build reads {}, {} and {}",
                mlp::FORMAT_VERSION,
                sets::FORMAT_VERSION,
                mlp::FORMAT_VERSION_FUNCTIONS
            )),
        }
    }

    fn for_any_mission(network: AnyMissionNetwork, scenario: &Scenario) -> Result<Self, String> {
        let policy = SetsPolicy::new(network, &scenario.mission);
        let policy = policy.map_err(|mismatch| mismatch.to_string())?;
        Ok(Self::AnyMission(Box::new(policy)))
    }

    #[cfg(feature = "onnx")]
    fn read_onnx(file: &[u8], scenario: &Scenario) -> Result<Self, String> {
        match OnnxNetwork::load(file).map_err(|error| error.to_string())? {
            OnnxNetwork::OneMission(policy) => Ok(Self::Onnx(Box::new(policy))),
            OnnxNetwork::AnyMission(network) => {
                Self::for_any_mission(AnyMissionNetwork::Onnx(network), scenario)
            }
        }
    }

    #[cfg(not(feature = "onnx"))]
    fn read_onnx(_: &[u8], _: &Scenario) -> Result<Self, String> {
        Err(
            "this build does not support .onnx files (feature onnx); `trainer convert F.onnx \
             F.policy` converts the file to a format that it supports"
                .into(),
        )
    }

    /// Returns the origin of a policy that was trained for one mission: the mission and the settings
    /// of the training.
    pub fn provenance(&self) -> Option<&Provenance> {
        match self {
            Self::StraightLine(_) | Self::Fixed(_) | Self::Search(_) | Self::Plan(_) => None,
            Self::AnyMission(_) => None,
            Self::Mlp(policy) => Some(policy.provenance()),
            #[cfg(feature = "onnx")]
            Self::Onnx(policy) => Some(policy.provenance()),
        }
    }
}

impl HostPolicy {
    fn chosen(&self) -> &dyn Policy<f64, USERS_MAX> {
        match self {
            Self::StraightLine(policy) => policy,
            Self::Fixed(policy) => policy,
            Self::Search(policy) => policy,
            Self::Plan(planner) => &**planner,
            Self::Mlp(policy) => &**policy,
            Self::AnyMission(policy) => &**policy,
            #[cfg(feature = "onnx")]
            Self::Onnx(policy) => &**policy,
        }
    }

    fn chosen_mut(&mut self) -> &mut dyn Policy<f64, USERS_MAX> {
        match self {
            Self::StraightLine(policy) => policy,
            Self::Fixed(policy) => policy,
            Self::Search(policy) => policy,
            Self::Plan(planner) => &mut **planner,
            Self::Mlp(policy) => &mut **policy,
            Self::AnyMission(policy) => &mut **policy,
            #[cfg(feature = "onnx")]
            Self::Onnx(policy) => &mut **policy,
        }
    }
}

impl Policy<f64, USERS_MAX> for HostPolicy {
    fn decide(&mut self, observation: &Observation<'_, f64>) -> Action<f64, USERS_MAX> {
        self.chosen_mut().decide(observation)
    }

    fn revise(&mut self, change: &MissionChange<f64>, slots_begun: u32) {
        self.chosen_mut().revise(change, slots_begun);
    }

    fn note_gains(&mut self, measured: &MeasuredGains<'_, f64>) {
        self.chosen_mut().note_gains(measured);
    }

    fn improve(&mut self, operations: u64) {
        self.chosen_mut().improve(operations);
    }

    fn quality(&self) -> Option<PlanQuality> {
        self.chosen().quality()
    }
}

#[cfg(all(test, feature = "onnx"))]
mod tests {
    use super::*;

    fn shipped(name: &str) -> PolicyChoice {
        let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
        PolicyChoice::File(models.join(name))
    }

    #[test]
    fn the_policy_that_was_trained_for_the_mission_is_taken() {
        let scenario = Scenario::shipped("mixed").expect("shipped");
        for (threshold, expected) in [
            (0.015, "mixed-sac.onnx"),
            (0.02, "mixed-t60-n95-g0.020-sac-paper-s1.onnx"),
            (0.0123, "plan"),
        ] {
            let scenario = scenario
                .clone()
                .with_mse_threshold(threshold)
                .expect("valid");
            let (policy, name) = HostPolicy::load(&PolicyChoice::Shipped, &scenario).expect("one");
            assert_eq!(name, expected);
            assert_eq!(policy.foreign_mission(&scenario), None);
        }
    }

    #[test]
    fn shipped_policies_load_for_their_scenarios_and_for_no_slower_vehicle() {
        for name in ["separated", "mixed"] {
            let scenario = Scenario::shipped(name).expect("shipped");
            for algorithm in ["sac", "ddpg"] {
                let choice = shipped(&format!("{name}-{algorithm}.onnx"));
                let policy = HostPolicy::load(&choice, &scenario).expect("sound").0;
                let provenance = policy.provenance().expect("trained");
                assert_eq!(provenance.scenario, name);
                assert_eq!(provenance.scenario_digest, scenario.digest().as_str());
            }
        }
        let text = Scenario::shipped("separated").expect("shipped").to_toml();
        let slow = text.replace("max_speed_mps = 30.0", "max_speed_mps = 25.0");
        let slow = Scenario::parse("slow", &slow).expect("valid");
        let error = HostPolicy::load(&shipped("separated-sac.onnx"), &slow).expect_err("misfit");
        let expected = "the policy is for max_speed_mps = 30, but the mission has 25";
        assert!(error.ends_with(expected), "{error}");
    }
}
