//! The parameters of the network: initial values, and their order in files.

use std::ops::Range;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::layout::{Architecture, FeatureSizes, Heads, Layout, Linear, Part};

/// Standard deviation of the initial weights of layers that add to a token, and of the heads'
/// outputs: a new network computes nearly the same for all inputs.
const SMALL: f32 = 0.02;

/// The network: layout and parameters.
#[derive(Clone, Debug)]
pub struct SetNetwork {
    layout: Layout,
    parameters: Vec<f32>,
    /// The weights of all linear layers, transposed: the right factors of the forward pass.
    transposed: Vec<f32>,
}

impl SetNetwork {
    /// Creates a policy with random weights.
    pub fn new(architecture: Architecture, features: FeatureSizes, seed: u64) -> Self {
        Self::with_heads(architecture, features, Heads::Policy, seed)
    }

    /// Creates a network with random weights.
    pub fn with_heads(
        architecture: Architecture,
        features: FeatureSizes,
        heads: Heads,
        seed: u64,
    ) -> Self {
        let layout = Layout::new(architecture, features, heads);
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let small: Vec<Linear> = (layout.blocks.iter())
            .flat_map(|block| [block.mix, block.down])
            .chain(layout.displacement.map(|[_, last]| last))
            .chain([layout.user_out])
            .collect();
        let mut parameters = vec![0.0; layout.len];
        for part in layout.parts() {
            match part {
                Part::Scales(start, count) => parameters[start..start + count].fill(1.0),
                Part::Linear(linear) => {
                    let deviation = match small.contains(&linear) {
                        true => SMALL,
                        false => (linear.inputs as f32).sqrt().recip(),
                    };
                    // Uniform numbers with this standard deviation.
                    let limit = deviation * 3.0_f32.sqrt();
                    for row in parameters[linear.weights()].chunks_mut(linear.stride()) {
                        row[..linear.inputs].fill_with(|| rng.random_range(-limit..limit));
                    }
                }
            }
        }
        let transposed = vec![0.0; layout.transposed_len];
        let mut network = Self {
            layout,
            parameters,
            transposed,
        };
        network.refresh();
        network
    }

    /// Returns the layout of the parameters.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Returns all parameters, with padding.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// Changes the parameters. Padding must stay zero.
    pub fn update(&mut self, change: impl FnOnce(&mut [f32])) {
        change(&mut self.parameters);
        self.refresh();
    }

    /// Returns the weights and the biases of a linear layer, with padding.
    pub(super) fn linear(&self, linear: &Linear) -> (&[f32], &[f32]) {
        let parameters = &self.parameters;
        (&parameters[linear.weights()], &parameters[linear.bias()])
    }

    /// Returns the transposed weights of a linear layer.
    pub(super) fn transposed(&self, linear: &Linear) -> &[f32] {
        &self.transposed[linear.transposed()]
    }

    /// Returns the scales of a layer norm.
    pub(super) fn scales(&self, start: usize) -> &[f32] {
        &self.parameters[start..start + self.layout.architecture.width]
    }

    /// Returns the number of parameters without padding.
    pub fn exported_len(&self) -> usize {
        self.layout.exported_ranges().map(|range| range.len()).sum()
    }

    /// Returns the parameters without padding, in the order of the file: each linear layer's weights
    /// (one row per output), then its biases.
    pub fn export(&self) -> Vec<f32> {
        self.layout.without_padding(&self.parameters)
    }

    /// Replaces the parameters by those that [`export`](Self::export) returned.
    ///
    /// # Errors
    /// Returns the expected number of parameters if there are more or fewer.
    pub fn import(&mut self, values: &[f32]) -> Result<(), usize> {
        let expected = self.exported_len();
        if values.len() != expected {
            return Err(expected);
        }
        let mut values = values.iter();
        for range in self.layout.exported_ranges() {
            for (parameter, value) in self.parameters[range].iter_mut().zip(&mut values) {
                *parameter = *value;
            }
        }
        self.refresh();
        Ok(())
    }

    /// Computes the transposed weights from the parameters.
    fn refresh(&mut self) {
        for part in self.layout.parts() {
            let Part::Linear(linear) = part else { continue };
            let columns = linear.columns();
            let transposed = &mut self.transposed[linear.transposed()];
            let weights = self.parameters[linear.weights()].chunks(linear.stride());
            for (output, row) in weights.enumerate() {
                for (to, &weight) in transposed.chunks_mut(columns).zip(row) {
                    to[output] = weight;
                }
            }
        }
    }
}

impl Layout {
    /// Returns the places of the parameters in the order of the file, without padding.
    pub fn exported_ranges(&self) -> impl Iterator<Item = Range<usize>> {
        self.parts().into_iter().flat_map(|part| match part {
            Part::Scales(start, count) => std::iter::once(start..start + count).collect::<Vec<_>>(),
            Part::Linear(linear) => {
                let start = linear.weights().start;
                let row = |output: usize| {
                    let start = start + output * linear.stride();
                    start..start + linear.inputs
                };
                let bias = linear.bias().start;
                let rows = (0..linear.outputs).map(row);
                rows.chain(std::iter::once(bias..bias + linear.outputs))
                    .collect()
            }
        })
    }

    /// Returns a vector with this layout without its padding.
    pub fn without_padding(&self, padded: &[f32]) -> Vec<f32> {
        let ranges = self.exported_ranges();
        ranges
            .flat_map(|range| padded[range].iter().copied())
            .collect()
    }
}
