// SPDX-License-Identifier: MIT OR Apache-2.0
//! The inputs of the network, from the columns of the observation.
//!
//! Each function uses only operations that an ONNX graph has as well (addition, multiplication,
//! division, minimum, maximum, square root, `tanh`), because the exported graph contains them:
//! `docs/training.md` has the formula of every feature, in the order of these arrays. All features
//! are finite for every valid mission, between `-LIMIT` and `LIMIT`, and mostly below 3 in magnitude.

use super::columns::{MISSION_COLUMNS, PLACES, SENSOR_COLUMNS, USER_COLUMNS};

/// The number of features of the mission.
pub const MISSION_FEATURES: usize = 20 + 2 * PLACES - 1;

/// The number of features of a user.
pub const USER_FEATURES: usize = 10 + 2 * PLACES - 1 + ABOVE;

/// The number of rates with the vehicle above a user.
const ABOVE: usize = 2;

/// The number of features of a sensor.
pub const SENSOR_FEATURES: usize = 4;

/// The largest magnitude of a feature that is not bounded by itself.
pub const LIMIT: f32 = 5.0;

/// The unit of distances, metres.
pub const DISTANCE_UNIT_M: f32 = 500.0;

/// The factor of differences of rates, which are small.
pub const DIFFERENCE_FACTOR: f32 = 5.0;

/// The least rate limit that rates are divided by, bit/s/Hz.
pub const RATE_LIMIT_MIN: f32 = 1e-6;

/// Returns the features of the mission.
pub fn mission_features(mission: &[f32; MISSION_COLUMNS]) -> [f32; MISSION_FEATURES] {
    let &[
        destination_east_m,
        destination_north_m,
        vehicle_east_m,
        vehicle_north_m,
        area_east_m,
        area_north_m,
        altitude_m,
        reach_m,
        slots,
        slots_left,
        slots_owed,
        quota_slots,
        users,
        sensors,
        mse_threshold,
        slot_rate_limit,
        noise_dbm,
        user_power_max_dbm,
        sensor_power_max_dbm,
        ref best_rates @ ..,
    ] = mission;
    let offset = [destination_east_m, destination_north_m];
    let slots_left_or_one = slots_left.max(1.0);
    let [away_east, away_north, away] = place_features(offset);
    let border = |distance_m: f32| libm::tanhf(distance_m / (5.0 * reach_m));
    let power = |power_dbm: f32| limited((power_dbm - noise_dbm - 110.0) / 10.0);
    let numbers = [
        away_east,
        away_north,
        away,
        limited(length(offset) / (reach_m * slots_left_or_one)),
        slots_left / slots.max(1.0),
        limited(slots_left / 50.0),
        limited(reach_m / 30.0),
        sensors * mse_threshold,
        sensors / 64.0,
        users / 16.0,
        limited(slot_rate_limit / 2.0),
        limited((slots_left - slots_owed) / slots_left_or_one),
        limited(quota_slots / 8.0),
        limited(altitude_m / 100.0),
        border(vehicle_east_m),
        border(vehicle_north_m),
        border(area_east_m - vehicle_east_m),
        border(area_north_m - vehicle_north_m),
        power(user_power_max_dbm),
        power(sensor_power_max_dbm),
    ];
    joined(&numbers, &rate_features(best_rates, slot_rate_limit))
}

/// Returns the features of a user.
pub fn user_features(
    mission: &[f32; MISSION_COLUMNS],
    user: &[f32; USER_COLUMNS],
) -> [f32; USER_FEATURES] {
    let &[
        destination_east_m,
        destination_north_m,
        _,
        _,
        _,
        _,
        _,
        reach_m,
        _,
        slots_left,
        _,
        _,
        _,
        _,
        _,
        slot_rate_limit,
        ..,
    ] = mission;
    let &[
        east_m,
        north_m,
        slots_served,
        quota_slots,
        admissible,
        ref rates @ ..,
        rate_above,
        best_rate_above,
    ] = user;
    let slots_left = slots_left.max(1.0);
    let quota_or_one = quota_slots.max(1.0);
    let owed = (quota_slots - slots_served).max(0.0);
    let [east, north, distance] = place_features([east_m, north_m]);
    let numbers = [
        east,
        north,
        distance,
        limited((east_m - destination_east_m) / DISTANCE_UNIT_M),
        limited((north_m - destination_north_m) / DISTANCE_UNIT_M),
        libm::tanhf(length([east_m, north_m]) / (reach_m * slots_left)),
        owed / quota_or_one,
        limited(owed / slots_left),
        admissible,
        limited(slots_served / quota_or_one),
    ];
    let around: [f32; 2 * PLACES - 1] = rate_features(rates, slot_rate_limit);
    let above = [rate_above, best_rate_above].map(|rate| rate_fraction(rate, slot_rate_limit));
    let rates: [f32; 2 * PLACES - 1 + ABOVE] = joined(&around, &above);
    joined(&numbers, &rates)
}

/// Returns the features of a sensor.
pub fn sensor_features(sensor: &[f32; SENSOR_COLUMNS]) -> [f32; SENSOR_FEATURES] {
    let &[east_m, north_m, received_snr_db] = sensor;
    let [east, north, distance] = place_features([east_m, north_m]);
    [east, north, distance, limited(received_snr_db / 20.0)]
}

/// Returns an offset and its length, in [`DISTANCE_UNIT_M`].
fn place_features([east_m, north_m]: [f32; 2]) -> [f32; 3] {
    [east_m, north_m, length([east_m, north_m])].map(|x| limited(x / DISTANCE_UNIT_M))
}

/// Returns the rates at the places as fractions of the limit, and how much they differ from the
/// rate at the first.
fn rate_features(rates: &[f32; PLACES], slot_rate_limit: f32) -> [f32; 2 * PLACES - 1] {
    let fractions = rates.map(|rate| rate_fraction(rate, slot_rate_limit));
    let [here, around @ ..] = fractions;
    let differences = around.map(|fraction| limited(DIFFERENCE_FACTOR * (fraction - here)));
    joined(&fractions, &differences)
}

/// Returns a rate as a fraction of the limit.
fn rate_fraction(rate: f32, slot_rate_limit: f32) -> f32 {
    limited(rate / slot_rate_limit.max(RATE_LIMIT_MIN))
}

fn length([x, y]: [f32; 2]) -> f32 {
    libm::sqrtf(x * x + y * y)
}

fn limited(x: f32) -> f32 {
    x.clamp(-LIMIT, LIMIT)
}

/// Returns the elements of both slices, which make the array.
fn joined<const N: usize>(first: &[f32], second: &[f32]) -> [f32; N] {
    let mut all = [0.0; N];
    for (entry, &x) in all.iter_mut().zip(first.iter().chain(second)) {
        *entry = x;
    }
    all
}
