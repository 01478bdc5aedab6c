// SPDX-License-Identifier: MIT OR Apache-2.0
//! Tests of the observation and of the features.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::{collections::HashSet, format, string::String, vec::Vec as StdVec};

use super::missions::{State, TestMission, TestParameters, mission, parameters, state};
use crate::{
    Mission, Position, PowerGain, Watt,
    channel::GroundNode,
    inner::{SlotLimits, Workspace},
    mission::{Area, MissionChange},
    policy::sets::{features::*, *},
    shield::Fairness,
    test_missions::table_one,
};

fn column(observation: &SetsObservation, name: &str) -> f32 {
    let index = MISSION_COLUMN_NAMES.iter().position(|&known| known == name);
    observation.mission[index.expect("a column")]
}

fn user_column(observation: &SetsObservation, user: usize, name: &str) -> f32 {
    let index = USER_COLUMN_NAMES.iter().position(|&known| known == name);
    observation.users[user][index.expect("a column")]
}

/// The optimal rate with the vehicle over `place`, from the definition.
fn rate(mission: &TestMission<f64>, user: usize, place: Position<f64>) -> f64 {
    let gains: StdVec<PowerGain<f64>> = mission
        .sensors()
        .map(|(sensor, _)| mission.power_gain(GroundNode::Sensor(sensor), &place))
        .collect();
    let mut workspace = Workspace::<f64, 64>::default();
    let field = workspace.sensors(&SlotLimits::of_mission(mission), &gains);
    let gain = mission.power_gain(GroundNode::User(user), &place);
    field.expect("valid").rate(gain)
}

#[track_caller]
fn assert_close(got: f32, expected: f64, tolerance: f64) {
    let error = (f64::from(got) - expected).abs();
    assert!(
        error <= tolerance * expected.abs().max(1.0),
        "{got} {expected}"
    );
}

#[test]
fn columns_have_different_names() {
    fn differ(names: &[&str]) -> bool {
        names.iter().collect::<HashSet<_>>().len() == names.len()
    }
    assert!(differ(&MISSION_COLUMN_NAMES));
    assert!(differ(&USER_COLUMN_NAMES));
    assert!(differ(&SENSOR_COLUMN_NAMES));
}

