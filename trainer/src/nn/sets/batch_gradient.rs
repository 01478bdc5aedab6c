//! The gradient of a large batch, on threads, with a result that does not depend on their number.

use std::ops::Range;

use pulp::Arch;

use super::{
    backward::Gradients,
    batch::SetBatch,
    forward::Activations,
    functions::add,
    heads::{OutputGradients, Outputs},
    network::SetNetwork,
    parts::{CHUNK, PARTS, for_each_part, part_of},
};

/// One part of a batch, with all that it needs to compute its gradient.
#[derive(Clone, Debug)]
struct PartOfBatch {
    batch: SetBatch,
    activations: Activations,
    gradients: Gradients,
    outputs: OutputGradients,
    gradient: Vec<f32>,
    losses: Vec<f64>,
}

/// Buffers for gradients of large batches.
#[derive(Clone, Debug)]
pub struct BatchGradient {
    parts: Vec<PartOfBatch>,
    threads: usize,
}

impl BatchGradient {
    /// Creates buffers for a network; computes on up to `threads` threads.
    pub fn new(network: &SetNetwork, threads: usize) -> Self {
        let layout = network.layout();
        let part = PartOfBatch {
            batch: SetBatch::new(layout.features),
            activations: Activations::default(),
            gradients: Gradients::default(),
            outputs: OutputGradients::default(),
            gradient: vec![0.0; layout.len],
            losses: Vec::new(),
        };
        Self {
            parts: vec![part; PARTS],
            threads: threads.clamp(1, PARTS),
        }
    }

    /// Computes the gradient of the mean of a loss over `states` states and returns the means of
    /// the losses.
    ///
    /// `fill` adds states (a range of their indices) to a batch, and returns what their loss depends
    /// on besides the outputs. `loss` writes the gradient of the sum of the states' losses, and adds
    /// the losses to the last argument, as many numbers as are to be reported.
    pub fn gradient<T, F, L>(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        states: usize,
        fill: F,
        loss: L,
    ) -> (&[f32], Vec<f64>)
    where
        F: Fn(Range<usize>, &mut SetBatch) -> T + Sync,
        L: Fn(&T, &SetBatch, &Outputs, &mut OutputGradients, &mut Vec<f64>) + Sync,
    {
        let compute = |index: usize, part: &mut PartOfBatch| {
            part.gradient.fill(0.0);
            part.losses.clear();
            let Range { mut start, end } = part_of(index, states);
            while start < end {
                let range = start..(start + CHUNK).min(end);
                part.batch.clear();
                let labels = fill(range.clone(), &mut part.batch);
                part.activations.forward(arch, network, &part.batch);
                let outputs = part.activations.outputs();
                let gradient = &mut part.outputs;
                gradient.clear(part.batch.len(), part.batch.users());
                loss(&labels, &part.batch, outputs, gradient, &mut part.losses);
                part.gradients.backward(
                    arch,
                    network,
                    &part.batch,
                    &mut part.activations,
                    gradient,
                    &mut part.gradient,
                );
                start = range.end;
            }
        };
        for_each_part(&mut self.parts, self.threads, compute);
        let (sum, others) = self.parts.split_at_mut(1);
        let (sum, others) = (&mut sum[0], &*others);
        let mut losses = std::mem::take(&mut sum.losses);
        for part in others {
            add(arch, &mut sum.gradient, &part.gradient);
            for (loss, other) in losses.iter_mut().zip(&part.losses) {
                *loss += other;
            }
        }
        let scale = 1.0 / states as f32;
        sum.gradient.iter_mut().for_each(|g| *g *= scale);
        losses.iter_mut().for_each(|loss| *loss /= states as f64);
        (&sum.gradient, losses)
    }
}
