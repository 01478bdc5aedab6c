// SPDX-License-Identifier: MIT OR Apache-2.0
//! Missions for tests with the values of Table I. The tests in `tests/` include this file, too.

#![allow(dead_code)] // each test uses a part of it

use firmware_core::{Mission, Position, Scalar, mission::MissionParameters};
use heapless::Vec;

/// Returns the values of Table I without any user or sensor.
pub(crate) fn table_one_without_nodes<T: Scalar, const M: usize, const J: usize>()
-> MissionParameters<T, M, J> {
    MissionParameters::table_one()
}

/// Table I: 15 users in the north-west, 36 sensors in the south-east.
pub(crate) fn table_one_parameters<T: Scalar>() -> MissionParameters<T, 16, 64> {
    let place = |x: f64, y: f64| Position::new(T::of(x), T::of(y));
    let mut users = Vec::new();
    for index in 0..15 {
        let (column, row) = (f64::from(index % 4), f64::from(index / 4));
        let _ = users.push(place(100.0 + 90.0 * column, 600.0 + 95.0 * row));
    }
    let mut sensors = Vec::new();
    for index in 0..36 {
        let (column, row) = (f64::from(index % 6), f64::from(index / 6));
        let _ = sensors.push(place(550.0 + 70.0 * column, 60.0 + 70.0 * row));
    }
    MissionParameters {
        users,
        sensors,
        ..table_one_without_nodes()
    }
}

pub(crate) fn table_one<T: Scalar>() -> Mission<T, 16, 64> {
    match Mission::new(table_one_parameters()) {
        Ok(mission) => mission,
        Err(error) => panic!("{error}"),
    }
}
