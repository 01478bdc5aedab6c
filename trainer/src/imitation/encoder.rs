//! A state as the inputs of the network.

use firmware_core::{
    SENSORS_MAX,
    inner::Workspace,
    policy::{
        Observation,
        sets::{SetsObservation, features},
    },
};
use scenario::HostMission;

use crate::nn::sets::{FeatureSizes, batch::SetState};

/// The numbers of features of an observation.
pub const FEATURES: FeatureSizes = FeatureSizes {
    mission: features::MISSION_FEATURES,
    user: features::USER_FEATURES,
    sensor: features::SENSOR_FEATURES,
};

/// Turns observations into the inputs of the network.
#[derive(Debug)]
pub struct Encoder {
    workspace: Workspace<f64, SENSORS_MAX>,
    mission: [f32; features::MISSION_FEATURES],
    users: Vec<f32>,
    sensors: Vec<f32>,
    to_users: Vec<[f32; 2]>,
    to_destination: [f32; 2],
    reach_m: f32,
    admissible: Vec<bool>,
}

impl Default for Encoder {
    fn default() -> Self {
        Self {
            workspace: Workspace::default(),
            mission: [0.0; features::MISSION_FEATURES],
            users: Vec::new(),
            sensors: Vec::new(),
            to_users: Vec::new(),
            to_destination: [0.0; 2],
            reach_m: 1.0,
            admissible: Vec::new(),
        }
    }
}

impl Encoder {
    /// Computes the inputs of a state.
    pub fn encode(&mut self, mission: &HostMission, observation: &Observation<'_, f64>) {
        let sets = SetsObservation::new(mission, observation, &mut self.workspace);
        let &[to_east_m, to_north_m, _, _, _, _, _, reach_m, ..] = &sets.mission;
        self.mission = features::mission_features(&sets.mission);
        self.reach_m = reach_m;
        self.to_destination = [to_east_m / reach_m, to_north_m / reach_m];
        self.users.clear();
        self.sensors.clear();
        self.to_users.clear();
        self.admissible.clear();
        for user in sets.user_rows() {
            let &[east_m, north_m, _, _, admissible, ..] = user;
            let features = features::user_features(&sets.mission, user);
            self.users.extend_from_slice(&features);
            self.to_users.push([east_m / reach_m, north_m / reach_m]);
            self.admissible.push(admissible > 0.0);
        }
        for sensor in sets.sensor_rows() {
            self.sensors
                .extend_from_slice(&features::sensor_features(sensor));
        }
    }

    /// Returns the inputs of the last state.
    pub fn state(&self) -> SetState<'_> {
        SetState {
            mission: &self.mission,
            users: &self.users,
            sensors: &self.sensors,
            to_users: &self.to_users,
            to_destination: self.to_destination,
        }
    }

    /// Returns the way of a slot in the last state, metres.
    pub fn reach_m(&self) -> f32 {
        self.reach_m
    }

    /// Returns whether each user of the last state may be served.
    pub fn admissible(&self) -> &[bool] {
        &self.admissible
    }
}
