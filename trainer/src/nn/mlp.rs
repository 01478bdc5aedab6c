//! A multilayer perceptron: dense layers with ReLU between them and no activation after the last.

use std::ops::Range;

use pulp::Arch;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::{
    activations::Activations,
    product::{Epilogue, Left, lane_sum, padded, product, transpose},
};

/// Shape and location of a dense layer in the parameter vector.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Layer {
    /// Number of input features.
    pub inputs: usize,
    /// Number of output features.
    pub outputs: usize,
    weights: Range<usize>,
    bias: Range<usize>,
}

impl Layer {
    /// Returns the distance between rows of weights.
    fn stride(&self) -> usize {
        padded(self.inputs)
    }
}

/// A network's structure and parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mlp {
    layers: Vec<Layer>,
    parameters: Vec<f32>,
}

impl Mlp {
    /// Creates a network with the given sizes, for example `[19, 128, 128, 19]`. Weights and biases
    /// are uniform in `+-1/sqrt(inputs)`, which is PyTorch's default.
    ///
    /// # Panics
    /// If fewer than two sizes are given.
    pub fn new(sizes: &[usize], rng: &mut Pcg64Mcg) -> Self {
        assert!(sizes.len() >= 2, "a network has an input and an output");
        let mut layers = Vec::new();
        let mut end = 0;
        for pair in sizes.windows(2) {
            let (inputs, outputs) = (pair[0], pair[1]);
            let weights = end..end + outputs * padded(inputs);
            let bias = weights.end..weights.end + padded(outputs);
            end = bias.end;
            layers.push(Layer {
                inputs,
                outputs,
                weights,
                bias,
            });
        }
        let mut network = Self {
            layers,
            parameters: vec![0.0; end],
        };
        for index in 0..network.layers.len() {
            let layer = network.layers[index].clone();
            let bound = 1.0 / (layer.inputs as f32).sqrt();
            for output in 0..layer.outputs {
                let start = layer.weights.start + output * layer.stride();
                for weight in &mut network.parameters[start..start + layer.inputs] {
                    *weight = rng.random_range(-bound..bound);
                }
                network.parameters[layer.bias.start + output] = rng.random_range(-bound..bound);
            }
        }
        network
    }

    /// Allocates buffers for passes of up to `batch` samples through this network.
    pub fn activations(&self, batch: usize) -> Activations {
        let outputs = self.layers.iter().map(|layer| layer.outputs);
        let features: Vec<usize> = std::iter::once(self.inputs()).chain(outputs).collect();
        Activations::new(&features, batch)
    }

