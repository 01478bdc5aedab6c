//! The error statistics of a slot problem, as written in a line: numbers for all sensors or lists.

use std::fmt;

use firmware_core::{
    Scalar,
    uncertainty::{SensorUncertainty, UncertaintyError},
};
use serde::{
    Deserialize, Deserializer, Serialize,
    de::{self, SeqAccess, Visitor},
};

/// One number for every sensor, or a list with one number per sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PerSensor {
    /// Every sensor has this value.
    All(f64),
    /// The value of each sensor, in the order of the gains.
    Each(Vec<f64>),
}

impl PerSensor {
    /// Returns the value of sensor `index`, and whether it is its own.
    fn of(&self, index: usize) -> (f64, bool) {
        match self {
            Self::All(value) => (*value, false),
            Self::Each(values) => (values.get(index).copied().unwrap_or(f64::NAN), true),
        }
    }
}

impl<'de> Deserialize<'de> for PerSensor {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumberOrList;

        impl<'de> Visitor<'de> for NumberOrList {
            type Value = PerSensor;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or a list with one number per sensor")
            }

            fn visit_f64<E: de::Error>(self, value: f64) -> Result<PerSensor, E> {
                Ok(PerSensor::All(value))
            }

            fn visit_u64<E: de::Error>(self, value: u64) -> Result<PerSensor, E> {
                Ok(PerSensor::All(value as f64))
            }

            fn visit_i64<E: de::Error>(self, value: i64) -> Result<PerSensor, E> {
                Ok(PerSensor::All(value as f64))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<PerSensor, A::Error> {
                let mut values = Vec::new();
                while let Some(value) = list.next_element()? {
                    values.push(value);
                }
                Ok(PerSensor::Each(values))
            }
        }

        deserializer.deserialize_any(NumberOrList)
    }
}

/// Reads a field that may be absent, but not `null`: programs write NaN as `null`.
pub(crate) fn given<'de, D, V>(deserializer: D) -> Result<Option<V>, D::Error>
where
    D: Deserializer<'de>,
    V: Deserialize<'de>,
{
    V::deserialize(deserializer).map(Some)
}

/// Returns the statistics of `sensors` sensors in the arithmetic `T`. What is absent is 0.
///
/// # Errors
/// Returns a message with the field, its value and what is valid.
pub(crate) fn sensor_statistics<T: Scalar>(
    sensors: usize,
    error_variance: Option<&PerSensor>,
    phase_error_rad: Option<&PerSensor>,
) -> Result<Vec<SensorUncertainty<T>>, String> {
    let fields = [
        ("sensor_error_variance", error_variance),
        ("sensor_phase_error_rad", phase_error_rad),
    ];
    for (field, values) in fields {
        if let Some(PerSensor::Each(values)) = values
            && values.len() != sensors
        {
            let given = values.len();
            return Err(format!(
                "{field} has {given} numbers, but must be one number or a list of {sensors}, one per \
                 sensor_gain"
            ));
        }
    }
    let value =
        |values: Option<&PerSensor>, index| values.map_or((0.0, false), |values| values.of(index));
    (0..sensors)
        .map(|index| {
            let (variance, has_own_variance) = value(error_variance, index);
            let (phase, has_own_phase) = value(phase_error_rad, index);
            // As written: rounded to single precision, a bad value might be a valid one.
            SensorUncertainty::with_phase_error(variance, phase).map_err(|error| {
                let own = match &error {
                    UncertaintyError::OutOfRange { field, .. } if *field == fields[0].0 => {
                        has_own_variance
                    }
                    _ => has_own_phase,
                };
                let error = if own { error.of_sensor(index) } else { error };
                error.to_string()
            })?;
            let rounded = SensorUncertainty::with_phase_error(T::of(variance), T::of(phase));
            rounded.map_err(|error| error.of_sensor(index).to_string())
        })
        .collect()
}
