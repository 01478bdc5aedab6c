//! A scenario: a valid mission, where it is on Earth, and what its sensors measure.

use std::path::Path;

use firmware_core::{Mission, autopilot::frames::Geodetic};

use crate::{
    Events, HostMission, Sensing, Tracks, Uncertainty,
    digest::sha256,
    file::{self, ScenarioError},
    gain_map::{self, LoadedMap},
    mission_file::{Origin, ScenarioFile},
    tracks::{self, Waymark},
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
    /// How the world differs from what is known of it.
    pub uncertainty: Uncertainty,
    /// The content of the file. It is kept so that radio noise in dBm survives a round trip.
    pub(crate) file: ScenarioFile,
    /// The gains of the mission, if the file names a map.
    gain_map: Option<LoadedMap>,
    /// The motion from a file, if the file names one.
    motion: Vec<Waymark>,
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
        let folder = path.parent().unwrap_or(Path::new("."));
        let mut scenario = Self::parse_in(&name, &text, folder).map_err(fail)?;
        scenario
            .sensing
            .load_measurements(folder, &scenario.mission)
            .map_err(fail)?;
        let csv = scenario.uncertainty.motion.as_ref();
        if let Some(csv) = csv.and_then(|motion| motion.csv.as_ref()) {
            scenario.motion = tracks::load(&folder.join(csv), &scenario.mission).map_err(fail)?;
        }
        Ok(scenario)
    }

    /// As [`parse`](Self::parse), for a text that may name a map of gains, which is read. Its path
    /// is relative to `folder`.
    ///
    /// # Errors
    /// Returns one line that states what is wrong.
    pub fn parse_in(name: &str, text: &str, folder: &Path) -> Result<Self, String> {
        let mut file: ScenarioFile = file::parse(text)?;
        let map = file.radio.gain_map.take();
        let mut scenario = Self::from_file(name, file)?;
        if let Some(map) = map {
            scenario.set_gain_map(gain_map::load(&folder.join(map), &scenario.mission)?);
        }
        Ok(scenario)
    }

    /// Takes the gains of the mission from a map.
    fn set_gain_map(&mut self, loaded: LoadedMap) {
        self.mission = self.mission.clone().with_gain_map(loaded.map);
        self.file.radio.gain_map = Some(loaded.path.clone());
        self.gain_map = Some(loaded);
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

    /// Parses and checks the text of a scenario. A measurement file that it names is not opened, and
    /// a map of gains is refused, because without it the mission would be another one.
    ///
    /// # Errors
    /// Returns one line that states what is wrong.
    pub fn parse(name: &str, text: &str) -> Result<Self, String> {
        let file: ScenarioFile = file::parse(text)?;
        if let Some(map) = &file.radio.gain_map {
            return Err(format!(
                "radio.gain_map is {}, but there is no file to find it from",
                map.display()
            ));
        }
        Self::from_file(name, file)
    }

    /// Returns the scenario with another content of its file, and with its map of gains.
    pub(crate) fn with_file(&self, file: ScenarioFile) -> Result<Self, String> {
        let mut scenario = Self::from_file(&self.name, file)?;
        if let Some(loaded) = &self.gain_map {
            scenario.set_gain_map(loaded.clone());
        }
        scenario.motion.clone_from(&self.motion);
        Ok(scenario)
    }

    /// Checks the content of a file.
    /// The map of gains that it may name is not read.
    pub(crate) fn from_file(name: &str, file: ScenarioFile) -> Result<Self, String> {
        let mission = Mission::new(file.parameters()?).map_err(|error| error.to_string())?;
        file.origin.check()?;
        file.sensing.check(mission.sensor_count())?;
        if file.sensing.measurements_csv.is_none() {
            file.sensing.check_measurements(&mission)?;
        }
        file.uncertainty.check(&mission)?;
        Ok(Self {
            name: name.into(),
            mission,
            origin: file.origin,
            sensing: file.sensing.clone(),
            uncertainty: file.uncertainty.clone(),
            file,
            gain_map: None,
            motion: Vec::new(),
        })
    }

    /// Returns where users and sensors truly are.
    pub fn tracks(&self) -> Tracks {
        Tracks::draw(&self.uncertainty, &self.mission, &self.motion)
    }

    /// Returns the scenario in a world that differs from what is known of it by this.
    ///
    /// # Errors
    /// Returns one line that names the key, its value and what is allowed.
    pub fn with_uncertainty(mut self, uncertainty: Uncertainty) -> Result<Self, String> {
        uncertainty.check(&self.mission)?;
        self.file.uncertainty = uncertainty.clone();
        self.uncertainty = uncertainty;
        Ok(self)
    }

    /// Returns what changes in flight: these events, and the motion that the vehicle is told of.
    ///
    /// # Errors
    /// Returns one line that names an event and a node that moves by itself.
    pub fn with_motion(&self, events: &Events) -> Result<Events, String> {
        events.with_motion(&self.mission, &self.tracks())
    }

    /// Returns the scenario as the text of a file, with one position per line.
    pub fn to_toml(&self) -> String {
        self.file.to_toml()
    }

    /// Returns the SHA-256 (hexadecimal) of the mission. It identifies the mission that a policy
    /// was trained for and does not depend on the file's layout, comments, origin, measurements
    /// and uncertainty, nor on the place of a map of gains, but on its content.
    pub fn digest(&self) -> String {
        let mut file = self.file.clone();
        file.origin = Origin::default();
        file.sensing = Sensing::default();
        file.uncertainty = Uncertainty::default();
        file.radio.gain_map = self.gain_map.as_ref().map(|map| map.digest.clone().into());
        sha256(file.to_toml().as_bytes())
    }
}
