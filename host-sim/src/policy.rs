//! The policies that a person can name on a command line.

use std::{fmt, path::PathBuf, str::FromStr};

use firmware_core::{
    USERS_MAX,
    policy::{Action, FixedPosition, Observation, Policy, StraightLine},
};

use crate::scenario::Scenario;

/// Who decides, as named.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PolicyChoice {
    /// Straight to the destination, nearest user.
    StraightLine,
    /// Hover over the middle of all nodes, nearest user.
    Fixed,
    /// A trained policy.
    File(PathBuf),
}

impl FromStr for PolicyChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "straight-line" => Ok(Self::StraightLine),
            "fixed" => Ok(Self::Fixed),
            _ => {
                let path = PathBuf::from(text);
                match path.extension().and_then(|extension| extension.to_str()) {
                    Some("onnx" | "policy") => Ok(Self::File(path)),
                    _ => Err(
                        "must be straight-line, fixed, or a file that ends in .onnx or .policy"
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
            PolicyChoice::File(path) => Err(format!("{}: not a policy", path.display())),
        }
    }
}

impl Policy<f64, USERS_MAX> for HostPolicy {
    fn decide(&mut self, observation: &Observation<'_, f64>) -> Action<f64, USERS_MAX> {
        match self {
            Self::StraightLine(policy) => policy.decide(observation),
            Self::Fixed(policy) => policy.decide(observation),
        }
    }
}