/// Table I, before slot 51: each column from its definition.
#[test]
fn columns_are_what_their_names_say() {
    let mission = table_one::<f64>();
    let mut counts = std::vec![4; 15];
    (counts[3], counts[7], counts[8]) = (1, 2, 0);
    // 50 slots are done: 10 are left, 3 + 2 + 4 are owed.
    (counts[0], counts[1]) = (3, 4);
    let state = State {
        slot: 51,
        east_m: 990.0,
        north_m: 940.0,
        counts,
    };
    let observation = state.observe(&mission);
    for (name, expected) in [
        ("destination_east_m", -40.0),
        ("destination_north_m", 10.0),
        ("vehicle_east_m", 990.0),
        ("vehicle_north_m", 940.0),
        ("area_east_m", 1000.0),
        ("area_north_m", 1000.0),
        ("altitude_m", 100.0),
        ("reach_m", 30.0),
        ("slots", 60.0),
        ("slots_left", 10.0),
        ("slots_owed", 10.0),
        ("quota_slots", 4.0),
        ("users", 15.0),
        ("sensors", 36.0),
        ("mse_threshold", 0.015),
        ("slot_rate_limit", -(1.0_f64 - 36.0 * 0.015).log2()),
        ("noise_dbm", -95.0),
        ("user_power_max_dbm", 10.0 * 200.0_f64.log10()),
        ("sensor_power_max_dbm", 10.0 * 50.0_f64.log10()),
    ] {
        assert_close(column(&observation, name), expected, 1e-6);
    }
    let at = |radius_m: f64, angle: f64| {
        let (sin, cos) = angle.to_radians().sin_cos();
        Position::new(
            (990.0 + radius_m * cos).clamp(0.0, 1000.0),
            (940.0 + radius_m * sin).clamp(0.0, 1000.0),
        )
    };
    let directions = [
        "east",
        "north_east",
        "north",
        "north_west",
        "west",
        "south_west",
        "south",
        "south_east",
    ];
    let mut places = std::vec![(String::from("here"), Position::new(990.0, 940.0))];
    for (suffix, radius_m) in [("", 30.0), ("_3", 90.0), ("_8", 240.0)] {
        for (direction, angle) in directions.iter().zip((0..).map(|n| 45.0 * f64::from(n))) {
            places.push((format!("{direction}{suffix}"), at(radius_m, angle)));
        }
    }
    assert_eq!(places.len(), PLACES);
    for (name, place) in places {
        let rates: StdVec<f64> = (0..15).map(|user| rate(&mission, user, place)).collect();
        for (user, &rate) in rates.iter().enumerate() {
            let got = user_column(&observation, user, &format!("rate_{name}"));
            assert_close(got, rate, 1e-6);
        }
        // All slots that are left are owed: to four users.
        let best = [0, 3, 7, 8]
            .map(|user| rates[user])
            .into_iter()
            .fold(0.0, f64::max);
        let got = column(&observation, &format!("best_rate_{name}"));
        assert_close(got, best, 1e-6);
        assert!(best > 0.0);
    }
    for (user, ground) in mission.users() {
        let got = |name| user_column(&observation, user, name);
        assert_close(got("east_m"), ground.x - 990.0, 1e-6);
        assert_close(got("north_m"), ground.y - 940.0, 1e-6);
        assert_eq!(got("slots_served"), state.counts[user] as f32);
        assert_eq!(got("quota_slots"), 4.0);
        let owed = [0, 3, 7, 8].contains(&user);
        assert_eq!(got("admissible"), f32::from(u8::from(owed)));
        assert_close(got("rate_above"), rate(&mission, user, *ground), 1e-6);
        let best = [0, 3, 7, 8].map(|other| rate(&mission, other, *ground));
        let best = best.into_iter().fold(0.0, f64::max);
        assert_close(got("best_rate_above"), best, 1e-6);
    }
    for (sensor, ground) in mission.sensors() {
        let [east_m, north_m, received_snr_db] = observation.sensors[sensor];
        assert_close(east_m, ground.x - 990.0, 1e-6);
        assert_close(north_m, ground.y - 940.0, 1e-6);
        let gain = mission.power_gain(GroundNode::Sensor(sensor), &Position::new(990.0, 940.0));
        let snr = 0.05 * gain.0 / Watt::<f64>::from_dbm(-95.0).0;
        assert_close(received_snr_db, 10.0 * snr.log10(), 1e-6);
    }
    assert_eq!((observation.user_count, observation.sensor_count), (15, 36));
    assert_eq!(observation.users[15], [0.0; USER_COLUMNS]);
    assert_eq!(observation.sensors[36..], [[0.0; SENSOR_COLUMNS]; 28]);
}

fn all_features(observation: &SetsObservation) -> StdVec<f32> {
    let mission = &observation.mission;
    let mut all = mission_features(mission).to_vec();
    for user in observation.user_rows() {
        all.extend(user_features(mission, user));
    }
    for sensor in observation.sensor_rows() {
        all.extend(sensor_features(sensor));
    }
    all
}

/// Features of random missions are finite, within the limit, and mostly below 3; single precision
/// gives the same columns as double.
#[test]
fn features_of_random_missions_are_about_one() {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let (mut large, mut total) = (0, 0);
    for _ in 0..300 {
        let p = parameters(&mut random);
        let state = state(&mut random, &p);
        let double = state.observe(&mission::<f64>(&p));
        for feature in all_features(&double) {
            assert!(feature.abs() <= LIMIT, "{feature} {p:?}");
            large += usize::from(feature.abs() > 3.0);
            total += 1;
        }
        let single = state.observe(&mission::<f32>(&p));
        let pairs = all_features(&double).into_iter().zip(all_features(&single));
        for (index, (double, single)) in pairs.enumerate() {
            assert!(
                (double - single).abs() <= 2e-3,
                "{index}: {double} {single}"
            );
        }
    }
    assert!(
        large * 100 < total,
        "{large} of {total} features are above 3"
    );
}

