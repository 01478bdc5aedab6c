//! A trained policy's deterministic part, apart from the learning that made it: what export,
//! conversion and evaluation work on.

use firmware_core::policy::{
    Provenance,
    mlp::{self, Header},
};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::{env::Normalizer, nn::Mlp};

/// A dense layer as plain matrices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dense {
    /// Features in.
    pub inputs: usize,
    /// Features out.
    pub outputs: usize,
    /// Row by row, a row per output.
    pub weights: Vec<f32>,
    /// One per output.
    pub bias: Vec<f32>,
}

impl Dense {
    /// The layers of a network; of the last one only the given rows.
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
}

/// Raw observation in, metres and scores out:
/// `[u_x, u_y, scores..] = layers((observation - offset) * scale)`, displacement `reach tanh(u)`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Actor {
    /// What it was trained for and by what.
    pub provenance: Provenance,
    /// What makes raw observations fit the network.
    pub normalizer: Normalizer,
    /// ReLU between them; the last gives `u` and the scores.
    pub layers: Vec<Dense>,
    /// `V_max delta`, metres.
    pub reach_m: f32,
}

/// An observation and what it must give.
#[derive(Clone, Debug, PartialEq)]
pub struct TestVector {
    /// `M + 4` numbers in raw units.
    pub observation: Vec<f32>,
    /// Metres.
    pub displacement: Vec<f32>,
    /// One per user.
    pub user_scores: Vec<f32>,
}

impl Actor {
    /// `M`.
    pub fn users(&self) -> usize {
        self.provenance.users as usize
    }

    /// Displacement (metres), then scores, in double precision: what every runtime of the policy
    /// is compared with.
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
                    if index + 1 < self.layers.len() {
                        z.max(0.0)
                    } else {
                        z
                    }
                })
                .collect();
        }
        for u in &mut x[..2] {
            *u = f64::from(self.reach_m) * u.tanh();
        }
        x
    }

    /// An observation drawn from (a little more than) what a mission can show, raw units.
    pub fn random_observation(&self, rng: &mut Pcg64Mcg) -> Vec<f32> {
        let pairs = self.normalizer.offset.iter().zip(&self.normalizer.scale);
        pairs
            .map(|(offset, scale)| offset + rng.random_range(-1.2_f32..1.2) / scale)
            .collect()
    }

    /// A state in the middle of a mission, hardly two features alike, and what it gives.
    pub fn test_vector(&self) -> TestVector {
        let pairs = self.normalizer.offset.iter().zip(&self.normalizer.scale);
        let observation: Vec<f32> = pairs
            .enumerate()
            .map(|(i, (offset, scale))| {
                let normalised = ((i * 7 + 3) % 19) as f32 / 10.0 - 0.9;
                offset + normalised / scale
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

    /// The bytes of a `.policy` file.
    ///
    /// # Errors
    /// Layers that firmware-core does not hold.
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
        // The header's strings are bounded: 1 kB holds it.
        let mut file = vec![0; 4 * numbers.len() + 1024];
        let length = mlp::write(&header, numbers.into_iter(), &mut file)?;
        file.truncate(length);
        Ok(file)
    }
}
