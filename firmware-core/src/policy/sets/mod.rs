// SPDX-License-Identifier: MIT OR Apache-2.0
//! A trained policy for any mission: its observation describes the mission as *sets* of users and
//! sensors, so that one policy flies every map.
//!
//! [`SetsObservation`] holds raw physical units in fixed columns ([`MISSION_COLUMN_NAMES`],
//! [`USER_COLUMN_NAMES`], [`SENSOR_COLUMN_NAMES`]); the functions of [`features`] turn them into the
//! inputs of the network, which are about 1 in size.

mod columns;
pub mod features;
mod observation;

pub use columns::{
    MISSION_COLUMN_NAMES, MISSION_COLUMNS, PLACES, SENSOR_COLUMN_NAMES, SENSOR_COLUMNS, SENSORS,
    USER_COLUMN_NAMES, USER_COLUMNS, USERS,
};
pub use observation::SetsObservation;

#[cfg(test)]
mod tests;
