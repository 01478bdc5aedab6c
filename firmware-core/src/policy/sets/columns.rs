// SPDX-License-Identifier: MIT OR Apache-2.0
//! The columns of the observation: physical quantities in raw units.
//!
//! Lengths are in metres, rates in bit/s/Hz, durations in slots, and powers in decibels, because
//! noise and received powers span more decades than `f32` has digits. "Relative" means relative to
//! the measured position of the vehicle, to the east and to the north.

/// The largest number of users.
pub const USERS: usize = crate::USERS_MAX;

/// The largest number of sensors.
pub const SENSORS: usize = crate::SENSORS_MAX;

/// The distances of the observed places from the vehicle, in units of the reach of one slot. There are
/// eight on each of these rings.
pub const RINGS: [f64; 3] = [1.0, 3.0, 8.0];

/// The number of places at which rates are observed: the vehicle's position, and eight places on each
/// ring, counterclockwise from the east. Places outside the area are moved to its border, each
/// coordinate by itself.
pub const PLACES: usize = 1 + 8 * RINGS.len();

/// The number of columns that describe the mission.
pub const MISSION_COLUMNS: usize = 19 + PLACES;

/// The number of columns per user.
pub const USER_COLUMNS: usize = 5 + PLACES + 2;

/// The number of columns per sensor.
pub const SENSOR_COLUMNS: usize = 3;

/// Returns names, followed by those of the columns of the places, followed by names.
macro_rules! with_places {
    ([$($first:literal,)*], $prefix:literal, [$($last:literal,)*]) => {
        [
            $($first,)*
            concat!($prefix, "here"),
            concat!($prefix, "east"),
            concat!($prefix, "north_east"),
            concat!($prefix, "north"),
            concat!($prefix, "north_west"),
            concat!($prefix, "west"),
            concat!($prefix, "south_west"),
            concat!($prefix, "south"),
            concat!($prefix, "south_east"),
            concat!($prefix, "east_3"),
            concat!($prefix, "north_east_3"),
            concat!($prefix, "north_3"),
            concat!($prefix, "north_west_3"),
            concat!($prefix, "west_3"),
            concat!($prefix, "south_west_3"),
            concat!($prefix, "south_3"),
            concat!($prefix, "south_east_3"),
            concat!($prefix, "east_8"),
            concat!($prefix, "north_east_8"),
            concat!($prefix, "north_8"),
            concat!($prefix, "north_west_8"),
            concat!($prefix, "west_8"),
            concat!($prefix, "south_west_8"),
            concat!($prefix, "south_8"),
            concat!($prefix, "south_east_8"),
            $($last,)*
        ]
    };
}

/// The names of the columns that describe the mission.
pub const MISSION_COLUMN_NAMES: [&str; MISSION_COLUMNS] = with_places!(
    [
        // The destination, relative.
        "destination_east_m",
        "destination_north_m",
        // The vehicle's position, and the extent of the area from the origin.
        "vehicle_east_m",
        "vehicle_north_m",
        "area_east_m",
        "area_north_m",
        "altitude_m",
        // `V_max delta`, or the longest step that the vehicle can fly where that is less; at least 1 mm.
        "reach_m",
        // `N`, and how many of them are left, the coming one included.
        "slots",
        "slots_left",
        // The sum of the users' remaining quotas.
        "slots_owed",
        // `floor(N / M)`.
        "quota_slots",
        "users",
        "sensors",
        // `Gamma`, and `log2(1 / (1 - J Gamma))`, bit/s/Hz.
        "mse_threshold",
        "slot_rate_limit",
        "noise_dbm",
        "user_power_max_dbm",
        "sensor_power_max_dbm",
    ],
    // The highest rate among the admissible users, at each place.
    "best_rate_",
    []
);

/// The names of the columns of a user.
pub const USER_COLUMN_NAMES: [&str; USER_COLUMNS] = with_places!(
    [
        // The user's position, relative.
        "east_m",
        "north_m",
        // In how many slots it was served so far, and must be served in all.
        "slots_served",
        "quota_slots",
        // 1 if it may be served in the coming slot (eq:a3), otherwise 0.
        "admissible",
    ],
    // Its rate at each place: the optimum of the slot problem, 0 where `Gamma` cannot be met.
    "rate_",
    [
        // Its rate with the vehicle above it, and the highest among the admissible users there.
        "rate_above",
        "best_rate_above",
    ]
);

/// The names of the columns of a sensor.
pub const SENSOR_COLUMN_NAMES: [&str; SENSOR_COLUMNS] = [
    // The sensor's position, relative.
    "east_m",
    "north_m",
    // `p_b^max |h|^2 / sigma^2` with the vehicle where it is, decibels.
    "received_snr_db",
];
