//! Missions for tests with the values of Table I. The tests in `tests/` include this file, too.

#![allow(dead_code)] // each test uses a part of it

use firmware_core::{
    Mission, Position, Scalar, Watt,
    mission::{Area, Environment, ExcessLoss, MissionParameters},
};
use heapless::Vec;

/// Returns the values of Table I without any user or sensor.
pub(crate) fn table_one_without_nodes<T: Scalar, const M: usize, const J: usize>()
-> MissionParameters<T, M, J> {
    let place = |x: f64, y: f64| Position::new(T::of(x), T::of(y));
    MissionParameters {
        slots: 60,
        slot_duration_s: T::one(),
        start: place(50.0, 50.0),
        destination: place(950.0, 950.0),
        area: Area {
            east_m: T::of(1000.0),
            north_m: T::of(1000.0),
        },
        altitude_m: T::of(100.0),
        max_speed_mps: T::of(30.0),
        carrier_hz: T::of(2e9),
        environment: Environment {
            a: T::of(9.613),
            b: T::of(0.158),
        },
        excess_loss_db: ExcessLoss {
            los: T::one(),
            nlos: T::of(20.0),
        },
        noise_power: Watt::from_dbm(T::of(-95.0)),
        mse_threshold: T::of(0.015),
        user_power_max: Watt(T::of(0.2)),
        sensor_power_max: Watt(T::of(0.05)),
        users: Vec::new(),
        sensors: Vec::new(),
    }
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
