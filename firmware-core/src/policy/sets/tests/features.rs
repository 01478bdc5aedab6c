// SPDX-License-Identifier: MIT OR Apache-2.0
//! The features are those of the tables in `docs/training.md`.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use std::{format, string::String, vec::Vec as StdVec};

use super::missions::{mission, parameters, state};
use crate::policy::sets::{features::*, *};

const DIRECTIONS: [&str; 8] = [
    "east",
    "north_east",
    "north",
    "north_west",
    "west",
    "south_west",
    "south",
    "south_east",
];

fn place_names() -> StdVec<String> {
    let ring = |suffix: &'static str| DIRECTIONS.map(|name| format!("{name}{suffix}"));
    let rings = ["", "_3", "_8"].into_iter().flat_map(ring);
    std::iter::once("here".into()).chain(rings).collect()
}

/// A row of columns, by their names, in double precision.
struct Row<'a>(&'a [&'a str], &'a [f32]);

impl Row<'_> {
    fn get(&self, name: &str) -> f64 {
        let index = self.0.iter().position(|&known| known == name);
        self.1[index.expect("a column")].into()
    }

    /// The features of the rates, whose columns begin with `prefix`.
    fn rates(&self, prefix: &str, limit: f64) -> StdVec<f64> {
        let rate = |place: &String| self.get(&format!("{prefix}{place}"));
        let fraction = |place| clip(rate(place) / limit.max(1e-6));
        let fractions: StdVec<f64> = place_names().iter().map(fraction).collect();
        let differences = fractions[1..]
            .iter()
            .map(|f| clip(5.0 * (f - fractions[0])));
        fractions.iter().copied().chain(differences).collect()
    }
}

fn clip(x: f64) -> f64 {
    x.clamp(-5.0, 5.0)
}

fn place(east_m: f64, north_m: f64) -> StdVec<f64> {
    let length_m = east_m.hypot(north_m);
    [east_m, north_m, length_m]
        .map(|x| clip(x / 500.0))
        .to_vec()
}

#[track_caller]
fn assert_equal(got: &[f32], expected: &[f64]) {
    assert_eq!(got.len(), expected.len());
    for (index, (&got, &expected)) in got.iter().zip(expected).enumerate() {
        let error = (f64::from(got) - expected).abs();
        assert!(error < 2e-6, "{index}: {got} {expected}");
    }
}

#[test]
fn features_are_those_of_the_documentation() {
    let mut random = Pcg64Mcg::seed_from_u64(41);
    for _ in 0..100 {
        let p = parameters(&mut random);
        let observation = state(&mut random, &p).observe(&mission::<f32>(&p));
        let m = Row(&MISSION_COLUMN_NAMES, &observation.mission);
        let (reach, left) = (m.get("reach_m"), m.get("slots_left").max(1.0));
        let (to_east, to_north) = (m.get("destination_east_m"), m.get("destination_north_m"));
        let border = |x: f64| (x / (5.0 * reach)).tanh();
        let power = |name| clip((m.get(name) - m.get("noise_dbm") - 110.0) / 10.0);
        let mut expected = place(to_east, to_north);
        expected.extend([
            clip(to_east.hypot(to_north) / (reach * left)),
            m.get("slots_left") / m.get("slots"),
            clip(m.get("slots_left") / 50.0),
            clip(reach / 30.0),
            m.get("sensors") * m.get("mse_threshold"),
            m.get("sensors") / 64.0,
            m.get("users") / 16.0,
            clip(m.get("slot_rate_limit") / 2.0),
            clip((m.get("slots_left") - m.get("slots_owed")) / left),
            clip(m.get("quota_slots") / 8.0),
            clip(m.get("altitude_m") / 100.0),
            border(m.get("vehicle_east_m")),
            border(m.get("vehicle_north_m")),
            border(m.get("area_east_m") - m.get("vehicle_east_m")),
            border(m.get("area_north_m") - m.get("vehicle_north_m")),
            power("user_power_max_dbm"),
            power("sensor_power_max_dbm"),
        ]);
        let limit = m.get("slot_rate_limit");
        expected.extend(m.rates("best_rate_", limit));
        assert_equal(&mission_features(&observation.mission), &expected);
        for user in observation.user_rows() {
            let u = Row(&USER_COLUMN_NAMES, user);
            let (east, north) = (u.get("east_m"), u.get("north_m"));
            let (served, quota) = (u.get("slots_served"), u.get("quota_slots"));
            let owed = (quota - served).max(0.0);
            let mut expected = place(east, north);
            expected.extend([
                clip((east - to_east) / 500.0),
                clip((north - to_north) / 500.0),
                (east.hypot(north) / (reach * left)).tanh(),
                owed / quota.max(1.0),
                clip(owed / left),
                u.get("admissible"),
                clip(served / quota.max(1.0)),
            ]);
            expected.extend(u.rates("rate_", limit));
            let above = ["rate_above", "best_rate_above"];
            expected.extend(above.map(|name| clip(u.get(name) / limit.max(1e-6))));
            assert_equal(&user_features(&observation.mission, user), &expected);
        }
        for sensor in observation.sensor_rows() {
            let s = Row(&SENSOR_COLUMN_NAMES, sensor);
            let mut expected = place(s.get("east_m"), s.get("north_m"));
            expected.push(clip(s.get("received_snr_db") / 20.0));
            assert_equal(&sensor_features(sensor), &expected);
        }
    }
}
