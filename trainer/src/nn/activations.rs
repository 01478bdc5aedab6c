//! Buffers of a forward and backward pass.

use super::product::padded;

/// Buffers for the forward and backward pass of one batch through one network.
#[derive(Clone, Debug)]
pub struct Activations {
    pub(super) width: usize,
    /// `values[l]` is the input of layer `l`, and the last is the output; one row per feature.
    pub(super) values: Vec<Vec<f32>>,
    /// `deltas[l + 1]` is the gradient of the loss with respect to the output of layer `l` before
    /// ReLU; `deltas[0]` is the gradient with respect to the input.
    pub(super) deltas: Vec<Vec<f32>>,
    /// `samples[l]` is the input of layer `l`, transposed: one row per sample, padded.
    pub(super) samples: Vec<Vec<f32>>,
}

impl Activations {
    /// Allocates buffers for batches of up to `batch` samples. `features` are the lengths of the
    /// network's input and of the output of every layer;
    /// [`Mlp::activations`](super::Mlp::activations) calls this.
    pub(super) fn new(features: &[usize], batch: usize) -> Self {
        let width = padded(batch);
        let buffer = |&n: &usize| vec![0.0; n * width];
        let inputs = &features[..features.len() - 1];
        Self {
            width,
            values: features.iter().map(buffer).collect(),
            deltas: features.iter().map(buffer).collect(),
            samples: inputs
                .iter()
                .map(|&n| vec![0.0; width * padded(n)])
                .collect(),
        }
    }

    /// Returns the number of columns: the batch padded to a multiple of
    /// [`LANES`](super::LANES).
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the input, one row per feature, to be filled before
    /// [`Mlp::forward`](super::Mlp::forward).
    pub fn input_mut(&mut self) -> &mut [f32] {
        &mut self.values[0]
    }

    /// Returns the input, one row per feature.
    pub fn input(&self) -> &[f32] {
        &self.values[0]
    }

    /// Returns the output of [`Mlp::forward`](super::Mlp::forward), one row per feature.
    pub fn output(&self) -> &[f32] {
        &self.values[self.values.len() - 1]
    }

    /// Returns the gradient of the loss with respect to the output, to be filled before
    /// [`Mlp::backward`](super::Mlp::backward). The padding must be zero.
    pub fn output_gradient_mut(&mut self) -> &mut [f32] {
        let last = self.deltas.len() - 1;
        &mut self.deltas[last]
    }

    /// Returns the output together with the gradient of
    /// [`output_gradient_mut`](Self::output_gradient_mut).
    pub fn loss(&mut self) -> (&[f32], &mut [f32]) {
        let last = self.deltas.len() - 1;
        (&self.values[last], &mut self.deltas[last])
    }

    /// Returns the gradient with respect to the input features that
    /// [`Mlp::backward`](super::Mlp::backward) was called for, the first of them in the first row.
    pub fn input_gradient(&self) -> &[f32] {
        &self.deltas[0]
    }

    /// Returns [`input_gradient`](Self::input_gradient) for modification.
    pub fn input_gradient_mut(&mut self) -> &mut [f32] {
        &mut self.deltas[0]
    }
}
