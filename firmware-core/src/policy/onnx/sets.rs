// SPDX-License-Identifier: MIT OR Apache-2.0
//! A policy for any mission: format version 2.

use std::{sync::Arc, vec, vec::Vec as StdVec};

use tract_onnx::prelude::*;

use super::{error::OnnxError, metadata::Metadata, model::Model};
use crate::policy::sets::{
    self, EvaluateSets, MISSION_COLUMNS, SENSOR_COLUMNS, SENSORS, SetsObservation, SetsOutput,
    SetsProvenance, USER_COLUMNS, USERS,
};

/// The keys that the metadata must have.
const REQUIRED: [&str; 13] = [
    "format_version",
    "mission_names",
    "user_names",
    "sensor_names",
    "algorithm",
    "missions",
    "episodes",
    "seed",
    "test_mission",
    "test_users",
    "test_sensors",
    "test_displacement",
    "test_user_scores",
];

/// The shapes of the inputs.
const MISSION: [usize; 2] = [1, MISSION_COLUMNS];
const USER_ROWS: [usize; 3] = [1, USERS, USER_COLUMNS];
const USER_MASK: [usize; 2] = [1, USERS];
const SENSOR_ROWS: [usize; 3] = [1, SENSORS, SENSOR_COLUMNS];
const SENSOR_MASK: [usize; 2] = [1, SENSORS];

/// A network for any mission that was loaded, optimised and checked: the counterpart of
/// [`SetsNetwork`](sets::SetsNetwork), for a [`SetsPolicy`](sets::SetsPolicy).
#[derive(Debug)]
pub struct SetsOnnx {
    state: TypedSimpleState,
    provenance: SetsProvenance,
}

impl SetsOnnx {
    /// Loads a network from a file's bytes.
    ///
    /// # Errors
    /// Returns what is wrong with the file.
    pub fn load(file: &[u8]) -> Result<Self, OnnxError> {
        Self::of_model(Model::read(file)?)
    }

    pub(super) fn of_model(model: Model) -> Result<Self, OnnxError> {
        model.metadata.require(&REQUIRED)?;
        model.metadata.check_version(sets::FORMAT_VERSION.into())?;
        check_columns(&model.metadata)?;
        let (state, metadata) = model.prepare(
            &[
                ("mission", &MISSION),
                ("users", &USER_ROWS),
                ("user_mask", &USER_MASK),
                ("sensors", &SENSOR_ROWS),
                ("sensor_mask", &SENSOR_MASK),
            ],
            &[("displacement", &[1, 2]), ("user_scores", &[1, USERS])],
        )?;
        let provenance = SetsProvenance {
            algorithm: metadata.bounded("algorithm")?,
            missions: metadata.bounded("missions")?,
            episodes: metadata.number("episodes")?,
            seed: metadata.number("seed")?,
        };
        let mut network = Self { state, provenance };
        network.self_test(&metadata)?;
        Ok(network)
    }

    /// Returns the origin of the policy.
    pub fn provenance(&self) -> &SetsProvenance {
        &self.provenance
    }

    fn run(&mut self, observation: &SetsObservation) -> TractResult<SetsOutput> {
        let rows = |count: usize, most: usize| (0..most).map(move |row| row < count);
        let mask = |count: usize, most: usize| -> StdVec<f32> {
            rows(count, most)
                .map(|used| f32::from(u8::from(used)))
                .collect()
        };
        // Rows that are not used are 0, whatever the observation has there.
        let mut observation = observation.clone();
        let (users, sensors) = (
            observation.user_rows().len(),
            observation.sensor_rows().len(),
        );
        observation
            .users
            .iter_mut()
            .skip(users)
            .for_each(|row| *row = [0.0; USER_COLUMNS]);
        let unused = observation.sensors.iter_mut().skip(sensors);
        unused.for_each(|row| *row = [0.0; SENSOR_COLUMNS]);
        let outputs = self.state.run(tvec!(
            tensor(&MISSION, &observation.mission)?,
            tensor(&USER_ROWS, observation.users.as_flattened())?,
            tensor(&USER_MASK, &mask(users, USERS))?,
            tensor(&SENSOR_ROWS, observation.sensors.as_flattened())?,
            tensor(&SENSOR_MASK, &mask(sensors, SENSORS))?,
        ))?;
        let mut output = SetsOutput {
            displacement_m: [0.0; 2],
            user_scores: [0.0; USERS],
        };
        let SetsOutput {
            displacement_m,
            user_scores,
        } = &mut output;
        for (numbers, output) in [&mut displacement_m[..], &mut user_scores[..]]
            .into_iter()
            .zip(&outputs)
        {
            let view = output.try_as_plain_ram()?;
            for (number, &value) in numbers.iter_mut().zip(view.as_slice::<f32>()?) {
                *number = value;
            }
        }
        Ok(output)
    }

    fn self_test(&mut self, metadata: &Metadata) -> Result<(), OnnxError> {
        let mission = metadata.rows("test_mission", MISSION_COLUMNS, 1)?;
        let users = metadata.rows("test_users", USER_COLUMNS, USERS)?;
        let sensors = metadata.rows("test_sensors", SENSOR_COLUMNS, SENSORS)?;
        let user_count = users.len() / USER_COLUMNS;
        let mut expected = metadata.list("test_displacement", 2)?;
        expected.extend(metadata.list("test_user_scores", user_count)?);
        let counts = [user_count, sensors.len() / SENSOR_COLUMNS];
        let columns = mission.into_iter().chain(users).chain(sensors);
        let observation = SetsObservation::of_columns(counts, columns);
        let output = self.run(&observation).map_err(OnnxError::network)?;
        Ok(output.check(&observation, expected.iter().copied())?)
    }
}

impl EvaluateSets for SetsOnnx {
    /// `None` would mean an error of tract; none is known for a network that was loaded.
    fn evaluate(&mut self, observation: &SetsObservation) -> Option<SetsOutput> {
        self.run(observation).ok()
    }
}

/// Checks that the policy observes the columns of this build.
fn check_columns(metadata: &Metadata) -> Result<(), OnnxError> {
    metadata.check_names("mission_names", &sets::MISSION_COLUMN_NAMES)?;
    metadata.check_names("user_names", &sets::USER_COLUMN_NAMES)?;
    metadata.check_names("sensor_names", &sets::SENSOR_COLUMN_NAMES)
}

fn tensor(dims: &[usize], numbers: &[f32]) -> TractResult<TValue> {
    let tensor = Tensor::from_shape(dims, numbers)?;
    Ok(TValue::from_const(Arc::new(tensor)))
}
