//! The policies that a person can name on a command line.

use std::{
    fmt, fs,
    path::{Path, PathBuf},
    str::FromStr,
};

#[cfg(feature = "onnx")]
use firmware_core::policy::onnx::OnnxPolicy;
use firmware_core::{
    USERS_MAX,
    policy::{Action, FixedPosition, Observation, Policy, Provenance, StraightLine, mlp::Mlp},
};

use crate::{bound, scenario::Scenario, search::SearchPolicy};

/// Who decides, as named.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PolicyChoice {
    /// Straight to the destination, nearest user.
    StraightLine,
    /// Hover over the middle of all nodes, nearest user.
    Fixed,
    /// The near-optimal mission that `host-sim bound` finds, decided before take-off.
    Search,
    /// A trained policy.
    File(PathBuf),
}

impl FromStr for PolicyChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "straight-line" => Ok(Self::StraightLine),
            "fixed" => Ok(Self::Fixed),
            "search" => Ok(Self::Search),
            _ => {
                let path = PathBuf::from(text);
                match path.extension().and_then(|extension| extension.to_str()) {
                    Some("onnx" | "policy") => Ok(Self::File(path)),
                    _ => Err(
                        "must be straight-line, fixed, search, or a file that ends in .onnx or .policy"
                            .into(),
                    ),
                }
            }
        }
    }
}

impl fmt::Display for PolicyChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::StraightLine => f.write_str("straight-line"),
            Self::Fixed => f.write_str("fixed"),
            Self::Search => f.write_str("search"),
            // Where a file lies is no part of what it decides.
            Self::File(path) => match path.file_name() {
                Some(name) => name.to_string_lossy().fmt(f),
                None => path.display().fmt(f),
            },
        }
    }
}

/// A policy of any kind, ready to decide.
#[derive(Debug)]
pub enum HostPolicy {
    /// Straight to the destination, nearest user.
    StraightLine(StraightLine<f64, USERS_MAX>),
    /// Hover over one place, nearest user.
    Fixed(FixedPosition<f64, USERS_MAX>),
    /// A mission decided in advance.
    Search(SearchPolicy),
    /// A `.policy` file, run as the microcontroller runs it.
    Mlp(Box<Mlp<Vec<u8>>>),
    /// An `.onnx` file, run by tract.
    #[cfg(feature = "onnx")]
    Onnx(Box<OnnxPolicy>),
}

impl HostPolicy {
    /// The policy of this name for a mission.
    ///
    /// # Errors
    /// A file that cannot be read, is no policy, or does not fit the mission: in one line.
    pub fn load(choice: &PolicyChoice, scenario: &Scenario) -> Result<Self, String> {
        let mission = &scenario.mission;
        match choice {
            PolicyChoice::StraightLine => Ok(Self::StraightLine(StraightLine::new(mission))),
            PolicyChoice::Fixed => Ok(Self::Fixed(FixedPosition::central(mission))),
            PolicyChoice::Search => bound::search(mission)
                .map(|plan| Self::Search(SearchPolicy::new(plan)))
                .map_err(|error| error.to_string()),
            PolicyChoice::File(path) => {
                let named = |error: String| format!("{}: {error}", path.display());
                let policy = Self::read(path).map_err(named)?;
                if let Some(provenance) = policy.provenance() {
                    let fits = provenance.check(mission);
                    fits.map_err(|misfit| named(misfit.to_string()))?;
                }
                Ok(policy)
            }
        }
    }

    fn read(path: &Path) -> Result<Self, String> {
        let file = fs::read(path).map_err(|error| error.to_string())?;
        if path
            .extension()
            .is_some_and(|extension| extension == "onnx")
        {
            return Self::read_onnx(&file);
        }
        let policy = Mlp::load(file).map_err(|error| error.to_string())?;
        Ok(Self::Mlp(Box::new(policy)))
    }

    #[cfg(feature = "onnx")]
    fn read_onnx(file: &[u8]) -> Result<Self, String> {
        let policy = OnnxPolicy::load(file).map_err(|error| error.to_string())?;
        Ok(Self::Onnx(Box::new(policy)))
    }

    #[cfg(not(feature = "onnx"))]
    fn read_onnx(_: &[u8]) -> Result<Self, String> {
        Err(
            "this build cannot run .onnx files (feature onnx): `trainer convert F.onnx F.policy` \
             makes a file that it can"
                .into(),
        )
    }

    /// What a trained policy was trained for.
    fn provenance(&self) -> Option<&Provenance> {
        match self {
            Self::StraightLine(_) | Self::Fixed(_) | Self::Search(_) => None,
            Self::Mlp(policy) => Some(policy.provenance()),
            #[cfg(feature = "onnx")]
            Self::Onnx(policy) => Some(policy.provenance()),
        }
    }
}

impl Policy<f64, USERS_MAX> for HostPolicy {
    fn decide(&mut self, observation: &Observation<'_, f64>) -> Action<f64, USERS_MAX> {
        match self {
            Self::StraightLine(policy) => policy.decide(observation),
            Self::Fixed(policy) => policy.decide(observation),
            Self::Search(policy) => policy.decide(observation),
            Self::Mlp(policy) => policy.decide(observation),
            #[cfg(feature = "onnx")]
            Self::Onnx(policy) => policy.decide(observation),
        }
    }
}

#[cfg(all(test, feature = "onnx"))]
mod tests {
    use super::*;

    fn shipped(name: &str) -> PolicyChoice {
        let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
        PolicyChoice::File(models.join(name))
    }

    #[test]
    fn shipped_policies_load_for_their_scenarios_and_for_no_slower_vehicle() {
        for name in ["separated", "mixed"] {
            let scenario = Scenario::shipped(name).expect("shipped");
            for algorithm in ["sac", "ddpg"] {
                let choice = shipped(&format!("{name}-{algorithm}.onnx"));
                let policy = HostPolicy::load(&choice, &scenario).expect("sound");
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
