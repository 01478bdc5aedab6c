// SPDX-License-Identifier: MIT OR Apache-2.0
//! The observation of a mission as sets.

use super::columns::{
    MISSION_COLUMNS, PLACES, RINGS, SENSOR_COLUMNS, SENSORS, USER_COLUMNS, USERS,
};
use crate::{
    inner::{SlotLimits, Workspace},
    mission::Mission,
    place_rates::{MissionGains, PlaceRates},
    policy::Observation,
    scalar::{Displacement, Position, Scalar},
    shield::Fairness,
    units::Watt,
};

/// The least reach that is observed, metres: quotients by it stay finite.
const REACH_MIN_M: f64 = 1e-3;

/// The least power gain that is observed. Its logarithm is finite.
const POWER_GAIN_MIN: f64 = 1e-30;

/// `1 / sqrt(2)`.
const DIAGONAL: f64 = core::f64::consts::FRAC_1_SQRT_2;

/// The directions of the places on a ring, east and north.
const DIRECTIONS: [[f64; 2]; 8] = [
    [1.0, 0.0],
    [DIAGONAL, DIAGONAL],
    [0.0, 1.0],
    [-DIAGONAL, DIAGONAL],
    [-1.0, 0.0],
    [-DIAGONAL, -DIAGONAL],
    [0.0, -1.0],
    [DIAGONAL, -DIAGONAL],
];

/// The state of a mission before a slot, in raw units. The columns are named in the
/// [module](super).
///
/// Users and sensors that are there come first, in the order of their numbers; rows beyond them are
/// zero and have no effect.
#[derive(Clone, Debug, PartialEq)]
pub struct SetsObservation {
    /// The columns of the mission.
    pub mission: [f32; MISSION_COLUMNS],
    /// The columns of each user.
    pub users: [[f32; USER_COLUMNS]; USERS],
    /// The columns of each sensor.
    pub sensors: [[f32; SENSOR_COLUMNS]; SENSORS],
    /// `M`, the number of users that are there.
    pub user_count: usize,
    /// `J`, the number of sensors that are there.
    pub sensor_count: usize,
}

impl Default for SetsObservation {
    fn default() -> Self {
        Self {
            mission: [0.0; MISSION_COLUMNS],
            users: [[0.0; USER_COLUMNS]; USERS],
            sensors: [[0.0; SENSOR_COLUMNS]; SENSORS],
            user_count: 0,
            sensor_count: 0,
        }
    }
}

impl SetsObservation {
    /// Returns the observation of a mission, with all changes that were made, before the slot that
    /// `observation` names. Gains come from the mission's channel model or map.
    ///
    /// All columns are finite if the position is. Users beyond the first [`USERS`] that are there
    /// and sensors beyond the first [`SENSORS`] have no row.
    ///
    /// Worst case: `(25 + M) (M + J)` evaluations of the channel model, and `25 + M` sorts of `J`
    /// sensors.
    pub fn new<T: Scalar, const M: usize, const J: usize>(
        mission: &Mission<T, M, J>,
        observation: &Observation<'_, T>,
        workspace: &mut Workspace<T, J>,
    ) -> Self {
        let mut sets = Self::default();
        let here = observation.position;
        let reach_m = observation.agility.sound(mission).step_m;
        let reach_m = reach_m.max(T::of(REACH_MIN_M));
        let fairness = fairness(mission, observation);
        sets.write_users(mission, &here, &fairness);
        sets.write_rates(mission, &here, reach_m, workspace);
        sets.write_mission(mission, observation, reach_m, &fairness);
        sets
    }

    /// Returns an observation of so many users and sensors from its columns: those of the mission,
    /// then those of each user and of each sensor. Missing numbers are 0.
    pub fn of_columns(
        [user_count, sensor_count]: [usize; 2],
        mut numbers: impl Iterator<Item = f32>,
    ) -> Self {
        let mut sets = Self {
            user_count: user_count.min(USERS),
            sensor_count: sensor_count.min(SENSORS),
            ..Self::default()
        };
        let users = sets.users.iter_mut().take(user_count).flatten();
        let sensors = sets.sensors.iter_mut().take(sensor_count).flatten();
        // Number by number: a column that is left over takes none.
        for column in sets.mission.iter_mut().chain(users).chain(sensors) {
            *column = numbers.next().unwrap_or(0.0);
        }
        sets
    }

    /// Returns the reach, metres.
    pub(super) fn reach_m(&self) -> f32 {
        let [_, _, _, _, _, _, _, reach_m, ..] = self.mission;
        reach_m
    }

    /// Returns the rows of the users that are there.
    pub fn user_rows(&self) -> &[[f32; USER_COLUMNS]] {
        self.users.get(..self.user_count).unwrap_or(&self.users)
    }

    /// Returns the rows of the sensors that are there.
    pub fn sensor_rows(&self) -> &[[f32; SENSOR_COLUMNS]] {
        self.sensors
            .get(..self.sensor_count)
            .unwrap_or(&self.sensors)
    }

    /// Writes position, quota and admissibility of the users.
    fn write_users<T: Scalar, const M: usize, const J: usize>(
        &mut self,
        mission: &Mission<T, M, J>,
        here: &Position<T>,
        fairness: &Fairness<M>,
    ) {
        let mut admissible = [false; M];
        for user in fairness.admissible() {
            if let Some(admissible) = admissible.get_mut(user) {
                *admissible = true;
            }
        }
        self.user_count = 0;
        for ((user, ground), row) in mission.users().zip(&mut self.users) {
            let [east, north, served, quota, may, ..] = row;
            [*east, *north] = relative(ground, here);
            *served = fairness.counts().get(user).copied().unwrap_or(0) as f32;
            *quota = fairness.quota(user).unwrap_or(0) as f32;
            *may = f32::from(u8::from(admissible.get(user) == Some(&true)));
            self.user_count += 1;
        }
    }

