//! The sizes of the network, and the place of every parameter in the parameter vector.

use std::ops::Range;

use firmware_core::policy::sets::{CANDIDATE_OUTPUTS, CANDIDATES};
use serde::{Deserialize, Serialize};

use super::super::product::padded;

/// Number of attention heads.
pub const HEADS: usize = 4;
/// Number of outputs of the displacement head.
pub const DISPLACEMENT_OUTPUTS: usize = CANDIDATE_OUTPUTS * CANDIDATES;
/// Number of outputs of the user head of a policy: the score, and a pull per candidate.
pub const USER_OUTPUTS: usize = 1 + CANDIDATES;
/// Number of outputs of the user head of a critic: the value.
const VALUE_OUTPUTS: usize = 1;

/// What a network computes from the final tokens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Heads {
    /// A displacement and a score per user.
    Policy,
    /// A value per user, in place of its score.
    Critic,
}

/// The sizes of the hidden layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Architecture {
    /// Width of a token: 32, 64, 96 or 128.
    pub width: usize,
    /// Width of the hidden layer after attention, a multiple of 16.
    pub hidden: usize,
    /// Number of layers.
    pub layers: usize,
}

impl Default for Architecture {
    fn default() -> Self {
        Self {
            width: 64,
            hidden: 192,
            layers: 3,
        }
    }
}

impl Architecture {
    /// Checks that a network can have these sizes.
    ///
    /// # Errors
    /// Names the size that is out of its range.
    pub fn check(&self) -> Result<(), String> {
        let &Self { width, hidden, .. } = self;
        if ![32, 64, 96, 128].contains(&width) {
            return Err(format!(
                "architecture.width is {width}, but must be 32, 64, 96 or 128"
            ));
        }
        if hidden == 0 || !hidden.is_multiple_of(16) {
            return Err(format!(
                "architecture.hidden is {hidden}, but must be a multiple of 16 above 0"
            ));
        }
        Ok(())
    }
}

/// The numbers of features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FeatureSizes {
    /// Of the mission.
    pub mission: usize,
    /// Of each user.
    pub user: usize,
    /// Of each sensor.
    pub sensor: usize,
}

/// The place of a linear layer's parameters: `outputs` rows of weights at a distance of
/// [`stride`](Self::stride), then the biases, padded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Linear {
    /// Number of inputs.
    pub inputs: usize,
    /// Number of outputs.
    pub outputs: usize,
    start: usize,
    /// Where the transposed weights start in their vector.
    transposed: usize,
}

impl Linear {
    /// Returns the distance between rows of weights.
    pub fn stride(&self) -> usize {
        padded(self.inputs)
    }

    /// Returns the number of outputs including padding.
    pub fn columns(&self) -> usize {
        padded(self.outputs)
    }

    /// Returns the place of the weights.
    pub fn weights(&self) -> Range<usize> {
        self.start..self.start + self.outputs * self.stride()
    }

    /// Returns the place of the biases, including padding.
    pub fn bias(&self) -> Range<usize> {
        let start = self.weights().end;
        start..start + self.columns()
    }

    /// Returns the place of the transposed weights, one row of [`columns`](Self::columns) per
    /// input.
    pub fn transposed(&self) -> Range<usize> {
        self.transposed..self.transposed + self.inputs * self.columns()
    }
}

/// The parameters of one transformer layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Where the `width` scales of the norm before attention start.
    pub attention_norm: usize,
    /// Queries, keys and values.
    pub qkv: Linear,
    /// The outputs of the heads to a token.
    pub mix: Linear,
    /// Where the `width` scales of the norm before the hidden layer start.
    pub hidden_norm: usize,
    /// A token to the hidden layer.
    pub up: Linear,
    /// The hidden layer to a token.
    pub down: Linear,
}

