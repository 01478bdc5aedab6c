//! What the sensors measure, in physical units, and which function of the measurements the vehicle
//! estimates (eq:F).

use std::{
    fmt,
    path::{Path, PathBuf},
};

use files::input;
use firmware_core::Position;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::{HostMission, file::table};

/// The `[sensing]` table. All keys have defaults, which give the mean of a temperature field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sensing {
    /// The nomographic function that the vehicle estimates.
    pub function: Function,
    /// The weights of the weighted mean: one above 0 per sensor. Only their ratios matter.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub weights: Vec<f64>,
    /// The unit of the measurements, as printed in reports.
    pub unit: String,
    /// A CSV file of measurements, with a row per slot and a column per sensor. Its path is
    /// relative to the scenario file. Without it, `field` is measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measurements_csv: Option<PathBuf>,
    /// The field that is measured if no CSV file is given.
    #[serde(deserialize_with = "table")]
    pub field: TemperatureField,
    /// The content of the CSV file, row by row.
    #[serde(skip)]
    measurements: Option<Vec<Vec<f64>>>,
}

impl Default for Sensing {
    fn default() -> Self {
        Self {
            function: Function::Mean,
            weights: Vec::new(),
            unit: "degC".into(),
            measurements_csv: None,
            field: TemperatureField::default(),
            measurements: None,
        }
    }
}

/// The function `F` of eq:F.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Function {
    /// The arithmetic mean.
    Mean,
    /// The mean with the given weights.
    WeightedMean,
    /// The geometric mean. All measurements must be above 0.
    GeometricMean,
}

impl fmt::Display for Function {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mean => "mean",
            Self::WeightedMean => "weighted-mean",
            Self::GeometricMean => "geometric-mean",
        })
    }
}

/// A smooth temperature field that drifts: a gradient and a few warm and cold spots.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TemperatureField {
    /// The seed that the field is drawn with.
    pub seed: u64,
    /// The mean of the field, degrees Celsius.
    pub mean_c: f64,
    /// The spread of the field over the area, degrees Celsius.
    pub spread_c: f64,
    /// The noise of the sensors, degrees Celsius.
    pub sensor_noise_c: f64,
}

impl Default for TemperatureField {
    fn default() -> Self {
        Self {
            seed: 1,
            mean_c: 21.0,
            spread_c: 4.0,
            sensor_noise_c: 0.2,
        }
    }
}

impl Sensing {
    /// Checks everything that does not depend on another file.
    pub(super) fn check(&self, sensors: usize) -> Result<(), String> {
        let field = &self.field;
        for (name, value) in [
            ("mean_c", field.mean_c),
            ("spread_c", field.spread_c),
            ("sensor_noise_c", field.sensor_noise_c),
        ] {
            if !value.is_finite() || (name != "mean_c" && value < 0.0) {
                return Err(format!(
                    "sensing.field.{name} is {value}, but must be a finite number{}",
                    if name == "mean_c" {
                        ""
                    } else {
                        " of at least 0"
                    }
                ));
            }
        }
        match self.function {
            Function::WeightedMean => {
                if self.weights.len() != sensors {
                    return Err(format!(
                        "sensing.weights has {} entries, but must have one for each of the {sensors} sensors",
                        self.weights.len()
                    ));
                }
                for (index, weight) in self.weights.iter().enumerate() {
                    if !(weight.is_finite() && *weight > 0.0) {
                        return Err(format!(
                            "sensing.weights[{index}] is {weight}, but must be a finite number above 0"
                        ));
                    }
                }
                Ok(())
            }
            Function::Mean | Function::GeometricMean if !self.weights.is_empty() => Err(
                "sensing.weights is given, but sensing.function is not \"weighted-mean\"".into(),
            ),
            Function::Mean | Function::GeometricMean => Ok(()),
        }
    }

    /// Formats the keys of the table for a file.
    pub(super) fn to_toml(&self) -> String {
        let field = &self.field;
        let mut text = format!("function = \"{}\"\n", self.function);
        if !self.weights.is_empty() {
            text.push_str(&format!("weights = {:?}\n", self.weights));
        }
        text.push_str(&format!("unit = {}\n", toml::Value::from(&*self.unit)));
        if let Some(path) = &self.measurements_csv {
            let path = path.to_string_lossy();
            text.push_str(&format!(
                "measurements_csv = {}\n",
                toml::Value::from(&*path)
            ));
        }
        text.push_str(&format!(
            "field = {{ seed = {}, mean_c = {:?}, spread_c = {:?}, sensor_noise_c = {:?} }}\n",
            field.seed, field.mean_c, field.spread_c, field.sensor_noise_c
        ));
        text
    }

