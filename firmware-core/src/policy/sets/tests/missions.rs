// SPDX-License-Identifier: MIT OR Apache-2.0
//! Random missions, and states in the middle of them.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::vec::Vec as StdVec;

use crate::{
    Mission, Position, Scalar, Watt,
    inner::Workspace,
    mission::{Area, MissionParameters},
    policy::{Observation, sets::SetsObservation},
    shield::Agility,
    test_missions::table_one_without_nodes,
};

pub(super) type TestMission<T> = Mission<T, 16, 64>;
pub(super) type TestParameters = MissionParameters<f64, 16, 64>;

/// A state of a mission: the slot to plan, the vehicle's position, and the users' counts.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub(super) slot: u32,
    pub(super) east_m: f64,
    pub(super) north_m: f64,
    pub(super) counts: StdVec<u32>,
}

impl State {
    pub(super) fn observe<T: Scalar>(&self, mission: &TestMission<T>) -> SetsObservation {
        SetsObservation::new(
            mission,
            &self.observation(mission),
            &mut Workspace::default(),
        )
    }

    pub(super) fn observation<'s, T: Scalar>(
        &'s self,
        mission: &TestMission<T>,
    ) -> Observation<'s, T> {
        Observation {
            slot: self.slot,
            counts: &self.counts,
            rate: T::zero(),
            mse: T::zero(),
            position: Position::new(T::of(self.east_m), T::of(self.north_m)),
            agility: Agility::ideal(mission),
        }
    }
}

fn places(random: &mut Pcg64Mcg, count: usize, side_m: f64) -> StdVec<Position<f64>> {
    let mut along = || random.random_range(0.0..=side_m);
    (0..count)
        .map(|_| Position::new(along(), along()))
        .collect()
}

/// A mission from ranges as wide as those of `host-sim scenario random`.
pub(super) fn parameters(random: &mut Pcg64Mcg) -> TestParameters {
    let side_m: f64 = random.random_range(500.0..1600.0);
    let (users, sensors) = (random.random_range(1..=16), random.random_range(1..=64));
    let ends = places(random, 2, side_m);
    let speed_mps: f64 = random.random_range(10.0..40.0);
    let slots = random.random_range(30..=90);
    MissionParameters {
        slots,
        slot_duration_s: random.random_range(1.0..2.0),
        start: ends[0],
        destination: ends[1],
        area: Area {
            east_m: side_m,
            north_m: side_m,
        },
        altitude_m: random.random_range(60.0..150.0),
        max_speed_mps: speed_mps.max(1.5 * side_m / f64::from(slots)),
        noise_power: Watt::from_dbm(random.random_range(-100.0..-85.0)),
        mse_threshold: random.random_range(0.3..0.93) / sensors as f64,
        sensor_power_max: Watt(random.random_range(0.02..0.1)),
        user_power_max: Watt(random.random_range(0.1..0.4)),
        users: places(random, users, side_m).into_iter().collect(),
        sensors: places(random, sensors, side_m).into_iter().collect(),
        ..table_one_without_nodes()
    }
}

/// The same mission in another precision.
pub(super) fn mission<T: Scalar>(p: &TestParameters) -> TestMission<T> {
    let place = |place: &Position<f64>| place.map(T::of);
    let parameters = MissionParameters {
        slots: p.slots,
        slot_duration_s: T::of(p.slot_duration_s),
        start: place(&p.start),
        destination: place(&p.destination),
        area: Area {
            east_m: T::of(p.area.east_m),
            north_m: T::of(p.area.north_m),
        },
        altitude_m: T::of(p.altitude_m),
        max_speed_mps: T::of(p.max_speed_mps),
        carrier_hz: T::of(p.carrier_hz),
        noise_power: Watt(T::of(p.noise_power.0)),
        mse_threshold: T::of(p.mse_threshold),
        sensor_power_max: Watt(T::of(p.sensor_power_max.0)),
        user_power_max: Watt(T::of(p.user_power_max.0)),
        users: p.users.iter().map(place).collect(),
        sensors: p.sensors.iter().map(place).collect(),
        ..table_one_without_nodes()
    };
    Mission::new(parameters).expect("a valid mission")
}

/// A state anywhere in a mission, with counts that can occur.
pub(super) fn state(random: &mut Pcg64Mcg, p: &TestParameters) -> State {
    let slot = random.random_range(1..=p.slots);
    let mut counts = std::vec![0; p.users.len()];
    let quota = p.slots / p.users.len() as u32;
    for _ in 1..slot {
        let owed = |user: &usize| counts[*user] < quota;
        let users: StdVec<usize> = (0..p.users.len()).filter(owed).collect();
        let user = match users.len() {
            0 => random.random_range(0..p.users.len()),
            some => users[random.random_range(0..some)],
        };
        counts[user] += 1;
    }
    State {
        slot,
        east_m: random.random_range(0.0..=p.area.east_m),
        north_m: random.random_range(0.0..=p.area.north_m),
        counts,
    }
}
