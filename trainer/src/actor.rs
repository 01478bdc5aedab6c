//! The deterministic policy that training produces, independent of the learning algorithm. Export,
//! conversion and evaluation use it.

use environment::Normalizer;
use std::ops::Range;

use firmware_core::policy::{
    Provenance,
    mlp::{self, Activation, Functions, Header, Limit},
};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;
use serde::{Deserialize, Serialize};

use crate::{nn::Mlp, settings::TrainingSettings};

/// A dense layer as plain matrices, without padding.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dense {
    /// Number of input features.
    pub inputs: usize,
    /// Number of output features.
    pub outputs: usize,
    /// The weights, one row per output.
    pub weights: Vec<f32>,
    /// The biases, one per output.
    pub bias: Vec<f32>,
}

impl Dense {
    /// Returns the layers of a network, and of the last layer only the given rows.
    pub fn of_network(network: &Mlp, last_rows: impl Iterator<Item = usize> + Clone) -> Vec<Self> {
        let last = network.layers().len() - 1;
        (0..=last)
            .map(|index| {
                let layer = &network.layers()[index];
                let rows: Vec<usize> = if index == last {
                    last_rows.clone().collect()
                } else {
                    (0..layer.outputs).collect()
                };
                let inputs = 0..layer.inputs;
                Self {
                    inputs: layer.inputs,
                    outputs: rows.len(),
                    weights: rows
                        .iter()
                        .flat_map(|&o| inputs.clone().map(move |i| network.weight(index, o, i)))
                        .collect(),
                    bias: rows.iter().map(|&o| network.bias(index)[o]).collect(),
                }
            })
            .collect()
    }

    /// Returns the layer with only the given outputs.
    ///
    /// # Panics
    /// If the range exceeds the outputs.
    pub fn rows(&self, range: Range<usize>) -> Self {
        let n = self.inputs;
        Self {
            inputs: n,
            outputs: range.len(),
            weights: self.weights[range.start * n..range.end * n].to_vec(),
            bias: self.bias[range].to_vec(),
        }
    }
}

/// A deterministic policy from raw observations to a displacement in metres and user scores:
/// `[u_x, u_y, scores..] = layers((observation - offset) * scale)`, displacement `reach tanh(u)`. Actors
/// of other trainers may have other [`Functions`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Actor {
    /// The mission that it was trained for, and how.
    pub provenance: Provenance,
    /// The normalization of raw observations.
    pub normalizer: Normalizer,
    /// The layers; the last one returns `u` and the scores.
    pub layers: Vec<Dense>,
    /// The functions between the layers and after `u`. Checkpoints do not state them: what is trained
    /// here has the default, ReLU and `tanh`.
    #[serde(skip)]
    pub functions: Functions,
    /// `V_max delta`, metres.
    pub reach_m: f32,
}

/// An observation and the outputs expected for it.
#[derive(Clone, Debug, PartialEq)]
pub struct TestVector {
    /// The observation, `M + 4` numbers in raw units.
    pub observation: Vec<f32>,
    /// The displacement, metres.
    pub displacement: Vec<f32>,
    /// The scores, one per user.
    pub user_scores: Vec<f32>,
}

impl Actor {
    /// Returns the actor with these layers for a run's scenario and settings, after a number of
    /// episodes.
    pub fn new(
        layers: Vec<Dense>,
        scenario: &Scenario,
        settings: &TrainingSettings,
        episodes: u32,
    ) -> Self {
        let mission = &scenario.mission;
        let p = mission.parameters();
        Self {
            provenance: Provenance {
                users: mission.user_count() as u32,
                max_speed_mps: p.max_speed_mps as f32,
                slot_duration_s: p.slot_duration_s as f32,
                area_m: [p.area.east_m as f32, p.area.north_m as f32],
                algorithm: truncated(settings.algorithm.name()),
                scenario: truncated(&scenario.name),
                scenario_digest: truncated(&scenario.digest()),
                episodes,
                seed: settings.seed,
            },
            normalizer: Normalizer::of_mission(mission),
            layers,
            functions: Functions::default(),
            reach_m: mission.reach_m() as f32,
        }
    }

    /// Returns the number of users, `M`.
    pub fn users(&self) -> usize {
        self.provenance.users as usize
    }