    /// Writes the rates of the users at all places, and the sensors.
    fn write_rates<T: Scalar, const M: usize, const J: usize>(
        &mut self,
        mission: &Mission<T, M, J>,
        here: &Position<T>,
        reach_m: T,
        workspace: &mut Workspace<T, J>,
    ) {
        let p = mission.parameters();
        let mut rates = PlaceRates {
            mission,
            limits: &SlotLimits::of_mission(mission),
            gains: MissionGains,
            workspace,
        };
        let mut amplitudes = [T::zero(); J];
        let sensors = rates.sensor_amplitudes(here, &mut amplitudes);
        let full_power_db = decibels(p.sensor_power_max.0) - decibels(p.noise_power.0);
        self.sensor_count = 0;
        for (((_, ground), amplitude), row) in mission.sensors().zip(sensors).zip(&mut self.sensors)
        {
            let gain = (*amplitude * *amplitude).max(T::of(POWER_GAIN_MIN));
            let [east, north, received_snr_db] = row;
            [*east, *north] = relative(ground, here);
            *received_snr_db = single(full_power_db + decibels(gain));
            self.sensor_count += 1;
        }
        let users = || mission.users().map(|(user, _)| user);
        for (index, offset) in places().enumerate() {
            let step = Displacement::from(offset.map(T::of)) * reach_m;
            let place = p.area.nearest(&(here + step));
            let mut rows = self.users.iter_mut();
            rates.each(&place, users(), |_, rate| {
                if let Some([_, _, _, _, _, rates @ .., _, _]) = rows.next()
                    && let Some(entry) = rates.get_mut(index)
                {
                    *entry = single(rate);
                }
            });
        }
        let admissible = self.users.map(|[_, _, _, _, admissible, ..]| admissible);
        let rows = self.users.iter_mut().enumerate();
        for ((_, ground), (index, row)) in mission.users().zip(rows) {
            let [.., own, best] = row;
            let mut flags = admissible.iter().enumerate();
            rates.each(&p.area.nearest(ground), users(), |_, rate| {
                if let Some((other, admissible)) = flags.next() {
                    let rate = single(rate);
                    *best = best.max(admissible * rate);
                    if other == index {
                        *own = rate;
                    }
                }
            });
        }
    }

    /// Writes the columns of the mission, from those of the users among others.
    fn write_mission<T: Scalar, const M: usize, const J: usize>(
        &mut self,
        mission: &Mission<T, M, J>,
        observation: &Observation<'_, T>,
        reach_m: T,
        fairness: &Fairness<M>,
    ) {
        let p = mission.parameters();
        let here = observation.position;
        let dbm = |power: Watt<T>| single(decibels(power.0) + T::of(30.0));
        let (users, slots) = (mission.users().count() as u32, mission.slots());
        let slots_left = slots.saturating_sub(slots_done(observation));
        let [destination_east_m, destination_north_m] = relative(&p.destination, &here);
        let numbers = [
            destination_east_m,
            destination_north_m,
            single(here.x),
            single(here.y),
            single(p.area.east_m),
            single(p.area.north_m),
            single(p.altitude_m),
            single(reach_m),
            slots as f32,
            slots_left as f32,
            fairness.owed() as f32,
            slots.checked_div(users).unwrap_or(0) as f32,
            self.user_count as f32,
            self.sensor_count as f32,
            single(p.mse_threshold),
            single(mission.slot_rate_limit()),
            dbm(p.noise_power),
            dbm(p.user_power_max),
            dbm(p.sensor_power_max),
        ];
        let mut best = [0.0_f32; PLACES];
        for &[_, _, _, _, admissible, ref rates @ .., _, _] in self.user_rows() {
            for (best, &rate) in best.iter_mut().zip(rates) {
                *best = best.max(admissible * rate);
            }
        }
        for (column, number) in self.mission.iter_mut().zip(numbers.into_iter().chain(best)) {
            *column = number;
        }
    }
}

/// Returns the places relative to the vehicle, in units of the reach, east and north.
fn places() -> impl Iterator<Item = [f64; 2]> {
    let on = |radius: f64| DIRECTIONS.map(|direction| direction.map(|x| radius * x));
    core::iter::once([0.0, 0.0]).chain(RINGS.into_iter().flat_map(on))
}

/// Returns the number of slots that are done.
fn slots_done<T: Scalar>(observation: &Observation<'_, T>) -> u32 {
    observation.slot.saturating_sub(1)
}

/// Returns who may be served in the slot that `observation` names.
fn fairness<T: Scalar, const M: usize, const J: usize>(
    mission: &Mission<T, M, J>,
    observation: &Observation<'_, T>,
) -> Fairness<M> {
    Fairness::of_state(mission, observation.counts, slots_done(observation))
}

/// Returns the position of `place` relative to `here`, metres.
fn relative<T: Scalar>(place: &Position<T>, here: &Position<T>) -> [f32; 2] {
    let offset = place - here;
    [single(offset.x), single(offset.y)]
}

/// Returns ten times the decimal logarithm.
fn decibels<T: Scalar>(ratio: T) -> T {
    ratio.log10() * T::of(10.0)
}

fn single<T: Scalar>(value: T) -> f32 {
    value.to_f64() as f32
}