/// Valid missions at the ends of what is valid.
fn extreme_missions() -> StdVec<TestParameters> {
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let usual = parameters(&mut random);
    let with = |change: &dyn Fn(&mut TestParameters)| {
        let mut p = usual.clone();
        change(&mut p);
        p
    };
    let stretched = |p: &mut TestParameters, factor: f64| {
        let stretch = |place: &mut Position<f64>| place.coords *= factor;
        p.users.iter_mut().for_each(stretch);
        p.sensors.iter_mut().for_each(stretch);
        [&mut p.start, &mut p.destination]
            .into_iter()
            .for_each(stretch);
        let Area { east_m, north_m } = &mut p.area;
        (*east_m, *north_m) = (*east_m * factor, *north_m * factor);
        p.max_speed_mps *= factor;
    };
    std::vec![
        with(&|p| stretched(p, 600.0)),
        with(&|p| stretched(p, 1e-6)),
        with(&|p| p.slots = 100_000),
        with(&|p| (p.slots, p.max_speed_mps) = (1, 1e6)),
        with(&|p| p.altitude_m = 1.0),
        with(&|p| p.altitude_m = 20_000.0),
        with(&|p| p.carrier_hz = 1e12),
        with(&|p| p.noise_power = Watt(1e-37)),
        with(&|p| p.noise_power = Watt(1e6)),
        with(&|p| p.mse_threshold = 1e-30),
        with(&|p| p.mse_threshold *= 0.9999999 / (p.mse_threshold * p.sensors.len() as f64)),
        with(&|p| (p.user_power_max, p.sensor_power_max) = (Watt(1e6), Watt(1e6))),
        with(&|p| (p.user_power_max, p.sensor_power_max) = (Watt(1e-30), Watt(1e-30))),
        with(&|p| (p.max_speed_mps, p.slots, p.destination) = (1e-30, 3, p.start)),
    ]
}

#[test]
fn features_of_extreme_missions_are_finite() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    for (index, p) in extreme_missions().into_iter().enumerate() {
        for _ in 0..5 {
            let state = state(&mut random, &p);
            let (double, single) = (mission::<f64>(&p), mission::<f32>(&p));
            for observation in [state.observe(&double), state.observe(&single)] {
                let columns = observation.mission.iter();
                let columns = columns.chain(observation.users.iter().flatten());
                let mut columns = columns.chain(observation.sensors.iter().flatten());
                assert!(columns.all(|column| column.is_finite()), "{index}");
                let within = |feature: &f32| feature.abs() <= LIMIT;
                assert!(all_features(&observation).iter().all(within), "{index}");
            }
        }
    }
}

/// A slot after the last one, and a vehicle outside the area, have an observation, too.
#[test]
fn states_outside_the_mission_are_observed() {
    let mission = table_one::<f32>();
    for (slot, east_m) in [(0, -50.0), (61, 1100.0), (u32::MAX, 5.0)] {
        let state = State {
            slot,
            east_m,
            north_m: 20.0,
            counts: std::vec![9; 20],
        };
        let observation = state.observe(&mission);
        assert!(all_features(&observation).iter().all(|x| x.abs() <= LIMIT));
        let left = if slot == 0 { 60.0 } else { 0.0 };
        assert_eq!(column(&observation, "slots_left"), left);
    }
}

