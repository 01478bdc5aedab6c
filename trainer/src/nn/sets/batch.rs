//! The inputs of a batch: the rows of all states, one after the other.

use super::{super::product::padded, layout::FeatureSizes};

/// The inputs of one state.
#[derive(Clone, Copy, Debug)]
pub struct SetState<'a> {
    /// The features of the mission.
    pub mission: &'a [f32],
    /// The features of all users, user by user.
    pub users: &'a [f32],
    /// The features of all sensors, sensor by sensor.
    pub sensors: &'a [f32],
    /// `(user - vehicle) / reach` of every user: the displacement to it in units of the way of a
    /// slot.
    pub to_users: &'a [[f32; 2]],
    /// `(destination - vehicle) / reach`.
    pub to_destination: [f32; 2],
}

/// The inputs of a batch.
#[derive(Clone, Debug)]
pub struct SetBatch {
    features: FeatureSizes,
    /// Features of the missions, one row per state, not padded.
    pub(super) mission: Vec<f32>,
    /// Features of the users of all states, rows padded.
    pub(super) users: Vec<f32>,
    /// Features of the sensors of all states, rows padded.
    pub(super) sensors: Vec<f32>,
    pub(super) to_users: Vec<[f32; 2]>,
    pub(super) to_destination: Vec<[f32; 2]>,
    /// The first user of each state, and the number of all users.
    pub(super) first_user: Vec<usize>,
    /// The first sensor of each state, and the number of all sensors.
    pub(super) first_sensor: Vec<usize>,
}

impl SetBatch {
    /// Creates an empty batch.
    pub fn new(features: FeatureSizes) -> Self {
        Self {
            features,
            mission: Vec::new(),
            users: Vec::new(),
            sensors: Vec::new(),
            to_users: Vec::new(),
            to_destination: Vec::new(),
            first_user: vec![0],
            first_sensor: vec![0],
        }
    }

    /// Removes all states.
    pub fn clear(&mut self) {
        self.mission.clear();
        self.users.clear();
        self.sensors.clear();
        self.to_users.clear();
        self.to_destination.clear();
        self.first_user.truncate(1);
        self.first_sensor.truncate(1);
    }

    /// Adds a state.
    ///
    /// # Panics
    /// If the length of a slice does not fit, or there is no user or no sensor.
    pub fn push(&mut self, state: &SetState<'_>) {
        let FeatureSizes {
            mission,
            user,
            sensor,
        } = self.features;
        assert_eq!(state.mission.len(), mission);
        assert_eq!(state.users.len(), user * state.to_users.len());
        assert_eq!(state.sensors.len() % sensor, 0);
        assert!(!state.users.is_empty() && !state.sensors.is_empty());
        self.mission.extend_from_slice(state.mission);
        push_rows(&mut self.users, state.users, user);
        push_rows(&mut self.sensors, state.sensors, sensor);
        self.to_users.extend_from_slice(state.to_users);
        self.to_destination.push(state.to_destination);
        self.first_user.push(self.to_users.len());
        let sensors = self.sensors.len() / padded(sensor);
        self.first_sensor.push(sensors);
    }

    /// Replaces the content by the states of another batch, with `more` features of each mission after
    /// its own.
    ///
    /// # Panics
    /// If the numbers of features or states do not fit.
    pub fn extend_missions<const N: usize>(&mut self, other: &Self, more: &[[f32; N]]) {
        let features = other.features;
        let extended = FeatureSizes {
            mission: features.mission + N,
            ..features
        };
        assert_eq!((self.features, other.len()), (extended, more.len()));
        self.clear();
        for (row, more) in other.mission.chunks_exact(features.mission).zip(more) {
            self.mission.extend_from_slice(row);
            self.mission.extend_from_slice(more);
        }
        self.users.extend_from_slice(&other.users);
        self.sensors.extend_from_slice(&other.sensors);
        self.to_users.extend_from_slice(&other.to_users);
        self.to_destination.extend_from_slice(&other.to_destination);
        self.first_user.clone_from(&other.first_user);
        self.first_sensor.clone_from(&other.first_sensor);
    }

    /// Returns the number of states.
    pub fn len(&self) -> usize {
        self.to_destination.len()
    }

    /// Returns whether there is no state.
    pub fn is_empty(&self) -> bool {
        self.to_destination.is_empty()
    }

    /// Returns the number of users of all states.
    pub fn users(&self) -> usize {
        self.to_users.len()
    }

    /// Returns the number of sensors of all states.
    pub fn sensors(&self) -> usize {
        self.first_sensor[self.len()]
    }

    /// Returns the number of tokens: one per state and one per user.
    pub fn tokens(&self) -> usize {
        self.len() + self.users()
    }

    /// Returns the users of a state as a range of all users.
    pub fn users_of(&self, state: usize) -> std::ops::Range<usize> {
        self.first_user[state]..self.first_user[state + 1]
    }

    /// Returns the sensors of a state as a range of all sensors.
    pub fn sensors_of(&self, state: usize) -> std::ops::Range<usize> {
        self.first_sensor[state]..self.first_sensor[state + 1]
    }

    /// Returns the tokens of a state as a range of all tokens; the first one is the mission's.
    pub fn tokens_of(&self, state: usize) -> std::ops::Range<usize> {
        self.first_user[state] + state..self.first_user[state + 1] + state + 1
    }
}

fn push_rows(to: &mut Vec<f32>, rows: &[f32], len: usize) {
    for row in rows.chunks_exact(len) {
        to.extend_from_slice(row);
        to.extend(std::iter::repeat_n(0.0, padded(len) - len));
    }
}
