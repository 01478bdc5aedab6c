//! The `metadata_props` of a policy for any mission.

use firmware_core::policy::sets::{
    FORMAT_VERSION, MISSION_COLUMN_NAMES, MISSION_COLUMNS, Precision, SENSOR_COLUMN_NAMES,
    SENSOR_COLUMNS, SENSORS, SetsNetwork, SetsObservation, SetsProvenance, SetsWork,
    USER_COLUMN_NAMES, USER_COLUMNS, USERS,
};

use anyhow::{Context, ensure};

use super::super::{graph::listed, metadata::Entries};
use crate::imitation::trained::{TrainedNetwork, test_observation};

/// Returns the entries: names of the columns, provenance and test vector.
pub(super) fn metadata(
    network: &TrainedNetwork,
    precision: Precision,
) -> anyhow::Result<Vec<(&'static str, String)>> {
    let mut work = SetsWork::default();
    let flying = SetsNetwork::load(network.to_policy_file(precision)?, &mut work)?;
    let test = test_observation()?;
    let output = flying.evaluate(&test, &mut work);
    let output = output.context("the network cannot be evaluated")?;
    let scores = output.user_scores.iter().take(test.user_rows().len());
    let origin = &network.provenance;
    Ok(vec![
        ("format_version", FORMAT_VERSION.to_string()),
        ("mission_names", listed(MISSION_COLUMN_NAMES)),
        ("user_names", listed(USER_COLUMN_NAMES)),
        ("sensor_names", listed(SENSOR_COLUMN_NAMES)),
        ("algorithm", origin.algorithm.to_string()),
        ("missions", origin.missions.to_string()),
        ("episodes", origin.episodes.to_string()),
        ("seed", origin.seed.to_string()),
        ("test_mission", listed(test.mission)),
        ("test_users", listed(test.user_rows().as_flattened())),
        ("test_sensors", listed(test.sensor_rows().as_flattened())),
        ("test_displacement", listed(output.displacement_m)),
        ("test_user_scores", listed(scores)),
    ])
}

/// Reads the origin of a network.
pub(super) fn provenance(entries: &Entries<'_>) -> anyhow::Result<SetsProvenance> {
    Ok(SetsProvenance {
        algorithm: entries.bounded("algorithm")?,
        missions: entries.bounded("missions")?,
        episodes: entries.number("episodes")?,
        seed: entries.number("seed")?,
    })
}

/// Reads the test vector: an observation, and the displacement and scores that are expected.
pub(super) fn test_vector(entries: &Entries<'_>) -> anyhow::Result<(SetsObservation, Vec<f32>)> {
    let rows = |key, columns: usize, most: usize| -> anyhow::Result<Vec<f32>> {
        let numbers = entries.list(key)?;
        let rows = numbers.len() / columns;
        ensure!(
            numbers.len() == rows * columns && (1..=most).contains(&rows),
            "metadata_props {key} has {} numbers, but must have 1 to {most} times {columns}",
            numbers.len()
        );
        Ok(numbers)
    };
    let mission = rows("test_mission", MISSION_COLUMNS, 1)?;
    let users = rows("test_users", USER_COLUMNS, USERS)?;
    let sensors = rows("test_sensors", SENSOR_COLUMNS, SENSORS)?;
    let user_count = users.len() / USER_COLUMNS;
    let counts = [user_count, sensors.len() / SENSOR_COLUMNS];
    let mut expected = rows("test_displacement", 2, 1)?;
    expected.extend(rows("test_user_scores", user_count, 1)?);
    let columns = mission.into_iter().chain(users).chain(sensors);
    Ok((SetsObservation::of_columns(counts, columns), expected))
}
