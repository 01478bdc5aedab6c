//! A multilayer perceptron: dense layers with ReLU between them and nothing after the last.

use std::ops::Range;

use pulp::Arch;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::product::{Epilogue, LANES, Left, padded, product, transpose};

/// One dense layer's place in the parameter vector.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Layer {
    /// Features in.
    pub inputs: usize,
    /// Features out.
    pub outputs: usize,
    weights: Range<usize>,
    bias: Range<usize>,
}

impl Layer {
    /// Distance between rows of weights.
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
    /// Layers of the given sizes, for example `[19, 128, 128, 19]`; weights and biases uniform
    /// in `+-1/sqrt(inputs)`, as PyTorch initialises them.
    ///
    /// # Panics
    /// With fewer than two sizes.
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

    /// Its layers, input first.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Features in.
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs
    }

    /// Features out.
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs
    }

    /// All parameters, flat.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All parameters, flat; where a row of weights is filled up they must stay zero.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// The weight from `input` to `output` of a layer.
    pub fn weight(&self, layer: usize, output: usize, input: usize) -> f32 {
        let layer = &self.layers[layer];
        self.parameters[layer.weights.start + output * layer.stride() + input]
    }

    /// The biases of a layer.
    pub fn bias(&self, layer: usize) -> &[f32] {
        let layer = &self.layers[layer];
        &self.parameters[layer.bias.start..layer.bias.start + layer.outputs]
    }

    /// `theta' <- tau theta + (1 - tau) theta'` (eq:theta1); `self` is `theta'`.
    pub fn follow(&mut self, arch: Arch, online: &Self, tau: f32) {
        let (target, online) = (&mut self.parameters[..], &online.parameters[..]);
        assert_eq!(target.len(), online.len());
        arch.dispatch(|| {
            for (target, &online) in target.iter_mut().zip(online) {
                *target += tau * (online - *target);
            }
        });
    }

    /// Runs `trace.input_mut()` through the network to `trace.output()`.
    pub fn forward(&self, arch: Arch, trace: &mut Trace) {
        let width = trace.width;
        let last = self.layers.len() - 1;
        for (index, layer) in self.layers.iter().enumerate() {
            let (before, after) = trace.activations.split_at_mut(index + 1);
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

    /// Back-propagates `trace.output_gradient_mut()` through the last [`forward`](Self::forward).
    ///
    /// The gradient over all parameters replaces `gradient` (where one is asked for); that over
    /// the input features `inputs` replaces `trace.input_gradient()`.
    pub fn backward(
        &self,
        arch: Arch,
        trace: &mut Trace,
        mut gradient: Option<&mut [f32]>,
        inputs: Range<usize>,
    ) {
        let width = trace.width;
        for (index, layer) in self.layers.iter().enumerate().rev() {
            let (earlier, later) = trace.deltas.split_at_mut(index + 1);
            let delta = &later[0];
            if let Some(gradient) = gradient.as_deref_mut() {
                let samples = &mut trace.samples[index];
                let input = &trace.activations[index];
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
                let epilogue = Epilogue::WherePositive(&trace.activations[index]);
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

/// A sum whose order is fixed: lane by lane, then over the lanes.
pub fn lane_sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    for chunk in values.chunks_exact(LANES) {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    lanes.iter().sum()
}

/// Room for one batch's way through one network and back.
#[derive(Clone, Debug)]
pub struct Trace {
    width: usize,
    /// `activations[l]`: the input of layer `l`; the last is the output. Features by samples.
    activations: Vec<Vec<f32>>,
    /// `deltas[l + 1]`: the loss's gradient over layer `l`'s output before ReLU; `deltas[0]`:
    /// over the input.
    deltas: Vec<Vec<f32>>,
    /// `samples[l]`: the input of layer `l`, samples by (filled up) features.
    samples: Vec<Vec<f32>>,
}

impl Trace {
    /// For batches of up to `batch` samples.
    pub fn new(network: &Mlp, batch: usize) -> Self {
        let width = padded(batch);
        let features = || {
            let first = network.inputs();
            let rest = network.layers.iter().map(|layer| layer.outputs);
            std::iter::once(first).chain(rest)
        };
        Self {
            width,
            activations: features().map(|n| vec![0.0; n * width]).collect(),
            deltas: features().map(|n| vec![0.0; n * width]).collect(),
            samples: network
                .layers
                .iter()
                .map(|layer| vec![0.0; width * layer.stride()])
                .collect(),
        }
    }

    /// Samples per row: the batch, filled up to a multiple of [`LANES`].
    pub fn width(&self) -> usize {
        self.width
    }

    /// Features by samples, to be filled before [`Mlp::forward`].
    pub fn input_mut(&mut self) -> &mut [f32] {
        &mut self.activations[0]
    }

    /// Features by samples.
    pub fn input(&self) -> &[f32] {
        &self.activations[0]
    }

    /// Features by samples, after [`Mlp::forward`].
    pub fn output(&self) -> &[f32] {
        &self.activations[self.activations.len() - 1]
    }

    /// The loss's gradient over the output, to be filled before [`Mlp::backward`]; samples that
    /// only fill up the batch must have zeros.
    pub fn output_gradient_mut(&mut self) -> &mut [f32] {
        let last = self.deltas.len() - 1;
        &mut self.deltas[last]
    }

    /// Output and output gradient at once.
    pub fn loss(&mut self) -> (&[f32], &mut [f32]) {
        let last = self.deltas.len() - 1;
        (&self.activations[last], &mut self.deltas[last])
    }

    /// After [`Mlp::backward`]: the gradient over the input features that were asked for, the
    /// first of them in the first row.
    pub fn input_gradient(&self) -> &[f32] {
        &self.deltas[0]
    }

    /// As [`input_gradient`](Self::input_gradient), to add to.
    pub fn input_gradient_mut(&mut self) -> &mut [f32] {
        &mut self.deltas[0]
    }
}

/// An independent network in double precision: what the tests differentiate numerically.
#[cfg(test)]
pub(crate) mod reference {
    use super::{LANES, Mlp};

    /// Output of one sample; `parameters` replaces the network's own.
    pub(crate) fn forward(network: &Mlp, parameters: &[f64], input: &[f64]) -> Vec<f64> {
        let mut x = input.to_vec();
        let mut start = 0;
        for (index, layer) in network.layers().iter().enumerate() {
            let stride = layer.inputs.div_ceil(LANES) * LANES;
            let bias = start + layer.outputs * stride;
            x = (0..layer.outputs)
                .map(|o| {
                    let row = &parameters[start + o * stride..];
                    let z: f64 = x.iter().zip(row).map(|(x, w)| x * w).sum();
                    z + parameters[bias + o]
                })
                .collect();
            if index + 1 < network.layers().len() {
                x.iter_mut().for_each(|x| *x = x.max(0.0));
            }
            start = bias + layer.outputs.div_ceil(LANES) * LANES;
        }
        x
    }

    /// Compares a gradient with central differences of `loss` at `n` places spread over the
    /// parameters; relative to the gradient's own size.
    pub(crate) fn check_gradient(
        parameters: &[f32],
        gradient: &[f32],
        n: usize,
        mut loss: impl FnMut(&[f64]) -> f64,
    ) {
        let mut at: Vec<f64> = parameters.iter().map(|&x| f64::from(x)).collect();
        let largest = gradient.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        assert!(largest > 0.0, "the gradient is zero everywhere");
        let step = (parameters.len() / n).max(1);
        let mut nonzero = 0;
        for i in (0..parameters.len()).step_by(step) {
            const H: f64 = 1e-6;
            let x = at[i];
            at[i] = x + H;
            let above = loss(&at);
            at[i] = x - H;
            let below = loss(&at);
            at[i] = x;
            let numeric = (above - below) / (2.0 * H);
            let error = (numeric - f64::from(gradient[i])).abs();
            let scale = f64::from(gradient[i].abs()).max(0.05 * f64::from(largest));
            assert!(
                error <= 1e-3 * scale,
                "parameter {i}: numeric {numeric}, back-propagated {}",
                gradient[i]
            );
            nonzero += usize::from(numeric != 0.0);
        }
        assert!(
            nonzero * 4 > n.min(parameters.len()),
            "hardly anything was compared"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    const BATCH: usize = 21; // not a multiple of LANES

    fn setup() -> (Mlp, Trace, Vec<Vec<f64>>, Vec<f64>) {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let network = Mlp::new(&[5, 24, 17, 3], &mut rng);
        let mut trace = Trace::new(&network, BATCH);
        let width = trace.width();
        let mut samples = Vec::new();
        for sample in 0..BATCH {
            let x: Vec<f32> = (0..5).map(|_| rng.random_range(-1.0..1.0)).collect();
            for (i, &x) in x.iter().enumerate() {
                trace.input_mut()[i * width + sample] = x;
            }
            samples.push(x.into_iter().map(f64::from).collect());
        }
        let weights = (0..3 * BATCH)
            .map(|_| rng.random_range(-1.0..1.0))
            .collect();
        (network, trace, samples, weights)
    }

    /// `sum_i w_i y_i + y_i^2 / 2` over all outputs of all samples.
    fn loss(network: &Mlp, parameters: &[f64], samples: &[Vec<f64>], weights: &[f64]) -> f64 {
        let outputs = samples
            .iter()
            .flat_map(|x| reference::forward(network, parameters, x));
        outputs.zip(weights).map(|(y, w)| w * y + 0.5 * y * y).sum()
    }

    fn backward(network: &Mlp, trace: &mut Trace, weights: &[f64]) -> Vec<f32> {
        let arch = Arch::new();
        network.forward(arch, trace);
        let width = trace.width();
        let (output, gradient) = trace.loss();
        for sample in 0..BATCH {
            for i in 0..3 {
                let y = output[i * width + sample];
                gradient[i * width + sample] = y + weights[sample * 3 + i] as f32;
            }
        }
        let mut gradient = vec![f32::NAN; network.parameters().len()];
        network.backward(arch, trace, Some(&mut gradient), 0..5);
        gradient
    }

    #[test]
    fn forward_agrees_with_double_precision() {
        let (network, mut trace, samples, _) = setup();
        network.forward(Arch::new(), &mut trace);
        let parameters: Vec<f64> = network.parameters().iter().map(|&x| x.into()).collect();
        for (sample, x) in samples.iter().enumerate() {
            for (i, y) in reference::forward(&network, &parameters, x)
                .iter()
                .enumerate()
            {
                let got = f64::from(trace.output()[i * trace.width() + sample]);
                assert!((got - y).abs() < 1e-6, "{got} {y}");
            }
        }
    }

    /// Every parameter of every layer.
    #[test]
    fn parameter_gradients_match_finite_differences() {
        let (network, mut trace, samples, weights) = setup();
        let gradient = backward(&network, &mut trace, &weights);
        let n = gradient.len();
        reference::check_gradient(network.parameters(), &gradient, n, |p| {
            loss(&network, p, &samples, &weights)
        });
    }

    #[test]
    fn input_gradients_match_finite_differences() {
        let (network, mut trace, mut samples, weights) = setup();
        backward(&network, &mut trace, &weights);
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
                let got = f64::from(trace.input_gradient()[i * trace.width() + sample]);
                assert!((numeric - got).abs() < 1e-3, "{numeric} {got}");
            }
        }
    }

    #[test]
    fn the_gradient_of_some_inputs_is_that_part_of_the_whole() {
        let (network, mut trace, _, weights) = setup();
        backward(&network, &mut trace, &weights);
        let whole = trace.input_gradient().to_vec();
        network.backward(Arch::new(), &mut trace, None, 3..5);
        let width = trace.width();
        assert_eq!(trace.input_gradient()[..2 * width], whole[3 * width..]);
    }

    #[test]
    fn a_target_follows_at_rate_tau() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let online = Mlp::new(&[2, 3, 1], &mut rng);
        let mut target = Mlp::new(&[2, 3, 1], &mut rng);
        let before = target.clone();
        target.follow(Arch::new(), &online, 0.25);
        for i in 0..target.parameters().len() {
            let expected = 0.25 * online.parameters()[i] + 0.75 * before.parameters()[i];
            assert!((target.parameters()[i] - expected).abs() < 1e-6);
        }
    }
}