    /// Returns displacement (metres) and scores, computed in double precision. Every runtime of the
    /// policy is compared with this.
    pub fn evaluate(&self, observation: &[f32]) -> Vec<f64> {
        let raw = observation.iter().zip(&self.normalizer.offset);
        let mut x: Vec<f64> = raw
            .zip(&self.normalizer.scale)
            .map(|((&x, &offset), &scale)| f64::from((x - offset) * scale))
            .collect();
        for (index, layer) in self.layers.iter().enumerate() {
            let rows = layer.weights.chunks_exact(layer.inputs).zip(&layer.bias);
            x = rows
                .map(|(row, &bias)| {
                    let products = row.iter().zip(&x).map(|(&w, x)| f64::from(w) * x);
                    let z = products.sum::<f64>() + f64::from(bias);
                    match self.functions.activation {
                        _ if index + 1 == self.layers.len() => z,
                        Activation::Relu => z.max(0.0),
                        Activation::Tanh => z.tanh(),
                    }
                })
                .collect();
        }
        let limited = |limit, x: f64| match limit {
            Limit::Tanh => x.tanh(),
            Limit::Clip => x.clamp(-1.0, 1.0),
        };
        for u in &mut x[..2] {
            *u = f64::from(self.reach_m) * limited(self.functions.displacement, *u);
        }
        if let Some(limit) = self.functions.scores {
            for score in &mut x[2..] {
                *score = limited(limit, *score);
            }
        }
        x
    }

    /// Returns a random observation in raw units, from a range slightly larger than that of a
    /// mission.
    pub fn random_observation(&self, rng: &mut Pcg64Mcg) -> Vec<f32> {
        let pairs = self.normalizer.offset.iter().zip(&self.normalizer.scale);
        pairs
            .map(|(offset, scale)| offset + rng.random_range(-1.2_f32..1.2) / scale)
            .collect()
    }

    /// Returns an observation from the middle of the range, in which most features differ, and its
    /// outputs.
    pub fn test_vector(&self) -> TestVector {
        let pairs = self.normalizer.offset.iter().zip(&self.normalizer.scale);
        let observation: Vec<f32> = pairs
            .enumerate()
            .map(|(i, (offset, scale))| {
                let normalized = ((i * 7 + 3) % 19) as f32 / 10.0 - 0.9;
                // An input without a scale is ignored.
                if *scale == 0.0 {
                    *offset
                } else {
                    offset + normalized / scale
                }
            })
            .collect();
        let outputs: Vec<f32> = self
            .evaluate(&observation)
            .iter()
            .map(|&x| x as f32)
            .collect();
        TestVector {
            observation,
            displacement: outputs[..2].to_vec(),
            user_scores: outputs[2..].to_vec(),
        }
    }

    /// Returns the bytes of a `.policy` file.
    ///
    /// # Errors
    /// Fails if the network exceeds the limits of `firmware-core`.
    pub fn to_policy_file(&self) -> anyhow::Result<Vec<u8>> {
        let sizes = std::iter::once(self.normalizer.offset.len())
            .chain(self.layers.iter().map(|layer| layer.outputs))
            .map(u16::try_from)
            .collect::<Result<Vec<_>, _>>()?;
        let sizes = heapless::Vec::from_slice(&sizes).map_err(|_| {
            anyhow::anyhow!("{} layers, at most {}", sizes.len() - 1, mlp::LAYERS_MAX)
        })?;
        let header = Header {
            provenance: self.provenance.clone(),
            functions: self.functions,
            reach_m: self.reach_m,
            sizes,
        };
        let test = self.test_vector();
        let parts = [&self.normalizer.offset, &self.normalizer.scale]
            .into_iter()
            .chain(
                self.layers
                    .iter()
                    .flat_map(|layer| [&layer.weights, &layer.bias]),
            )
            .chain([&test.observation, &test.displacement, &test.user_scores]);
        let numbers: Vec<f32> = parts.flatten().copied().collect();
        // The strings in the header are bounded, so 1 kB suffices.
        let mut file = vec![0; 4 * numbers.len() + 1024];
        let length = mlp::write(&header, numbers.into_iter(), &mut file)?;
        file.truncate(length);
        Ok(file)
    }
}

/// Returns the beginning of a text, as far as it fits.
fn truncated<const N: usize>(text: &str) -> heapless::String<N> {
    let mut truncated = heapless::String::new();
    for c in text.chars() {
        if truncated.push(c).is_err() {
            break;
        }
    }
    truncated
}
