//! A scenario: a valid mission, where it is on Earth, and what its sensors measure.

use std::path::Path;

use firmware_core::{Mission, autopilot::frames::Geodetic};
use sha2::{Digest, Sha256};

use crate::{
    HostMission, Sensing,
    file::{self, ScenarioError},
    mission_file::{Origin, ScenarioFile},
};

/// A scenario: a valid mission, its location on Earth, and what its sensors measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// The stem of the file's name, or a description of how the scenario was generated.
    pub name: String,
    /// The mission.
    pub mission: HostMission,
    /// The location on Earth of the map's `[0, 0]`.
    pub origin: Origin,
    /// What the sensors measure, and which function of it the vehicle estimates.
    pub sensing: Sensing,
    /// The content of the file. It is kept so that radio noise in dBm survives a round trip.
    pub(crate) file: ScenarioFile,
}

impl Scenario {
    /// Returns a warning if a policy was trained for another mission, or `None` if it was trained
    /// for this one. `trained_for` is the `scenario_digest` of its file.
    pub fn foreign_policy(&self, trained_for: &str) -> Option<String> {
        let digest = self.digest();
        (trained_for != digest).then(|| {
            let trained_for = match trained_for {
                "" => "it names no mission".to_owned(),
                named => format!("digest {named:.12}"),
            };
            format!(
                "trained for another mission ({trained_for}, this one has {digest:.12}): --policy plan \
                 may do better"
            )
        })
    }

    /// Returns the location on Earth of the map's `[0, 0]` in the units of MAVLink.
    pub fn map_origin(&self) -> Geodetic {
        // The origin of a scenario has been checked to be a valid location.
        Geodetic::from_degrees(self.origin.latitude_deg, self.origin.longitude_deg)
            .unwrap_or_default()
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, is not valid TOML, has unknown, missing or
    /// wrongly typed keys, or does not describe a valid mission.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let fail = |problem| ScenarioError::new(path, problem);
        let text = file::read(path)?;
        let name = path.file_stem().map_or_else(
            || "scenario".into(),
            |stem| stem.to_string_lossy().into_owned(),
        );
        let mut scenario = Self::parse(&name, &text).map_err(fail)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        scenario
            .sensing
            .load_measurements(folder, &scenario.mission)
            .map_err(fail)?;
        Ok(scenario)
    }

    /// Returns the built-in scenario of this name: `separated` (the default) or `mixed`.
    pub fn shipped(name: &str) -> Option<Self> {
        let text = match name {
            "separated" => include_str!("../../../scenarios/separated.toml"),
            "mixed" => include_str!("../../../scenarios/mixed.toml"),
            "slow" => include_str!("../../../scenarios/slow.toml"),
            _ => return None,
        };
        Self::parse(name, text).ok()
    }

    /// Parses and checks the text of a scenario. A measurement file that it names is not opened.
    ///
    /// # Errors
    /// Returns one line that states what is wrong.
    pub fn parse(name: &str, text: &str) -> Result<Self, String> {
        let file = file::parse(text)?;
        Self::from_file(name, file)
    }

    /// Checks the content of a file.
    pub(crate) fn from_file(name: &str, file: ScenarioFile) -> Result<Self, String> {
        let mission = Mission::new(file.parameters()?).map_err(|error| error.to_string())?;
        file.origin.check()?;
        file.sensing.check(mission.sensor_count())?;
        if file.sensing.measurements_csv.is_none() {
            file.sensing.check_measurements(&mission)?;
        }
        Ok(Self {
            name: name.into(),
            mission,
            origin: file.origin,
            sensing: file.sensing.clone(),
            file,
        })
    }

    /// Returns the scenario as the text of a file, with one position per line.
    pub fn to_toml(&self) -> String {
        self.file.to_toml()
    }

    /// Returns the SHA-256 (hexadecimal) of the mission. It identifies the mission that a policy
    /// was trained for and does not depend on the file's layout, comments, origin and measurements.
    pub fn digest(&self) -> String {
        let mut file = self.file.clone();
        file.origin = Origin::default();
        file.sensing = Sensing::default();
        Sha256::digest(file.to_toml())
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect()
    }
}
