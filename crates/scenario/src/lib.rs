//! Missions as TOML files: reading, checking, writing and generating them.
//!
//! Units are part of the names of the keys, and unknown keys are errors. Every error is one line
//! that names the file, the field, the value and what is allowed. The ranges are defined in
//! [`firmware_core::mission`], the only place that rejects a mission.

#![deny(missing_docs)]

mod choice;
mod events;
mod random;
mod random_events;
mod rates;
mod sensing;
mod topology;

use std::{
    fmt,
    path::{Path, PathBuf},
};

use files::input;
use firmware_core::{
    Mission, Position, SENSORS_MAX, USERS_MAX, Watt,
    autopilot::frames::Geodetic,
    mission::{Area, Environment, ExcessLoss, MissionParameters},
    policy::Provenance,
};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

pub use choice::{Changes, ScenarioChoice};
pub use events::{Events, Timeline};
pub use random::{Layout, random};
pub use random_events::EventKind;
pub use rates::{ABSENT_RATE, PlaceRates, with_field};
pub use sensing::{Function, Sensing, TemperatureField};
pub use topology::{Course, Topology, generate, generate_on};

/// A mission as the host flies it: in double precision and at the default capacities.
pub type HostMission = Mission<f64, USERS_MAX, SENSORS_MAX>;

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
    file: ScenarioFile,
}

/// The location on Earth of the map's origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Latitude, degrees north, from -89 to 89.
    pub latitude_deg: f64,
    /// Longitude, degrees east, from -180 to 180.
    pub longitude_deg: f64,
    /// Elevation of the ground above mean sea level, metres.
    pub elevation_m: f64,
}

impl Default for Origin {
    /// Returns the field near Canberra where ArduPilot's simulator starts.
    fn default() -> Self {
        Self {
            latitude_deg: -35.363_262,
            longitude_deg: 149.165_237,
            elevation_m: 584.0,
        }
    }
}

/// Error returned when a scenario cannot be used: the file, and the reason in one line.
#[derive(Debug)]
pub struct ScenarioError {
    path: PathBuf,
    problem: String,
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.problem)
    }
}

impl std::error::Error for ScenarioError {}