    /// Reads the CSV file, if the table names one.
    pub(super) fn load_measurements(
        &mut self,
        folder: &Path,
        mission: &HostMission,
    ) -> Result<(), String> {
        let Some(name) = &self.measurements_csv else {
            return Ok(());
        };
        let path = folder.join(name);
        let rows = read_csv(&path, mission).map_err(|problem| {
            format!("sensing.measurements_csv: {}: {problem}", path.display())
        })?;
        self.measurements = Some(rows);
        self.check_measurements(mission)
            .map_err(|problem| format!("sensing.measurements_csv: {}: {problem}", path.display()))
    }

    /// Checks the measurements of a file or of the field: there must be a row for every slot of the
    /// mission, and all values must be above 0 for a geometric mean.
    pub(super) fn check_measurements(&self, mission: &HostMission) -> Result<(), String> {
        let rows = self.measurements(mission);
        let slots = mission.slots() as usize;
        if rows.len() != slots {
            return Err(format!(
                "{} rows of measurements, but the mission has {slots} slots",
                rows.len()
            ));
        }
        if self.function != Function::GeometricMean {
            return Ok(());
        }
        for (row, values) in rows.iter().enumerate() {
            if let Some(column) = values.iter().position(|value| *value <= 0.0) {
                return Err(format!(
                    "slot {}, sensor {column} measures {}, but a geometric mean needs numbers above 0",
                    row + 1,
                    values[column]
                ));
            }
        }
        Ok(())
    }

    /// Returns `d_{j,n}`: what every sensor measures in every slot, in [`unit`](Self::unit).
    pub fn measurements(&self, mission: &HostMission) -> Vec<Vec<f64>> {
        match &self.measurements {
            Some(rows) => rows.clone(),
            None => self.field.measure(mission),
        }
    }
}

fn read_csv(path: &Path, mission: &HostMission) -> Result<Vec<Vec<f64>>, String> {
    let content = input::read(path).map_err(|error| error.to_string())?;
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(content.as_slice());
    let sensors = mission.sensor_count();
    let mut rows = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let record = record.map_err(|error| error.to_string())?;
        let row = index + 1;
        // A first row that consists of names is a header.
        if index == 0 && record.iter().all(|cell| cell.parse::<f64>().is_err()) {
            continue;
        }
        if record.len() != sensors {
            return Err(format!(
                "row {row} has {} values, but there are {sensors} sensors",
                record.len()
            ));
        }
        let mut values = Vec::with_capacity(sensors);
        for (column, cell) in record.iter().enumerate() {
            match cell.parse::<f64>() {
                Ok(value) if value.is_finite() => values.push(value),
                _ => {
                    return Err(format!(
                        "row {row}, column {} is `{cell}`, but must be a finite number",
                        column + 1
                    ));
                }
            }
        }
        rows.push(values);
    }
    Ok(rows)
}

/// A warm or cold spot that drifts.
struct Spot {
    center: Position<f64>,
    drift_mps: nalgebra::Vector2<f64>,
    width_m: f64,
    height_c: f64,
}

impl TemperatureField {
    /// Returns the measurement of every sensor in every slot.
    fn measure(&self, mission: &HostMission) -> Vec<Vec<f64>> {
        let p = mission.parameters();
        let mut random = Pcg64::seed_from_u64(self.seed);
        let extent_m = p.area.east_m.max(p.area.north_m);
        let spots: Vec<Spot> = (0..6)
            .map(|index| Spot {
                center: Position::new(
                    random.random_range(0.0..p.area.east_m),
                    random.random_range(0.0..p.area.north_m),
                ),
                drift_mps: nalgebra::Vector2::new(
                    random.random_range(-1.0..1.0),
                    random.random_range(-1.0..1.0),
                ),
                width_m: extent_m * random.random_range(0.1..0.3),
                height_c: self.spread_c * if index % 2 == 0 { 1.0 } else { -1.0 },
            })
            .collect();
        let gradient = random.random_range(-0.5..0.5) * self.spread_c / extent_m;
        (0..mission.slots())
            .map(|slot| {
                let time_s = f64::from(slot) * p.slot_duration_s;
                p.sensors
                    .iter()
                    .map(|place| {
                        let bumps: f64 = spots.iter().map(|spot| spot.at(place, time_s)).sum();
                        let noise: f64 = StandardNormal.sample(&mut random);
                        self.mean_c + gradient * place.y + bumps + self.sensor_noise_c * noise
                    })
                    .collect()
            })
            .collect()
    }
}

impl Spot {
    fn at(&self, place: &Position<f64>, time_s: f64) -> f64 {
        let center = self.center + self.drift_mps * time_s;
        let square = (place - center).norm_squared() / (self.width_m * self.width_m);
        self.height_c * (-0.5 * square).exp()
    }
}
