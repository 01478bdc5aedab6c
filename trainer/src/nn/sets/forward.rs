//! The forward pass, and the buffers that the backward pass reads.

use pulp::Arch;

use super::{
    super::product::padded,
    attention::Attention,
    batch::SetBatch,
    functions::{add, silu},
    heads::Outputs,
    layout::Linear,
    linear,
    network::SetNetwork,
    norm::Norm,
    pool, resize,
};

/// A hidden layer with SiLU: its outputs and their derivatives by what went into SiLU.
#[derive(Clone, Debug, Default)]
pub(super) struct Hidden {
    pub(super) values: Vec<f32>,
    pub(super) derivatives: Vec<f32>,
}

impl Hidden {
    /// Computes the outputs for `rows` rows of inputs.
    fn forward(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        linear: &Linear,
        rows: usize,
        x: &[f32],
    ) {
        let len = rows * linear.columns();
        let values = resize(&mut self.values, len);
        linear::forward(arch, network, linear, rows, x, values);
        silu(arch, values, resize(&mut self.derivatives, len));
    }
}

/// The buffers of one transformer layer.
#[derive(Clone, Debug, Default)]
pub(super) struct BlockActivations {
    pub(super) attention_norm: Norm,
    pub(super) qkv: Vec<f32>,
    pub(super) attention: Attention,
    pub(super) attended: Vec<f32>,
    pub(super) hidden_norm: Norm,
    pub(super) hidden: Hidden,
}

/// The buffers of a forward pass.
#[derive(Clone, Debug, Default)]
pub struct Activations {
    pub(super) sensor_hidden: Hidden,
    pub(super) sensors: Vec<f32>,
    /// The sensor with the maximum, for each state and feature.
    pub(super) largest: Vec<u32>,
    /// Mission and pooled sensors.
    pub(super) mission: Vec<f32>,
    pub(super) blocks: Vec<BlockActivations>,
    pub(super) final_norm: Norm,
    /// The final tokens of the missions.
    pub(super) mission_tokens: Vec<f32>,
    pub(super) displacement_hidden: Hidden,
    pub(super) displacement: Vec<f32>,
    /// The final tokens of each user and of its mission.
    pub(super) user_tokens: Vec<f32>,
    pub(super) user_hidden: Hidden,
    pub(super) users: Vec<f32>,
    tokens: Vec<f32>,
    change: Vec<f32>,
    embedded: Vec<f32>,
    outputs: Outputs,
}

impl Activations {
    /// Returns the outputs of the last [`forward`](Self::forward).
    pub fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// Computes the outputs of a batch.
    pub fn forward(&mut self, arch: Arch, network: &SetNetwork, batch: &SetBatch) {
        let layout = network.layout();
        let width = layout.architecture.width;
        self.embed(arch, network, batch);
        let rows = batch.tokens();
        self.blocks
            .resize_with(layout.blocks.len(), Default::default);
        let tokens = &mut self.tokens[..rows * width];
        let change = resize(&mut self.change, rows * width);
        for (block, buffers) in layout.blocks.iter().zip(&mut self.blocks) {
            let scales = network.scales(block.attention_norm);
            buffers.attention_norm.forward(arch, scales, rows, tokens);
            let qkv = resize(&mut buffers.qkv, rows * 3 * width);
            let normalized = &buffers.attention_norm.output;
            linear::forward(arch, network, &block.qkv, rows, normalized, qkv);
            let attended = resize(&mut buffers.attended, rows * width);
            (buffers.attention).forward(arch, batch, width, qkv, attended);
            linear::forward(arch, network, &block.mix, rows, attended, change);
            add(arch, tokens, change);

            let scales = network.scales(block.hidden_norm);
            buffers.hidden_norm.forward(arch, scales, rows, tokens);
            let normalized = &buffers.hidden_norm.output;
            (buffers.hidden).forward(arch, network, &block.up, rows, normalized);
            let hidden = &buffers.hidden.values;
            linear::forward(arch, network, &block.down, rows, hidden, change);
            add(arch, tokens, change);
        }
        let scales = network.scales(layout.final_norm);
        self.final_norm.forward(arch, scales, rows, tokens);
        self.act(arch, network, batch);
    }

    /// Computes the first tokens.
    fn embed(&mut self, arch: Arch, network: &SetNetwork, batch: &SetBatch) {
        let layout = network.layout();
        let width = layout.architecture.width;
        let sensors = batch.sensors();
        let hidden = &mut self.sensor_hidden;
        hidden.forward(arch, network, &layout.sensor_in, sensors, &batch.sensors);
        let encoded = resize(&mut self.sensors, sensors * width);
        linear::forward(
            arch,
            network,
            &layout.sensor_out,
            sensors,
            &hidden.values,
            encoded,
        );

        let (stride, features) = (layout.mission.stride(), layout.features.mission);
        self.mission.clear();
        self.mission.resize(batch.len() * stride, 0.0);
        let rows = self.mission.chunks_exact_mut(stride);
        for (row, mission) in rows.zip(batch.mission.chunks_exact(features)) {
            row[..features].copy_from_slice(mission);
        }
        let out = (&mut self.mission[..], stride, features);
        pool::forward(arch, batch, width, encoded, out, &mut self.largest);

        let tokens = resize(&mut self.tokens, batch.tokens() * width);
        let users = batch.users();
        let embedded = resize(&mut self.embedded, users.max(batch.len()) * width);
        linear::forward(arch, network, &layout.user, users, &batch.users, embedded);
        for state in 0..batch.len() {
            let (from, to) = (batch.users_of(state), batch.tokens_of(state));
            tokens[(to.start + 1) * width..to.end * width]
                .copy_from_slice(&embedded[from.start * width..from.end * width]);
        }
        let states = batch.len();
        linear::forward(
            arch,
            network,
            &layout.mission,
            states,
            &self.mission,
            embedded,
        );
        for (state, row) in embedded.chunks_exact(width).take(states).enumerate() {
            let start = batch.tokens_of(state).start * width;
            tokens[start..start + width].copy_from_slice(row);
        }
    }

    /// Computes the outputs from the final tokens.
    fn act(&mut self, arch: Arch, network: &SetNetwork, batch: &SetBatch) {
        let layout = network.layout();
        let width = layout.architecture.width;
        let (states, users) = (batch.len(), batch.users());
        let tokens = &self.final_norm.output;
        self.mission_tokens.clear();
        self.user_tokens.clear();
        for state in 0..states {
            let mut rows = tokens[batch.tokens_of(state).start * width..].chunks_exact(width);
            let mission = rows.next().unwrap_or_default();
            self.mission_tokens.extend_from_slice(mission);
            for user in rows.take(batch.users_of(state).len()) {
                self.user_tokens.extend_from_slice(user);
                self.user_tokens.extend_from_slice(mission);
            }
        }
        let hidden = &mut self.user_hidden;
        let (first, second) = (&layout.user_in, &layout.user_out);
        debug_assert_eq!(first.stride(), padded(2 * width));
        hidden.forward(arch, network, first, users, &self.user_tokens);
        let scored = resize(&mut self.users, users * second.columns());
        linear::forward(arch, network, second, users, &hidden.values, scored);
        let Some([first, second]) = &layout.displacement else {
            self.outputs.forward_values(batch, scored);
            return;
        };
        let hidden = &mut self.displacement_hidden;
        hidden.forward(arch, network, first, states, &self.mission_tokens);
        let displacement = resize(&mut self.displacement, states * second.columns());
        linear::forward(arch, network, second, states, &hidden.values, displacement);
        self.outputs.forward(batch, displacement, scored);
    }
}
