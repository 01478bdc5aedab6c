//! The backward pass.

use pulp::Arch;

use super::{
    batch::SetBatch,
    forward::{Activations, BlockActivations, Hidden},
    functions::{add, multiply},
    heads::OutputGradients,
    layout::{Block, Layout, Linear},
    linear,
    network::SetNetwork,
    norm::Norm,
    pool, resize,
};

/// Where the gradient of the parameters is added, if it is wanted.
struct ParameterGradient<'a>(Option<&'a mut [f32]>);

impl ParameterGradient<'_> {
    /// Adds the gradient of a linear layer with the inputs `x`, from that of its outputs.
    fn add_linear(&mut self, arch: Arch, linear: &Linear, rows: usize, x: &[f32], dy: &[f32]) {
        if let Some(gradient) = &mut self.0 {
            linear::backward_parameters(arch, linear, rows, x, dy, gradient);
        }
    }

    /// Back-propagates through a norm whose scales start at `start`, and adds their gradient.
    fn add_norm(
        &mut self,
        arch: Arch,
        (network, norm): (&SetNetwork, &Norm),
        start: usize,
        dy: &[f32],
        dx: &mut [f32],
    ) {
        let scales = network.scales(start);
        let rows = dy.len() / scales.len();
        match &mut self.0 {
            Some(gradient) => {
                let d_scales = &mut gradient[start..start + scales.len()];
                norm.backward(arch, scales, rows, dy, d_scales, dx);
            }
            None => norm.backward(arch, scales, rows, dy, &mut vec![0.0; scales.len()], dx),
        }
    }
}

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
    /// Of the inputs of the mission's layer: features and pooled sensors.
    inputs: Vec<f32>,
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
        let mut gradient = ParameterGradient(Some(gradient));
        self.pass(arch, network, batch, activations, outputs, &mut gradient);
        self.embedding(arch, network, batch, activations, &mut gradient);
    }

    /// Like [`backward`](Self::backward), but computes only the gradient of the features of the
    /// missions, which [`mission`](Self::mission) returns.
    pub fn backward_to_missions(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        activations: &mut Activations,
        outputs: &OutputGradients,
    ) {
        let mut gradient = ParameterGradient(None);
        self.pass(arch, network, batch, activations, outputs, &mut gradient);
        self.missions(arch, network, batch, activations, &mut gradient);
    }

    /// Returns the gradient of the features of the mission of a state, as the last pass computed it.
    pub fn mission(&self, layout: &Layout, state: usize) -> &[f32] {
        let start = state * layout.mission.stride();
        &self.inputs[start..start + layout.features.mission]
    }

    /// Back-propagates to the first tokens.
    fn pass(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        activations: &mut Activations,
        outputs: &OutputGradients,
        gradient: &mut ParameterGradient<'_>,
    ) {
        let layout = network.layout();
        let len = batch.tokens() * layout.architecture.width;
        self.heads(arch, network, batch, activations, outputs, gradient);
        // `normalized` now has the gradient of the final tokens.
        let tokens = resize(&mut self.tokens, len);
        tokens.fill(0.0);
        let norm = (network, &activations.final_norm);
        let d_normalized = &self.normalized[..len];
        gradient.add_norm(arch, norm, layout.final_norm, d_normalized, tokens);
        let blocks = layout.blocks.iter().zip(&activations.blocks);
        for (block, buffers) in blocks.rev() {
            self.block(arch, network, batch, (block, buffers), gradient);
        }
    }

    /// Computes the gradient of the final tokens.
    fn heads(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        activations: &mut Activations,
        outputs: &OutputGradients,
        gradient: &mut ParameterGradient<'_>,
    ) {
        let layout = network.layout();
        let width = layout.architecture.width;
        let (states, users) = (batch.len(), batch.users());
        let mut displacement = std::mem::take(&mut activations.displacement);
        let mut scored = std::mem::take(&mut activations.users);
        let forward = activations.outputs();
        match layout.displacement {
            Some(_) => forward.backward(batch, outputs, &mut displacement, &mut scored),
            None => forward.backward_values(outputs, &mut scored),
        }

        let d_mission = resize(&mut self.mission, states * width);
        d_mission.fill(0.0);
        if let Some([first, second]) = &layout.displacement {
            let hidden = &activations.displacement_hidden;
            self.two_layers(
                arch,
                network,
                [first, second],
                (states, hidden),
                &displacement,
            );
            let (inputs, d_hidden) = (&activations.mission_tokens, &self.hidden);
            gradient.add_linear(arch, second, states, &hidden.values, &displacement);
            gradient.add_linear(arch, first, states, inputs, d_hidden);
            let d_mission = &mut self.mission;
            linear::backward_inputs(arch, network, first, states, d_hidden, d_mission, false);
        }

        let linears = [&layout.user_in, &layout.user_out];
        let hidden = &activations.user_hidden;
        self.two_layers(arch, network, linears, (users, hidden), &scored);
        let (inputs, d_hidden) = (&activations.user_tokens, &self.hidden);
        let [first, second] = linears;
        gradient.add_linear(arch, second, users, &hidden.values, &scored);
        gradient.add_linear(arch, first, users, inputs, d_hidden);
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
        gradient: &mut ParameterGradient<'_>,
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
        gradient.add_linear(arch, &block.down, rows, values, &tokens);
        gradient.add_linear(arch, &block.up, rows, &hidden_norm.output, d_hidden);
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
        let norm = (network, hidden_norm);
        gradient.add_norm(
            arch,
            norm,
            block.hidden_norm,
            d_normalized,
            &mut tokens[..len],
        );

        gradient.add_linear(arch, &block.mix, rows, attended, &tokens);
        let d_attended = d_normalized;
        linear::backward_inputs(arch, network, &block.mix, rows, &tokens, d_attended, false);
        let d_qkv = resize(&mut self.qkv, 3 * len);
        attention.backward(arch, batch, width, qkv, d_attended, d_qkv);
        gradient.add_linear(arch, &block.qkv, rows, &attention_norm.output, d_qkv);
        let d_normalized = d_attended;
        linear::backward_inputs(arch, network, &block.qkv, rows, d_qkv, d_normalized, false);
        let norm = (network, attention_norm);
        let start = block.attention_norm;
        gradient.add_norm(arch, norm, start, d_normalized, &mut tokens[..len]);
        self.tokens = tokens;
    }

    /// Back-propagates the gradient of the missions' first tokens to their features and the pooled
    /// sensors.
    fn missions(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        activations: &Activations,
        gradient: &mut ParameterGradient<'_>,
    ) {
        let layout = network.layout();
        let width = layout.architecture.width;
        let states = batch.len();
        let d_missions = resize(&mut self.mission, states * width);
        for (state, row) in d_missions.chunks_exact_mut(width).enumerate() {
            let start = batch.tokens_of(state).start * width;
            row.copy_from_slice(&self.tokens[start..start + width]);
        }
        let mission = &layout.mission;
        gradient.add_linear(arch, mission, states, &activations.mission, d_missions);
        let d_inputs = resize(&mut self.inputs, states * mission.stride());
        linear::backward_inputs(arch, network, mission, states, d_missions, d_inputs, false);
    }

    /// Back-propagates the gradient of the first tokens to the parameters that computed them.
    fn embedding(
        &mut self,
        arch: Arch,
        network: &SetNetwork,
        batch: &SetBatch,
        activations: &Activations,
        gradient: &mut ParameterGradient<'_>,
    ) {
        let layout = network.layout();
        let width = layout.architecture.width;
        let (states, users, sensors) = (batch.len(), batch.users(), batch.sensors());
        self.missions(arch, network, batch, activations, gradient);
        let d_users = resize(&mut self.normalized, users * width);
        for state in 0..states {
            let (to, from) = (batch.users_of(state), batch.tokens_of(state));
            let users = &self.tokens[(from.start + 1) * width..from.end * width];
            d_users[to.start * width..to.end * width].copy_from_slice(users);
        }
        gradient.add_linear(arch, &layout.user, users, &batch.users, d_users);

        let d_sensors = resize(&mut self.sensors, sensors * width);
        let mission = &layout.mission;
        let pooled = (&self.inputs[..], mission.stride(), layout.features.mission);
        let largest = &activations.largest;
        pool::backward(arch, batch, width, pooled, largest, d_sensors);
        let linears = [&layout.sensor_in, &layout.sensor_out];
        let hidden = &activations.sensor_hidden;
        let d_sensors = std::mem::take(&mut self.sensors);
        self.two_layers(arch, network, linears, (sensors, hidden), &d_sensors);
        let [first, second] = linears;
        let (values, d_hidden) = (&hidden.values, &self.hidden);
        gradient.add_linear(arch, second, sensors, values, &d_sensors);
        gradient.add_linear(arch, first, sensors, &batch.sensors, d_hidden);
        self.sensors = d_sensors;
    }
}
