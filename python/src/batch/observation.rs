//! The forms of the observation.

use environment::Environment;
use firmware_core::policy::{
    sets::{
        MISSION_COLUMNS, SENSOR_COLUMNS, SENSORS, SetsObservation, USER_COLUMNS, USERS,
        features::{
            MISSION_FEATURES, SENSOR_FEATURES, USER_FEATURES, mission_features, sensor_features,
            user_features,
        },
    },
    state_len,
};
use numpy::PyReadwriteArrayDyn;
use pyo3::prelude::*;

use crate::{arrays::split_off, mission::value_error};

/// The number of arrays of an observation, at most.
const ARRAYS_MAX: usize = 5;

/// The form of the observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ObservationKind {
    /// The paper's state, `M + 4` numbers, scaled or in raw units.
    Paper { normalize: bool },
    /// The five arrays of policy files of format version 2: raw columns, or the features that the
    /// network calculates from them.
    Sets { normalize: bool },
    /// The numbers of the five arrays, one after the other.
    Flat { normalize: bool },
}

impl ObservationKind {
    pub(super) fn named(name: &str, normalize: bool) -> PyResult<Self> {
        match name {
            "paper" => Ok(Self::Paper { normalize }),
            "sets" => Ok(Self::Sets { normalize }),
            "flat" => Ok(Self::Flat { normalize }),
            _ => Err(value_error(format!(
                "observation is {name:?}, but must be paper, sets or flat"
            ))),
        }
    }

    /// Returns whether all missions must have as many users.
    pub(super) fn is_of_one_size(self) -> bool {
        matches!(self, Self::Paper { .. })
    }

    /// Returns the shapes of the arrays.
    pub(super) fn shapes(self, users: usize) -> Vec<Vec<usize>> {
        let sets = |normalize: bool| {
            let [mission, user, sensor] = if normalize {
                [MISSION_FEATURES, USER_FEATURES, SENSOR_FEATURES]
            } else {
                [MISSION_COLUMNS, USER_COLUMNS, SENSOR_COLUMNS]
            };
            vec![
                vec![mission],
                vec![USERS, user],
                vec![USERS],
                vec![SENSORS, sensor],
                vec![SENSORS],
            ]
        };
        match self {
            Self::Paper { .. } => vec![vec![state_len(users)]],
            Self::Sets { normalize } => sets(normalize),
            Self::Flat { normalize } => {
                let lengths = sets(normalize).into_iter();
                let lengths = lengths.map(|shape| shape.iter().product::<usize>());
                vec![vec![lengths.sum()]]
            }
        }
    }

    /// Returns how many episodes are worth another thread.
    pub(super) fn episodes_per_job(self) -> usize {
        match self {
            Self::Paper { .. } => 32,
            // An observation takes about 100 us.
            Self::Sets { .. } | Self::Flat { .. } => 1,
        }
    }

    /// Writes the observation of the environment's state.
    pub(super) fn write(self, environment: &mut Environment<f64>, mut row: Rows<'_>) {
        match self {
            Self::Paper { normalize: true } => environment.observe(row.part(0)),
            Self::Paper { normalize: false } => environment.observe_raw(row.part(0)),
            Self::Sets { normalize } => {
                let sets = environment.observe_sets();
                let parts = row.parts.iter_mut().map(|part| &mut **part);
                write_sets(&sets, normalize, parts);
            }
            Self::Flat { normalize } => {
                let sets = environment.observe_sets();
                let mut rest = row.part(0);
                let shapes = Self::Sets { normalize }.shapes(USERS);
                let lengths = shapes.iter().map(|shape| shape.iter().product());
                let parts = lengths.map(|length| split_off(&mut rest, length));
                write_sets(&sets, normalize, parts.collect::<Vec<_>>().into_iter());
            }
        }
    }
}

/// Writes the five arrays. Rows of users and sensors that do not exist are zero.
fn write_sets<'a>(
    sets: &SetsObservation,
    normalize: bool,
    mut parts: impl Iterator<Item = &'a mut [f32]>,
) {
    let mut next = || parts.next().unwrap_or_default();
    let mission = next();
    let users = next();
    let user_mask = next();
    let sensors = next();
    let sensor_mask = next();
    users.fill(0.0);
    sensors.fill(0.0);
    if normalize {
        mission.copy_from_slice(&mission_features(&sets.mission));
        let (rows, _) = users.as_chunks_mut::<USER_FEATURES>();
        for (row, user) in rows.iter_mut().zip(sets.user_rows()) {
            *row = user_features(&sets.mission, user);
        }
        let (rows, _) = sensors.as_chunks_mut::<SENSOR_FEATURES>();
        for (row, sensor) in rows.iter_mut().zip(sets.sensor_rows()) {
            *row = sensor_features(sensor);
        }
    } else {
        mission.copy_from_slice(&sets.mission);
        let (rows, _) = users.as_chunks_mut::<USER_COLUMNS>();
        for (row, user) in rows.iter_mut().zip(sets.user_rows()) {
            *row = *user;
        }
        let (rows, _) = sensors.as_chunks_mut::<SENSOR_COLUMNS>();
        for (row, sensor) in rows.iter_mut().zip(sets.sensor_rows()) {
            *row = *sensor;
        }
    }
    for (mask, count) in [
        (user_mask, sets.user_count),
        (sensor_mask, sets.sensor_count),
    ] {
        for (index, entry) in mask.iter_mut().enumerate() {
            *entry = f32::from(u8::from(index < count));
        }
    }
}

/// The rows of some episodes in the arrays of observations.
#[derive(Default)]
pub(super) struct Rows<'a> {
    parts: [&'a mut [f32]; ARRAYS_MAX],
    /// The length of a row in each.
    lengths: [usize; ARRAYS_MAX],
}

impl<'a> Rows<'a> {
    pub(super) fn new(arrays: &'a mut [PyReadwriteArrayDyn<'_, f32>]) -> PyResult<Self> {
        let mut rows = Self::default();
        let places = rows.parts.iter_mut().zip(&mut rows.lengths);
        for ((part, length), array) in places.zip(arrays) {
            *length = array.as_array().shape()[1..].iter().product();
            *part = array.as_slice_mut()?;
        }
        Ok(rows)
    }

    /// Takes the rows of the next `count` episodes.
    pub(super) fn split_off(&mut self, count: usize) -> Self {
        let mut taken = Self {
            lengths: self.lengths,
            ..Self::default()
        };
        let sources = self.parts.iter_mut().zip(self.lengths);
        for (part, (source, length)) in taken.parts.iter_mut().zip(sources) {
            *part = split_off(source, count * length);
        }
        taken
    }

    fn part(&mut self, index: usize) -> &mut [f32] {
        self.parts[index]
    }
}