/// The place of every parameter, in the order of the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// The sizes of the hidden layers.
    pub architecture: Architecture,
    /// The numbers of features.
    pub features: FeatureSizes,
    /// What the network computes.
    pub heads: Heads,
    /// First layer of the sensors.
    pub sensor_in: Linear,
    /// Second layer of the sensors.
    pub sensor_out: Linear,
    /// Mission and pooled sensors to token 0.
    pub mission: Linear,
    /// Users to tokens 1 to M.
    pub user: Linear,
    /// The layers.
    pub blocks: Vec<Block>,
    /// Where the `width` scales of the last norm start.
    pub final_norm: usize,
    /// The two layers of the displacement head, which a critic does not have.
    pub displacement: Option<[Linear; 2]>,
    /// First layer of the user head.
    pub user_in: Linear,
    /// Second layer of the user head.
    pub user_out: Linear,
    /// Length of the parameter vector, including padding.
    pub len: usize,
    /// Length of the vector of transposed weights.
    pub transposed_len: usize,
}

/// A part of the parameters, in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Weights and biases.
    Linear(Linear),
    /// So many scales from this place on.
    Scales(usize, usize),
}

struct Cursor {
    next: usize,
    transposed: usize,
}

impl Cursor {
    fn linear(&mut self, inputs: usize, outputs: usize) -> Linear {
        let linear = Linear {
            inputs,
            outputs,
            start: self.next,
            transposed: self.transposed,
        };
        self.next = linear.bias().end;
        self.transposed = linear.transposed().end;
        linear
    }

    fn scales(&mut self, width: usize) -> usize {
        let start = self.next;
        self.next += padded(width);
        start
    }
}

impl Layout {
    /// Lays out the parameters.
    ///
    /// # Panics
    /// If the width is none of 32, 64, 96 and 128, or the hidden width no multiple of 16.
    pub fn new(architecture: Architecture, features: FeatureSizes, heads: Heads) -> Self {
        let Architecture {
            width,
            hidden,
            layers,
        } = architecture;
        assert!([32, 64, 96, 128].contains(&width), "width {width}");
        assert!(hidden > 0 && hidden % 16 == 0, "hidden width {hidden}");
        let mut next = Cursor {
            next: 0,
            transposed: 0,
        };
        let sensor_in = next.linear(features.sensor, width);
        let sensor_out = next.linear(width, width);
        let mission = next.linear(features.mission + 2 * width, width);
        let user = next.linear(features.user, width);
        let blocks = (0..layers)
            .map(|_| Block {
                attention_norm: next.scales(width),
                qkv: next.linear(width, 3 * width),
                mix: next.linear(width, width),
                hidden_norm: next.scales(width),
                up: next.linear(width, hidden),
                down: next.linear(hidden, width),
            })
            .collect();
        let final_norm = next.scales(width);
        let (displacement, user_outputs) = match heads {
            Heads::Policy => {
                let first = next.linear(width, width);
                let second = next.linear(width, DISPLACEMENT_OUTPUTS);
                (Some([first, second]), USER_OUTPUTS)
            }
            Heads::Critic => (None, VALUE_OUTPUTS),
        };
        let user_in = next.linear(2 * width, width);
        let user_out = next.linear(width, user_outputs);
        Self {
            architecture,
            features,
            heads,
            sensor_in,
            sensor_out,
            mission,
            user,
            blocks,
            final_norm,
            displacement,
            user_in,
            user_out,
            len: next.next,
            transposed_len: next.transposed,
        }
    }

    /// Returns all parts in the order of the file.
    pub fn parts(&self) -> Vec<Part> {
        let width = self.architecture.width;
        let mut parts = vec![
            Part::Linear(self.sensor_in),
            Part::Linear(self.sensor_out),
            Part::Linear(self.mission),
            Part::Linear(self.user),
        ];
        for block in &self.blocks {
            parts.extend([
                Part::Scales(block.attention_norm, width),
                Part::Linear(block.qkv),
                Part::Linear(block.mix),
                Part::Scales(block.hidden_norm, width),
                Part::Linear(block.up),
                Part::Linear(block.down),
            ]);
        }
        parts.push(Part::Scales(self.final_norm, width));
        parts.extend(self.displacement.into_iter().flatten().map(Part::Linear));
        parts.extend([Part::Linear(self.user_in), Part::Linear(self.user_out)]);
        parts
    }
}
