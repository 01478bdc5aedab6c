//! The backward pass.

use pulp::Arch;

use super::{
    batch::SetBatch,
    forward::{Activations, BlockActivations, Hidden},
    functions::{add, multiply},
    heads::OutputGradients,
    layout::{Block, Linear},
    linear,
    network::SetNetwork,
    pool, resize,
};

/// The buffers of a backward pass.
#[derive(Clone, Debug, Default)]
pub struct Gradients {
    /// Of the tokens, from the last layer to the first.
    tokens: Vec<f32>,
    /// Of what follows a norm.
    normalized: Vec<f32>,
    hidden: Vec<f32>,
    qkv: Vec<f32>,
    mission: Vec<f32>,
    sensors: Vec<f32>,
}

impl Gradients {
    /// Back-propagates the gradient of the outputs through the last forward pass, and adds the
    /// gradient of all parameters to `gradient`. Overwrites some of the activations.
    pub fn backward(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        activations: &mut Activations,
        outputs: &OutputGradients,
        gradient: &mut [f32],
    ) {
        let layout = network.layout();
        let rows = batch.tokens();
        let len = rows * layout.architecture.width;
        self.heads(arch, network, batch, activations, outputs, gradient);
        // `normalized` now has the gradient of the final tokens.
        let tokens = resize(&mut self.tokens, len);
        tokens.fill(0.0);
        let start = layout.final_norm;
        let scales = network.scales(start);
        let d_scales = &mut gradient[start..start + scales.len()];
        let norm = &activations.final_norm;
        norm.backward(arch, scales, rows, &self.normalized, d_scales, tokens);
        let blocks = layout.blocks.iter().zip(&activations.blocks);
        for (block, buffers) in blocks.rev() {
            self.block(arch, network, batch, (block, buffers), gradient);
        }
        self.embedding(arch, network, batch, activations, gradient);
    }

    /// Computes the gradient of the final tokens.
    fn heads(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        activations: &mut Activations,
        outputs: &OutputGradients,
        gradient: &mut [f32],
    ) {
        let layout = network.layout();
        let width = layout.architecture.width;
        let (states, users) = (batch.len(), batch.users());
        let mut displacement = std::mem::take(&mut activations.displacement);
        let mut scored = std::mem::take(&mut activations.users);
        let forward = activations.outputs();
        forward.backward(batch, outputs, &mut displacement, &mut scored);

        let linears = [&layout.displacement_in, &layout.displacement_out];
        let hidden = &activations.displacement_hidden;
        self.two_layers(arch, network, linears, (states, hidden), &displacement);
        let (inputs, d_hidden) = (&activations.mission_tokens, &self.hidden);
        let [first, second] = linears;
        linear::backward_parameters(
            arch,
            second,
            states,
            &hidden.values,
            &displacement,
            gradient,
        );
        linear::backward_parameters(arch, first, states, inputs, d_hidden, gradient);
        let d_mission = resize(&mut self.mission, states * width);
        linear::backward_inputs(arch, network, first, states, d_hidden, d_mission, false);

        let linears = [&layout.user_in, &layout.user_out];
        let hidden = &activations.user_hidden;
        self.two_layers(arch, network, linears, (users, hidden), &scored);
        let (inputs, d_hidden) = (&activations.user_tokens, &self.hidden);
        let [first, second] = linears;
        linear::backward_parameters(arch, second, users, &hidden.values, &scored, gradient);
        linear::backward_parameters(arch, first, users, inputs, d_hidden, gradient);
        let d_users = resize(&mut self.qkv, users * 2 * width);
        linear::backward_inputs(arch, network, first, users, d_hidden, d_users, false);

        let d_final = resize(&mut self.normalized, batch.tokens() * width);
        for state in 0..states {
            let start = batch.tokens_of(state).start * width;
            let (d_mission_token, d_user_tokens) = d_final[start..].split_at_mut(width);
            d_mission_token.copy_from_slice(&self.mission[state * width..(state + 1) * width]);
            let users = batch.users_of(state);
            let rows = self.qkv[users.start * 2 * width..users.end * 2 * width].chunks(2 * width);
            for (row, d_token) in rows.zip(d_user_tokens.chunks_mut(width)) {
                d_token.copy_from_slice(&row[..width]);
                add(arch, d_mission_token, &row[width..]);
            }
        }
        activations.displacement = displacement;
        activations.users = scored;
    }

