//! The error statistics of a slot problem, as written in a line: numbers for all sensors or lists.

use files::PerNode;
use firmware_core::{
    Scalar,
    uncertainty::{SensorUncertainty, UncertaintyError},
};
use serde::{Deserialize, Deserializer};

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
    error_variance: Option<&PerNode>,
    phase_error_rad: Option<&PerNode>,
) -> Result<Vec<SensorUncertainty<T>>, String> {
    let fields = [
        ("sensor_error_variance", error_variance),
        ("sensor_phase_error_rad", phase_error_rad),
    ];
    for (field, values) in fields {
        if let Some(PerNode::Each(values)) = values
            && values.len() != sensors
        {
            let given = values.len();
            return Err(format!(
                "{field} has {given} numbers, but must be one number or a list of {sensors}, one per \
                 sensor_gain"
            ));
        }
    }
    let value = |values: Option<&PerNode>, index| {
        values.map_or((0.0, false), |values| {
            (values.of(index), matches!(values, PerNode::Each(_)))
        })
    };
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
