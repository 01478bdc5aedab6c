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

/// The number of places at which rates are observed: the vehicle's position, and eight places at the
/// distance of one slot's reach around it, counterclockwise from the east. Places outside the area
/// are moved to its border, each coordinate by itself.
pub const PLACES: usize = 9;

/// The number of columns that describe the mission.
pub const MISSION_COLUMNS: usize = 28;

/// The number of columns per user.
pub const USER_COLUMNS: usize = 14;

/// The number of columns per sensor.
pub const SENSOR_COLUMNS: usize = 3;

/// The names of the columns that describe the mission.
pub const MISSION_COLUMN_NAMES: [&str; MISSION_COLUMNS] = [
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
    // The highest rate among the admissible users, at each place.
    "best_rate_here",
    "best_rate_east",
    "best_rate_north_east",
    "best_rate_north",
    "best_rate_north_west",
    "best_rate_west",
    "best_rate_south_west",
    "best_rate_south",
    "best_rate_south_east",
];

/// The names of the columns of a user.
pub const USER_COLUMN_NAMES: [&str; USER_COLUMNS] = [
    // The user's position, relative.
    "east_m",
    "north_m",
    // In how many slots it was served so far, and must be served in all.
    "slots_served",
    "quota_slots",
    // 1 if it may be served in the coming slot (eq:a3), otherwise 0.
    "admissible",
    // Its rate at each place: the optimum of the slot problem, 0 where `Gamma` cannot be met.
    "rate_here",
    "rate_east",
    "rate_north_east",
    "rate_north",
    "rate_north_west",
    "rate_west",
    "rate_south_west",
    "rate_south",
    "rate_south_east",
];

/// The names of the columns of a sensor.
pub const SENSOR_COLUMN_NAMES: [&str; SENSOR_COLUMNS] = [
    // The sensor's position, relative.
    "east_m",
    "north_m",
    // `p_b^max |h|^2 / sigma^2` with the vehicle where it is, decibels.
    "received_snr_db",
];
