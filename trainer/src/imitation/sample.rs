//! An example as a sample: reflected, disturbed, with its label.

use firmware_core::{Position, policy::Observation, shield::Agility};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::HostMission;

use super::{
    demonstration::{Demonstration, Example, WEIGHT_MAX},
    encoder::Encoder,
    settings::ImitationSettings,
    symmetry::Symmetry,
};
use crate::{learner::fill_normal, nn::sets::SetBatch};

/// What the network should answer in the states of a batch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Labels {
    /// The displacement of each state, in units of the way of a slot, at most 1 long.
    pub displacements: Vec<[f32; 2]>,
    /// The user of each state.
    pub users: Vec<usize>,
    /// Whether each user of all states may be served.
    pub admissible: Vec<bool>,
}

/// A sample: an example, and the seed of its reflection and disturbance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The index of the demonstration.
    pub demonstration: usize,
    /// The index of the example in the demonstration.
    pub example: usize,
    /// The seed.
    pub seed: u64,
}

impl Sample {
    /// Draws an example of one of the demonstrations, each as often as its weight says.
    pub fn draw(demonstrations: &[Demonstration], rng: &mut Pcg64Mcg) -> Self {
        let demonstration = loop {
            let drawn = rng.random_range(0..demonstrations.len());
            if WEIGHT_MAX * rng.random::<f64>() < demonstrations[drawn].weight {
                break drawn;
            }
        };
        Self {
            demonstration,
            example: rng.random_range(0..demonstrations[demonstration].examples.len()),
            seed: rng.random(),
        }
    }

    /// Adds the sample to a batch and its labels.
    pub fn push(
        &self,
        demonstrations: &[Demonstration],
        settings: &ImitationSettings,
        encoder: &mut Encoder,
        batch: &mut SetBatch,
        labels: &mut Labels,
    ) {
        let demonstration = &demonstrations[self.demonstration];
        let example = &demonstration.examples[self.example];
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed);
        let symmetry = Symmetry::random(&mut rng);
        let mission = symmetry.mission(&demonstration.mission);
        let area = demonstration.mission.parameters().area;
        let place =
            |[east_m, north_m]: [f64; 2]| symmetry.place(&area, &Position::new(east_m, north_m));
        let mut position = place(example.position_m);
        let reach_m = mission.reach_m();
        if rng.random_bool(settings.disturbed_fraction) {
            let mut offset = [0.0; 2];
            fill_normal(&mut rng, &mut offset);
            let scale = settings.disturbance * reach_m;
            position.x += f64::from(offset[0]) * scale;
            position.y += f64::from(offset[1]) * scale;
            position = mission.parameters().area.nearest(&position);
        }
        encoder.encode(&mission, &example.observation(&mission, position));
        batch.push(&encoder.state());
        let step = (place(example.waypoint_m) - position) / reach_m;
        let step = step / step.norm().max(1.0);
        labels.displacements.push([step.x as f32, step.y as f32]);
        labels.users.push(example.user.into());
        labels.admissible.extend_from_slice(encoder.admissible());
    }
}

impl Example {
    /// Returns the observation of this example's state from another position.
    pub fn observation(
        &self,
        mission: &HostMission,
        position: Position<f64>,
    ) -> Observation<'_, f64> {
        Observation {
            slot: self.slot,
            counts: &self.counts,
            rate: 0.0,
            mse: 0.0,
            position,
            agility: Agility::ideal(mission),
        }
    }
}
