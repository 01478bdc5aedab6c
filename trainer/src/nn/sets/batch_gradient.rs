//! The gradient of a large batch, on threads, with a result that does not depend on their number.

use std::{ops::Range, thread};

use pulp::Arch;

use super::{
    backward::Gradients,
    batch::SetBatch,
    forward::Activations,
    functions::add,
    heads::{OutputGradients, Outputs},
    network::SetNetwork,
};

/// Number of parts of a batch. Each has a gradient of its own; they are added in order.
pub const PARTS: usize = 4;

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
    /// Number of states that are computed together: their activations fit into a second-level
    /// cache of 2 MiB, layer by layer.
    pub const CHUNK: usize = 16;

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
        let share = states.div_ceil(PARTS);
        let compute = |index: usize, part: &mut PartOfBatch| {
            part.gradient.fill(0.0);
            part.losses.clear();
            let end = ((index + 1) * share).min(states);
            let mut start = (index * share).min(end);
            while start < end {
                let range = start..(start + Self::CHUNK).min(end);
                part.batch.clear();
                let labels = fill(range.clone(), &mut part.batch);
                part.activations.forward(arch, network, &part.batch);
                let outputs = part.activations.outputs();
                let gradient = &mut part.outputs;
                gradient.displacement.clear();
                gradient.displacement.resize(part.batch.len(), [0.0; 2]);
                gradient.scores.clear();
                gradient.scores.resize(part.batch.users(), 0.0);
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
        let compute = &compute;
        let per_thread = PARTS.div_ceil(self.threads);
        thread::scope(|scope| {
            let mut groups = self.parts.chunks_mut(per_thread).enumerate();
            let first = groups.next();
            for (group, parts) in groups {
                scope.spawn(move || {
                    for (index, part) in parts.iter_mut().enumerate() {
                        compute(group * per_thread + index, part);
                    }
                });
            }
            for (index, part) in first.into_iter().flat_map(|(_, parts)| parts).enumerate() {
                compute(index, part);
            }
        });
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
