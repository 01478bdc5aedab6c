//! The network as a policy, with the inputs and the arithmetic of training.

use firmware_core::{
    Displacement, USERS_MAX,
    mission::MissionChange,
    policy::{Action, MeasuredGains, Observation, PlanQuality, Policy},
};
use pulp::Arch;
use scenario::HostMission;

use super::encoder::{Encoder, FEATURES};
use crate::nn::sets::{Activations, SetBatch, SetNetwork};

/// The deterministic policy of a network on one mission.
#[derive(Debug)]
pub struct SetPolicy<'a> {
    network: &'a SetNetwork,
    mission: HostMission,
    arch: Arch,
    encoder: Encoder,
    batch: SetBatch,
    activations: Activations,
}

impl<'a> SetPolicy<'a> {
    /// Creates the policy of a network for a mission.
    pub fn new(network: &'a SetNetwork, mission: HostMission, arch: Arch) -> Self {
        Self {
            network,
            mission,
            arch,
            encoder: Encoder::default(),
            batch: SetBatch::new(FEATURES),
            activations: Activations::default(),
        }
    }
}

impl Policy<f64, USERS_MAX> for SetPolicy<'_> {
    fn decide(&mut self, observation: &Observation<'_, f64>) -> Action<f64, USERS_MAX> {
        self.encoder.encode(&self.mission, observation);
        self.batch.clear();
        self.batch.push(&self.encoder.state());
        self.activations
            .forward(self.arch, self.network, &self.batch);
        let outputs = self.activations.outputs();
        let [east, north] = outputs
            .displacement(0)
            .map(|v| f64::from(v * self.encoder.reach_m()));
        Action {
            displacement: Displacement::new(east, north),
            user_scores: outputs.scores.iter().map(|&s| f64::from(s)).collect(),
        }
    }

    fn revise(&mut self, change: &MissionChange<f64>, slots_begun: u32) {
        // The controller refuses the change, too, where it is not possible.
        let _ = self.mission.change(change, slots_begun);
    }

    fn note_gains(&mut self, _: &MeasuredGains<'_, f64>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<PlanQuality> {
        None
    }
}
