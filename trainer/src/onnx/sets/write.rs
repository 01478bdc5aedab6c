//! Writes a network as a file.

use firmware_core::policy::sets::{
    MISSION_COLUMNS, Precision, SENSOR_COLUMNS, SENSORS, USER_COLUMNS, USERS,
};

use super::{
    features,
    metadata::metadata,
    network::{Masks, Writer},
};
use crate::imitation::trained::TrainedNetwork;

/// Returns the bytes of an `.onnx` file. Weights of half precision are stored so and converted in the
/// graph. The same network always gives the same bytes.
///
/// # Errors
/// Fails if the network exceeds the limits of `firmware-core`, or a parameter is not finite in this
/// precision.
pub fn write(network: &TrainedNetwork, precision: Precision) -> anyhow::Result<Vec<u8>> {
    let metadata = metadata(network, precision)?;
    let [users, sensors] = [USERS as i64, SENSORS as i64];
    let mut writer = Writer::new(network, precision);
    writer.weights();
    let g = &mut writer.g;
    let mission = g.reshape("mission", &[1, 1, MISSION_COLUMNS as i64]);
    let user_mask = g.reshape("user_mask", &[1, users, 1]);
    let sensor_mask = g.reshape("sensor_mask", &[1, sensors, 1]);
    let masks = Masks {
        users: &user_mask,
        sensors: &sensor_mask,
    };
    let inputs = [
        features::mission(g, &mission),
        features::users(g, &mission, "users"),
        features::sensors(g, "sensors"),
    ];
    let places = g.slice("users", 2, 0, 2);
    let [destination, reach] = features::destination_and_reach(g, &mission);
    let tokens = writer.tokens(inputs.each_ref().map(String::as_str), &masks);
    writer.heads(&tokens, [&places, &destination, &reach], &masks);
    Ok(writer.g.graph.finish(
        &[
            ("mission", &[1, MISSION_COLUMNS as i64]),
            ("users", &[1, users, USER_COLUMNS as i64]),
            ("user_mask", &[1, users]),
            ("sensors", &[1, sensors, SENSOR_COLUMNS as i64]),
            ("sensor_mask", &[1, sensors]),
        ],
        &[("displacement", &[1, 2]), ("user_scores", &[1, users])],
        metadata,
    ))
}