    /// Returns the layers, the one after the input first.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Returns the number of input features.
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs
    }

    /// Returns the number of output features.
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs
    }

    /// Returns all parameters as one vector.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// Returns all parameters as one vector. The padding of rows must stay zero.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// Returns the weight from `input` to `output` of a layer.
    pub fn weight(&self, layer: usize, output: usize, input: usize) -> f32 {
        let layer = &self.layers[layer];
        self.parameters[layer.weights.start + output * layer.stride() + input]
    }

    /// Returns the biases of a layer.
    pub fn bias(&self, layer: usize) -> &[f32] {
        let layer = &self.layers[layer];
        &self.parameters[layer.bias.start..layer.bias.start + layer.outputs]
    }

    /// Moves this target network towards `online`: `theta' <- tau theta + (1 - tau) theta'`
    /// (eq:theta1), where `self` is `theta'`.
    pub fn soft_update(&mut self, arch: Arch, online: &Self, tau: f32) {
        let (target, online) = (&mut self.parameters[..], &online.parameters[..]);
        assert_eq!(target.len(), online.len());
        arch.dispatch(|| {
            for (target, &online) in target.iter_mut().zip(online) {
                *target += tau * (online - *target);
            }
        });
    }

    /// Computes `activations.output()` from `activations.input_mut()`.
    pub fn forward(&self, arch: Arch, activations: &mut Activations) {
        let width = activations.width;
        let last = self.layers.len() - 1;
        for (index, layer) in self.layers.iter().enumerate() {
            let (before, after) = activations.values.split_at_mut(index + 1);
            let weights = &self.parameters[layer.weights.clone()];
            let bias = &self.parameters[layer.bias.clone()];
            let epilogue = if index == last {
                Epilogue::Bias(bias)
            } else {
                Epilogue::BiasRelu(bias)
            };
            let left = Left::rows(weights, layer.outputs, layer.stride());
            product(
                arch,
                left,
                &before[index],
                &mut after[0],
                layer.inputs,
                width,
                epilogue,
            );
        }
    }

    /// Back-propagates `activations.output_gradient_mut()` through the last
    /// [`forward`](Self::forward). Writes the gradient with respect to all parameters to `gradient`,
    /// if given, and the gradient with respect to the input features `inputs` to
    /// `activations.input_gradient()`.
    pub fn backward(
        &self,
        arch: Arch,
        activations: &mut Activations,
        mut gradient: Option<&mut [f32]>,
        inputs: Range<usize>,
    ) {
        let width = activations.width;
        for (index, layer) in self.layers.iter().enumerate().rev() {
            let (earlier, later) = activations.deltas.split_at_mut(index + 1);
            let delta = &later[0];
            if let Some(gradient) = gradient.as_deref_mut() {
                let samples = &mut activations.samples[index];
                let input = &activations.values[index];
                let stride = layer.stride();
                transpose(arch, input, samples, layer.inputs, width, width, stride);
                let left = Left::rows(delta, layer.outputs, width);
                let weights = &mut gradient[layer.weights.clone()];
                product(arch, left, samples, weights, width, stride, Epilogue::None);
                let bias = &mut gradient[layer.bias.clone()];
                bias[layer.outputs..].fill(0.0);
                for (bias, row) in bias.iter_mut().zip(delta.chunks_exact(width)) {
                    *bias = lane_sum(row);
                }
            }
            let weights = &self.parameters[layer.weights.clone()];
            let stride = layer.stride();
            if index > 0 {
                let left = Left::transposed(weights, layer.inputs, stride);
                let epilogue = Epilogue::WherePositive(&activations.values[index]);
                let result = &mut earlier[index];
                product(arch, left, delta, result, layer.outputs, width, epilogue);
            } else if !inputs.is_empty() {
                let left = Left::transposed(&weights[inputs.start..], inputs.len(), stride);
                let result = &mut earlier[0];
                product(
                    arch,
                    left,
                    delta,
                    result,
                    layer.outputs,
                    width,
                    Epilogue::None,
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{super::reference, *};
    use rand::SeedableRng;

    const BATCH: usize = 21; // not a multiple of LANES

    fn setup() -> (Mlp, Activations, Vec<Vec<f64>>, Vec<f64>) {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let network = Mlp::new(&[5, 24, 17, 3], &mut rng);
        let mut activations = network.activations(BATCH);
        let width = activations.width();
        let mut samples = Vec::new();
        for sample in 0..BATCH {
            let x: Vec<f32> = (0..5).map(|_| rng.random_range(-1.0..1.0)).collect();
            for (i, &x) in x.iter().enumerate() {
                activations.input_mut()[i * width + sample] = x;
            }
            samples.push(x.into_iter().map(f64::from).collect());
        }
        let weights = (0..3 * BATCH)
            .map(|_| rng.random_range(-1.0..1.0))
            .collect();
        (network, activations, samples, weights)
    }

    /// `sum_i w_i y_i + y_i^2 / 2` over all outputs of all samples.
    fn loss(network: &Mlp, parameters: &[f64], samples: &[Vec<f64>], weights: &[f64]) -> f64 {
        let outputs = samples
            .iter()
            .flat_map(|x| reference::forward(network, parameters, x));
        outputs.zip(weights).map(|(y, w)| w * y + 0.5 * y * y).sum()
    }

    fn backward(network: &Mlp, activations: &mut Activations, weights: &[f64]) -> Vec<f32> {
        let arch = Arch::new();
        network.forward(arch, activations);
        let width = activations.width();
        let (output, gradient) = activations.loss();
        for sample in 0..BATCH {
            for i in 0..3 {
                let y = output[i * width + sample];
                gradient[i * width + sample] = y + weights[sample * 3 + i] as f32;
            }
        }
        let mut gradient = vec![f32::NAN; network.parameters().len()];
        network.backward(arch, activations, Some(&mut gradient), 0..5);
        gradient
    }

    #[test]
    fn forward_agrees_with_double_precision() {
        let (network, mut activations, samples, _) = setup();
        network.forward(Arch::new(), &mut activations);
        let parameters: Vec<f64> = network.parameters().iter().map(|&x| x.into()).collect();
        for (sample, x) in samples.iter().enumerate() {
            for (i, y) in reference::forward(&network, &parameters, x)
                .iter()
                .enumerate()
            {
                let got = f64::from(activations.output()[i * activations.width() + sample]);
                assert!((got - y).abs() < 1e-6, "{got} {y}");
            }
        }
    }

    /// Every parameter of every layer.
    #[test]
    fn parameter_gradients_match_finite_differences() {
        let (network, mut activations, samples, weights) = setup();
        let gradient = backward(&network, &mut activations, &weights);
        let n = gradient.len();
        reference::check_gradient(network.parameters(), &gradient, n, |p| {
            loss(&network, p, &samples, &weights)
        });
    }

    #[test]
    fn input_gradients_match_finite_differences() {
        let (network, mut activations, mut samples, weights) = setup();
        backward(&network, &mut activations, &weights);
        let parameters: Vec<f64> = network.parameters().iter().map(|&x| x.into()).collect();
        for sample in [0, 7, 20] {
            for i in 0..5 {
                let x = samples[sample][i];
                samples[sample][i] = x + 1e-6;
                let above = loss(&network, &parameters, &samples, &weights);
                samples[sample][i] = x - 1e-6;
                let below = loss(&network, &parameters, &samples, &weights);
                samples[sample][i] = x;
                let numeric = (above - below) / 2e-6;
                let got = f64::from(activations.input_gradient()[i * activations.width() + sample]);
                assert!((numeric - got).abs() < 1e-3, "{numeric} {got}");
            }
        }
    }

    #[test]
    fn the_gradient_of_some_inputs_is_that_part_of_the_whole() {
        let (network, mut activations, _, weights) = setup();
        backward(&network, &mut activations, &weights);
        let whole = activations.input_gradient().to_vec();
        network.backward(Arch::new(), &mut activations, None, 3..5);
        let width = activations.width();
        assert_eq!(
            activations.input_gradient()[..2 * width],
            whole[3 * width..]
        );
    }

    #[test]
    fn a_target_follows_at_rate_tau() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let online = Mlp::new(&[2, 3, 1], &mut rng);
        let mut target = Mlp::new(&[2, 3, 1], &mut rng);
        let before = target.clone();
        target.soft_update(Arch::new(), &online, 0.25);
        for i in 0..target.parameters().len() {
            let expected = 0.25 * online.parameters()[i] + 0.75 * before.parameters()[i];
            assert!((target.parameters()[i] - expected).abs() < 1e-6);
        }
    }
}
