//! A trained policy's deterministic part, apart from the learning that made it: what export,
//! conversion and evaluation work on.

use serde::{Deserialize, Serialize};

use crate::nn::Mlp;

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