    /// Computes, in `hidden`, the gradient of what goes into SiLU between two linear layers.
    fn two_layers(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        [first, second]: [&Linear; 2],
        (rows, hidden): (usize, &Hidden),
        d_outputs: &[f32],
    ) {
        let d_hidden = resize(&mut self.hidden, rows * first.columns());
        linear::backward_inputs(arch, network, second, rows, d_outputs, d_hidden, false);
        multiply(arch, d_hidden, &hidden.derivatives);
    }

    /// Back-propagates the gradient of the tokens through one layer.
    fn block(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        (block, buffers): (&Block, &BlockActivations),
        gradient: &mut [f32],
    ) {
        let width = network.layout().architecture.width;
        let rows = batch.tokens();
        let len = rows * width;
        let mut tokens = std::mem::take(&mut self.tokens);

        let BlockActivations {
            attention_norm,
            hidden_norm,
            hidden,
            attention,
            qkv,
            attended,
        } = buffers;
        let linears = [&block.up, &block.down];
        self.two_layers(arch, network, linears, (rows, hidden), &tokens);
        let (values, d_hidden) = (&hidden.values, &self.hidden);
        linear::backward_parameters(arch, &block.down, rows, values, &tokens, gradient);
        let inputs = &hidden_norm.output;
        linear::backward_parameters(arch, &block.up, rows, inputs, d_hidden, gradient);
        let d_normalized = resize(&mut self.normalized, len);
        linear::backward_inputs(
            arch,
            network,
            &block.up,
            rows,
            d_hidden,
            d_normalized,
            false,
        );
        let scales = network.scales(block.hidden_norm);
        let d_scales = &mut gradient[block.hidden_norm..block.hidden_norm + width];
        hidden_norm.backward(arch, scales, rows, d_normalized, d_scales, &mut tokens);

        linear::backward_parameters(arch, &block.mix, rows, attended, &tokens, gradient);
        let d_attended = d_normalized;
        linear::backward_inputs(arch, network, &block.mix, rows, &tokens, d_attended, false);
        let d_qkv = resize(&mut self.qkv, 3 * len);
        attention.backward(arch, batch, width, qkv, d_attended, d_qkv);
        let inputs = &attention_norm.output;
        linear::backward_parameters(arch, &block.qkv, rows, inputs, d_qkv, gradient);
        let d_normalized = d_attended;
        linear::backward_inputs(arch, network, &block.qkv, rows, d_qkv, d_normalized, false);
        let scales = network.scales(block.attention_norm);
        let d_scales = &mut gradient[block.attention_norm..block.attention_norm + width];
        attention_norm.backward(arch, scales, rows, d_normalized, d_scales, &mut tokens);
        self.tokens = tokens;
    }

    /// Back-propagates the gradient of the first tokens to the parameters that computed them.
    fn embedding(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        activations: &Activations,
        gradient: &mut [f32],
    ) {
        let layout = network.layout();
        let width = layout.architecture.width;
        let (states, users, sensors) = (batch.len(), batch.users(), batch.sensors());
        let d_users = resize(&mut self.normalized, users * width);
        let d_missions = resize(&mut self.mission, states * width);
        for state in 0..states {
            let (to, from) = (batch.users_of(state), batch.tokens_of(state));
            let tokens = &self.tokens[from.start * width..from.end * width];
            let (mission, users) = tokens.split_at(width);
            d_missions[state * width..(state + 1) * width].copy_from_slice(mission);
            d_users[to.start * width..to.end * width].copy_from_slice(users);
        }
        linear::backward_parameters(arch, &layout.user, users, &batch.users, d_users, gradient);
        let mission = &layout.mission;
        let inputs = &activations.mission;
        linear::backward_parameters(arch, mission, states, inputs, d_missions, gradient);
        let d_inputs = resize(&mut self.qkv, states * mission.stride());
        linear::backward_inputs(arch, network, mission, states, d_missions, d_inputs, false);

        let d_sensors = resize(&mut self.sensors, sensors * width);
        let pooled = (&d_inputs[..], mission.stride(), layout.features.mission);
        let largest = &activations.largest;
        pool::backward(arch, batch, width, pooled, largest, d_sensors);
        let linears = [&layout.sensor_in, &layout.sensor_out];
        let hidden = &activations.sensor_hidden;
        let d_sensors = std::mem::take(&mut self.sensors);
        self.two_layers(arch, network, linears, (sensors, hidden), &d_sensors);
        let [first, second] = linears;
        let (values, d_hidden) = (&hidden.values, &self.hidden);
        linear::backward_parameters(arch, second, sensors, values, &d_sensors, gradient);
        let inputs = &batch.sensors;
        linear::backward_parameters(arch, first, sensors, inputs, d_hidden, gradient);
        self.sensors = d_sensors;
    }
}