/// The content of a scenario file, key by key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ScenarioFile {
    mission: MissionTable,
    radio: RadioTable,
    aircomp: AircompTable,
    users: UsersTable,
    sensors: SensorsTable,
    #[serde(default)]
    origin: Origin,
    #[serde(default)]
    sensing: Sensing,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MissionTable {
    slots: u32,
    slot_duration_s: f64,
    start_m: [f64; 2],
    destination_m: [f64; 2],
    area_m: [f64; 2],
    altitude_m: f64,
    max_speed_mps: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RadioTable {
    carrier_hz: f64,
    noise_dbm: f64,
    environment: Environment<f64>,
    excess_loss_db: ExcessLoss<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AircompTable {
    mse_threshold: f64,
    sensor_power_max_w: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct UsersTable {
    power_max_w: f64,
    positions_m: Vec<[f64; 2]>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorsTable {
    positions_m: Vec<[f64; 2]>,
}

impl Scenario {
    /// Returns a warning if a policy was trained for another mission, or `None` if it was trained
    /// for this one.
    pub fn foreign_policy(&self, provenance: &Provenance) -> Option<String> {
        let (trained_for, digest) = (provenance.scenario_digest.as_str(), self.digest());
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
        let fail = |problem: String| ScenarioError {
            path: path.to_owned(),
            problem,
        };
        let text = input::read_text(path).map_err(|error| fail(error.to_string()))?;
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
        let table = toml::Deserializer::parse(text).map_err(|error| one_line(text, &error))?;
        let file: ScenarioFile = serde_path_to_error::deserialize(table).map_err(|error| {
            let path = error.path().to_string();
            let problem = one_line(text, error.inner());
            if path == "." {
                problem
            } else {
                format!("{path}: {problem}")
            }
        })?;
        Self::from_file(name, file)
    }

    fn from_file(name: &str, file: ScenarioFile) -> Result<Self, String> {
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

impl ScenarioFile {
    fn parameters(&self) -> Result<MissionParameters<f64, USERS_MAX, SENSORS_MAX>, String> {
        let ScenarioFile { mission, radio, .. } = self;
        let place = |&[east, north]: &[f64; 2]| Position::new(east, north);
        Ok(MissionParameters {
            slots: mission.slots,
            slot_duration_s: mission.slot_duration_s,
            start: place(&mission.start_m),
            destination: place(&mission.destination_m),
            area: Area {
                east_m: mission.area_m[0],
                north_m: mission.area_m[1],
            },
            altitude_m: mission.altitude_m,
            max_speed_mps: mission.max_speed_mps,
            carrier_hz: radio.carrier_hz,
            environment: radio.environment,
            excess_loss_db: radio.excess_loss_db,
            noise_power: noise_power(radio.noise_dbm)?,
            mse_threshold: self.aircomp.mse_threshold,
            user_power_max: Watt(self.users.power_max_w),
            sensor_power_max: Watt(self.aircomp.sensor_power_max_w),
            users: places("users.positions_m", &self.users.positions_m)?,
            sensors: places("sensors.positions_m", &self.sensors.positions_m)?,
        })
    }

    /// Returns the text of the file. It is formatted by this function, with small tables on one
    /// line and one position per line, so that files are easy to read and their differences are
    /// small.
    fn to_toml(&self) -> String {
        let ScenarioFile {
            mission,
            radio,
            aircomp,
            users,
            sensors,
            origin,
            sensing,
        } = self;
        let positions = |places: &[[f64; 2]]| -> String {
            let rows = places.iter().map(|place| format!("    {place:?},\n"));
            rows.collect()
        };
        format!(
            "[mission]\nslots = {}\nslot_duration_s = {:?}\nstart_m = {:?}\ndestination_m = {:?}\n\
             area_m = {:?}\naltitude_m = {:?}\nmax_speed_mps = {:?}\n\n\
             [radio]\ncarrier_hz = {:?}\nnoise_dbm = {:?}\nenvironment = {{ a = {:?}, b = {:?} }}\n\
             excess_loss_db = {{ los = {:?}, nlos = {:?} }}\n\n\
             [aircomp]\nmse_threshold = {:?}\nsensor_power_max_w = {:?}\n\n\
             [users]\npower_max_w = {:?}\npositions_m = [\n{}]\n\n\
             [sensors]\npositions_m = [\n{}]\n\n\
             [origin]\nlatitude_deg = {:?}\nlongitude_deg = {:?}\nelevation_m = {:?}\n\n\
             [sensing]\n{}",
            mission.slots,
            mission.slot_duration_s,
            mission.start_m,
            mission.destination_m,
            mission.area_m,
            mission.altitude_m,
            mission.max_speed_mps,
            radio.carrier_hz,
            radio.noise_dbm,
            radio.environment.a,
            radio.environment.b,
            radio.excess_loss_db.los,
            radio.excess_loss_db.nlos,
            aircomp.mse_threshold,
            aircomp.sensor_power_max_w,
            users.power_max_w,
            positions(&users.positions_m),
            positions(&sensors.positions_m),
            origin.latitude_deg,
            origin.longitude_deg,
            origin.elevation_m,
            sensing.to_toml(),
        )
    }
}

/// Converts noise to watts. The range is checked here because the file contains dBm.
fn noise_power(noise_dbm: f64) -> Result<Watt<f64>, String> {
    if !(-200.0..=100.0).contains(&noise_dbm) {
        return Err(format!(
            "radio.noise_dbm is {noise_dbm}, but must be from -200 to 100 dBm"
        ));
    }
    Ok(Watt::from_dbm(noise_dbm))
}

fn places<const N: usize>(
    field: &str,
    positions_m: &[[f64; 2]],
) -> Result<heapless::Vec<Position<f64>, N>, String> {
    if positions_m.len() > N {
        return Err(format!(
            "{field} has {} entries, but the controller holds at most {N}",
            positions_m.len()
        ));
    }
    Ok(positions_m
        .iter()
        .map(|&[east, north]| Position::new(east, north))
        .collect())
}

impl Origin {
    fn check(&self) -> Result<(), String> {
        let check = |field: &str, value: f64, limit: f64| {
            if value.abs() <= limit {
                return Ok(());
            }
            Err(format!(
                "origin.{field} is {value}, but must be from -{limit} to {limit}"
            ))
        };
        check("latitude_deg", self.latitude_deg, 89.0)?;
        check("longitude_deg", self.longitude_deg, 180.0)?;
        check("elevation_m", self.elevation_m, 9000.0)
    }
}

/// Formats a TOML error as one line: what is wrong, and on which line of the file.
fn one_line(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().replace('\n', "; ");
    match error.span() {
        Some(span) => {
            let line = 1 + text[..span.start.min(text.len())].matches('\n').count();
            let shown = text[span.start.min(text.len())..span.end.min(text.len())].trim();
            if shown.is_empty() || shown.contains('\n') || shown.len() > 60 {
                format!("{message} (line {line})")
            } else {
                format!("{message} (line {line}: `{shown}`)")
            }
        }
        None => message,
    }
}

#[cfg(test)]
mod tests;