/// A permutation of the users permutes their rows, and one of the sensors theirs; all else stays.
#[test]
fn permutations_permute_rows() {
    let mut random = Pcg64Mcg::seed_from_u64(4);
    for _ in 0..50 {
        let p = parameters(&mut random);
        let state = state(&mut random, &p);
        let plain = state.observe(&mission::<f64>(&p));
        let mut permuted = (p.clone(), state.clone());
        permuted.0.users.reverse();
        permuted.1.counts.reverse();
        let mut users = permuted.1.observe(&mission::<f64>(&permuted.0));
        users.users[..p.users.len()].reverse();
        assert_eq!(users, plain);
        permuted.0.sensors.reverse();
        let mut both = permuted.1.observe(&mission::<f64>(&permuted.0));
        both.users[..p.users.len()].reverse();
        both.sensors[..p.sensors.len()].reverse();
        assert_eq!(both.sensors, plain.sensors);
        // The sums over sensors are rounded in their sorted order.
        assert_eq!(both, plain);
    }
}

/// Users and sensors that left have no row, those that joined have the last.
#[test]
fn changes_are_observed() {
    let mut mission = table_one::<f64>();
    let position_m = Position::new(321.0, 123.0);
    for change in [
        MissionChange::UserLeft { user: 2 },
        MissionChange::User {
            user: 15,
            position_m,
        },
        MissionChange::SensorLeft { sensor: 0 },
        MissionChange::MseThreshold(0.011),
        MissionChange::MaxSpeed(17.0),
        MissionChange::Slots(50),
    ] {
        mission.change(&change, 20).expect("valid");
    }
    let mut counts: StdVec<u32> = (0..16).map(|user| user % 3).collect();
    counts[15] = 0;
    let state = State {
        slot: 22,
        east_m: 300.0,
        north_m: 100.0,
        counts,
    };
    let observation = state.observe(&mission);
    assert_eq!((observation.user_count, observation.sensor_count), (15, 35));
    assert_eq!(user_column(&observation, 1, "slots_served"), 1.0);
    // Row 2 is user 3, row 14 is user 15.
    assert_eq!(user_column(&observation, 2, "slots_served"), 0.0);
    assert_eq!(user_column(&observation, 14, "east_m"), 21.0);
    assert_eq!(user_column(&observation, 14, "quota_slots"), 2.0);
    assert_eq!(user_column(&observation, 0, "quota_slots"), 3.0);
    let sensor = mission.parameters().sensors[1];
    assert_eq!(f64::from(observation.sensors[0][0]), sensor.x - 300.0);
    assert_close(column(&observation, "mse_threshold"), 0.011, 1e-6);
    assert_eq!(column(&observation, "reach_m"), 17.0);
    assert_eq!(column(&observation, "slots"), 50.0);
    assert_eq!(column(&observation, "users"), 15.0);
    assert_eq!(column(&observation, "sensors"), 35.0);
    let fairness = Fairness::<16>::of_state(&mission, &state.counts, 21);
    assert_eq!(column(&observation, "slots_owed"), fairness.owed() as f32);
}

/// More users than there are rows: the first of them are observed.
#[test]
fn larger_capacities_are_cut() {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let mut place = || Position::new(random.random_range(0.0..900.0), 500.0);
    let mission = Mission::new(crate::mission::MissionParameters::<f32, 40, 100> {
        users: (0..20).map(|_| place()).collect(),
        sensors: (0..70).map(|_| place()).collect(),
        mse_threshold: 0.01,
        ..crate::test_missions::table_one_without_nodes()
    })
    .expect("valid");
    let observation = crate::policy::Observation {
        slot: 1,
        counts: &[0; 20],
        rate: 0.0,
        mse: 0.0,
        position: Position::new(50.0, 50.0),
        agility: crate::shield::Agility::ideal(&mission),
    };
    let observed = SetsObservation::new(&mission, &observation, &mut Workspace::default());
    assert_eq!(
        (observed.user_count, observed.sensor_count),
        (USERS, SENSORS)
    );
    assert!(all_features(&observed).iter().all(|x| x.abs() <= LIMIT));
}
