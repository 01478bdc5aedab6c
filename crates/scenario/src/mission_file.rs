//! The keys of a scenario file, what they mean for the mission, and how they are written.

use std::path::PathBuf;

use firmware_core::{
    Position, SENSORS_MAX, USERS_MAX, Watt,
    mission::{Area, Environment, ExcessLoss, MissionParameters, RadioModel},
};
use serde::{Deserialize, Serialize};

use crate::{
    Sensing, Uncertainty,
    file::{optional_table, pair, pairs, table},
};

/// The content of a scenario file, key by key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ScenarioFile {
    #[serde(deserialize_with = "table")]
    pub(crate) mission: MissionTable,
    #[serde(deserialize_with = "table")]
    pub(crate) radio: RadioTable,
    #[serde(deserialize_with = "table")]
    pub(crate) aircomp: AircompTable,
    #[serde(deserialize_with = "table")]
    pub(crate) users: UsersTable,
    #[serde(deserialize_with = "table")]
    pub(crate) sensors: SensorsTable,
    #[serde(default, deserialize_with = "table")]
    pub(crate) origin: Origin,
    #[serde(default, deserialize_with = "table")]
    pub(crate) sensing: Sensing,
    #[serde(default, deserialize_with = "table")]
    pub(crate) uncertainty: Uncertainty,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MissionTable {
    pub(crate) slots: u32,
    pub(crate) slot_duration_s: f64,
    #[serde(deserialize_with = "pair")]
    pub(crate) start_m: [f64; 2],
    #[serde(deserialize_with = "pair")]
    pub(crate) destination_m: [f64; 2],
    #[serde(deserialize_with = "pair")]
    pub(crate) area_m: [f64; 2],
    pub(crate) altitude_m: f64,
    pub(crate) max_speed_mps: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RadioTable {
    pub(crate) carrier_hz: f64,
    pub(crate) noise_dbm: f64,
    #[serde(default)]
    pub(crate) model: RadioModel,
    /// For the paper's model, which needs it.
    #[serde(default, deserialize_with = "optional_table")]
    pub(crate) environment: Option<Environment<f64>>,
    /// For the paper's model, which needs it.
    #[serde(default, deserialize_with = "optional_table")]
    pub(crate) excess_loss_db: Option<ExcessLoss<f64>>,
    /// A file with the gains of the mission. Its path is relative to the scenario file.
    #[serde(default)]
    pub(crate) gain_map: Option<PathBuf>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct AircompTable {
    pub(crate) mse_threshold: f64,
    pub(crate) sensor_power_max_w: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct UsersTable {
    pub(crate) power_max_w: f64,
    #[serde(deserialize_with = "pairs")]
    pub(crate) positions_m: Vec<[f64; 2]>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SensorsTable {
    #[serde(deserialize_with = "pairs")]
    pub(crate) positions_m: Vec<[f64; 2]>,
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

impl ScenarioFile {
    /// Returns the parameters of the mission, whose ranges [`Mission`] checks.
    pub(crate) fn parameters(
        &self,
    ) -> Result<MissionParameters<f64, USERS_MAX, SENSORS_MAX>, String> {
        let ScenarioFile { mission, radio, .. } = self;
        let place = |&[east, north]: &[f64; 2]| Position::new(east, north);
        let (environment, excess_loss_db) = radio.line_of_sight()?;
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
            radio_model: radio.model,
            environment,
            excess_loss_db,
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
    pub(crate) fn to_toml(&self) -> String {
        let ScenarioFile {
            mission,
            radio,
            aircomp,
            users,
            sensors,
            origin,
            sensing,
            uncertainty,
        } = self;
        let positions = |places: &[[f64; 2]]| -> String {
            let rows = places.iter().map(|place| format!("    {place:?},\n"));
            rows.collect()
        };
        format!(
            "[mission]\nslots = {}\nslot_duration_s = {:?}\nstart_m = {:?}\ndestination_m = {:?}\n\
             area_m = {:?}\naltitude_m = {:?}\nmax_speed_mps = {:?}\n\n\
             [radio]\ncarrier_hz = {:?}\nnoise_dbm = {:?}\n{}\n\
             [aircomp]\nmse_threshold = {:?}\nsensor_power_max_w = {:?}\n\n\
             [users]\npower_max_w = {:?}\npositions_m = [\n{}]\n\n\
             [sensors]\npositions_m = [\n{}]\n\n\
             [origin]\nlatitude_deg = {:?}\nlongitude_deg = {:?}\nelevation_m = {:?}\n\n\
             [sensing]\n{}{}",
            mission.slots,
            mission.slot_duration_s,
            mission.start_m,
            mission.destination_m,
            mission.area_m,
            mission.altitude_m,
            mission.max_speed_mps,
            radio.carrier_hz,
            radio.noise_dbm,
            radio.model_lines(),
            aircomp.mse_threshold,
            aircomp.sensor_power_max_w,
            users.power_max_w,
            positions(&users.positions_m),
            positions(&sensors.positions_m),
            origin.latitude_deg,
            origin.longitude_deg,
            origin.elevation_m,
            sensing.to_toml(),
            uncertainty.to_toml(),
        )
    }
}

impl RadioTable {
    /// Returns the constants of the paper's model, which are those of Table I, and not used, where
    /// another model is chosen.
    fn line_of_sight(&self) -> Result<(Environment<f64>, ExcessLoss<f64>), String> {
        let model = self.model;
        let keys = [
            ("environment", self.environment.is_some()),
            ("excess_loss_db", self.excess_loss_db.is_some()),
        ];
        let needed = model == RadioModel::ProbabilisticLos;
        if let Some((key, given)) = keys.into_iter().find(|(_, given)| *given != needed) {
            return Err(match given {
                true => format!(
                    "radio.{key} is given, but must not be: radio.model \"{model}\" does not use it"
                ),
                false => {
                    format!("radio.{key} is missing, but radio.model \"{model}\" needs it")
                }
            });
        }
        let usual = MissionParameters::<f64, USERS_MAX, SENSORS_MAX>::table_one();
        Ok((
            self.environment.unwrap_or(usual.environment),
            self.excess_loss_db.unwrap_or(usual.excess_loss_db),
        ))
    }

    /// Returns the lines of the file that choose and describe the model of the gains.
    fn model_lines(&self) -> String {
        let model = match self.model {
            RadioModel::ProbabilisticLos => String::new(),
            model => format!("model = \"{model}\"\n"),
        };
        let environment = self
            .environment
            .map(|Environment { a, b }| format!("environment = {{ a = {a:?}, b = {b:?} }}\n"));
        let excess_loss = self.excess_loss_db.map(|ExcessLoss { los, nlos }| {
            format!("excess_loss_db = {{ los = {los:?}, nlos = {nlos:?} }}\n")
        });
        let gain_map = self.gain_map.as_ref().map(|path| {
            let path = toml::Value::from(path.to_string_lossy().into_owned());
            format!("gain_map = {path}\n")
        });
        [Some(model), environment, excess_loss, gain_map]
            .into_iter()
            .flatten()
            .collect()
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
    /// Checks that the location is on Earth.
    pub(crate) fn check(&self) -> Result<(), String> {
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
