//! The network, as [`firmware_core::policy::sets`] defines it.

use firmware_core::policy::sets::{CANDIDATE_OUTPUTS, CANDIDATES, Precision, USERS};

use super::{
    operators::Operators,
    weights::{named_parts, transposed},
};
use crate::{
    imitation::trained::TrainedNetwork,
    nn::sets::layout::{HEADS, Part},
};

/// Subtracted where there is no user or sensor, before a maximum or a softmax.
const FAR_BELOW: f32 = 1e9;
/// Added to a variance.
const VARIANCE_OFFSET: f32 = 1e-5;
/// The factor of the pulls before their softmax.
const PULL_FACTOR: f32 = 3.0;

/// The masks, of shapes \[1, 16, 1\] and \[1, 64, 1\].
pub(super) struct Masks<'a> {
    pub(super) users: &'a str,
    pub(super) sensors: &'a str,
}

/// Writes the network with its weights.
pub(super) struct Writer<'a> {
    pub(super) g: Operators,
    width: i64,
    layers: usize,
    network: &'a TrainedNetwork,
    precision: Precision,
}

impl<'a> Writer<'a> {
    pub(super) fn new(network: &'a TrainedNetwork, precision: Precision) -> Self {
        Self {
            g: Operators::default(),
            width: network.architecture.width as i64,
            layers: network.architecture.layers,
            network,
            precision,
        }
    }

    /// Adds all weights.
    pub(super) fn weights(&mut self) {
        let mut rest = &self.network.parameters[..];
        let mut take = |count: usize| {
            let (taken, after) = rest.split_at(count);
            rest = after;
            taken
        };
        let (g, precision) = (&mut self.g, self.precision);
        for (name, part) in named_parts(self.network.architecture) {
            match part {
                Part::Scales(_, width) => {
                    g.weights(&name, &[width as i64], take(width), precision);
                }
                Part::Linear(linear) => {
                    let dims = [linear.inputs as i64, linear.outputs as i64];
                    let weights = transposed(take(linear.inputs * linear.outputs), linear.inputs);
                    g.weights(&format!("{name}.weight"), &dims, &weights, precision);
                    let bias = take(linear.outputs);
                    g.weights(&format!("{name}.bias"), &dims[1..], bias, precision);
                }
            }
        }
    }

    /// Returns the name of weights as they are used.
    fn weight(&self, name: &str) -> String {
        match self.precision {
            Precision::Single => name.into(),
            Precision::Half => format!("{name}.single"),
        }
    }

    fn linear(&mut self, name: &str, input: &str) -> String {
        let weight = self.weight(&format!("{name}.weight"));
        let bias = self.weight(&format!("{name}.bias"));
        let product = self.g.apply("MatMul", &[input, &weight]);
        self.g.apply("Add", &[&product, &bias])
    }

    /// Returns a linear map of each token of `own`, with the same `shared` token behind it. The map of
    /// that one is computed once. (tract 0.23 cannot optimise `Expand` and `Concat` before a product.)
    fn linear_of_both(&mut self, name: &str, own: &str, shared: &str) -> String {
        let weight = self.weight(&format!("{name}.weight"));
        let first = self.g.slice(&weight, 0, 0, self.width);
        let second = self.g.slice(&weight, 0, self.width, 2 * self.width);
        let own = self.g.apply("MatMul", &[own, &first]);
        let shared = self.g.apply("MatMul", &[shared, &second]);
        let sum = self.g.apply("Add", &[&own, &shared]);
        let bias = self.weight(&format!("{name}.bias"));
        self.g.apply("Add", &[&sum, &bias])
    }

    /// Returns two linear maps with `silu` between.
    fn perceptron(&mut self, inner: &str, outer: &str, input: &str) -> String {
        let hidden = self.linear(inner, input);
        let hidden = self.g.silu(&hidden);
        self.linear(outer, &hidden)
    }

    fn norm(&mut self, name: &str, input: &str) -> String {
        let scales = self.weight(name);
        let g = &mut self.g;
        let mean = g.reduce("ReduceMean", input, 2);
        let centred = g.apply("Sub", &[input, &mean]);
        let squares = g.apply("Mul", &[&centred, &centred]);
        let variance = g.reduce("ReduceMean", &squares, 2);
        let variance = g.with_number("Add", &variance, VARIANCE_OFFSET);
        let deviation = g.apply("Sqrt", &[&variance]);
        let normal = g.apply("Div", &[&centred, &deviation]);
        g.apply("Mul", &[&normal, &scales])
    }

    /// Returns 0 where a mask is 1, and a very small number where it is 0.
    fn exclusion(&mut self, mask: &str) -> String {
        let absent = self.g.with_number("Sub", mask, 1.0);
        self.g.with_number("Mul", &absent, FAR_BELOW)
    }

    /// Returns mean and maximum over the sensors, \[1, 1, 2 D\].
    fn pool(&mut self, sensors: &str, mask: &str) -> String {
        let hidden = self.perceptron("sensor_in", "sensor_out", sensors);
        let exclusion = self.exclusion(mask);
        let g = &mut self.g;
        let count = g.sum(mask, 1);
        let present = g.apply("Mul", &[&hidden, mask]);
        let total = g.sum(&present, 1);
        let mean = g.divide_at_least(&total, &count, 1.0);
        let candidates = g.apply("Add", &[&hidden, &exclusion]);
        let largest = g.reduce("ReduceMax", &candidates, 1);
        // 0 without any sensor.
        let any = g.with_number("Min", &count, 1.0);
        let largest = g.apply("Mul", &[&largest, &any]);
        g.along("Concat", &[&mean, &largest], 2)
    }

    /// Returns the tokens of the mission and of the users, \[1, 17, D\], after all layers.
    pub(super) fn tokens(
        &mut self,
        [mission, users, sensors]: [&str; 3],
        masks: &Masks<'_>,
    ) -> String {
        let pool = self.pool(sensors, masks.sensors);
        let mission = self.g.along("Concat", &[mission, &pool], 2);
        let mission = self.linear("mission", &mission);
        let users = self.linear("user", users);
        let mut tokens = self.g.along("Concat", &[&mission, &users], 1);
        let one = self.g.number(1.0);
        let mask = self.g.along("Concat", &[&one, masks.users], 1);
        let exclusion = self.exclusion(&mask);
        let exclusion = self.g.reshape(&exclusion, &[1, 1, 1, USERS as i64 + 1]);
        for layer in 0..self.layers {
            let name = |part: &str| format!("layer{layer}.{part}");
            let input = self.norm(&name("attention_norm"), &tokens);
            let qkv = self.linear(&name("qkv"), &input);
            let mixed = self.attention(&qkv, &exclusion);
            let mixed = self.linear(&name("mix"), &mixed);
            tokens = self.g.apply("Add", &[&tokens, &mixed]);
            let input = self.norm(&name("hidden_norm"), &tokens);
            let hidden = self.perceptron(&name("up"), &name("down"), &input);
            tokens = self.g.apply("Add", &[&tokens, &hidden]);
        }
        self.norm("final_norm", &tokens)
    }

    fn attention(&mut self, qkv: &str, exclusion: &str) -> String {
        let (width, tokens, heads) = (self.width, USERS as i64 + 1, HEADS as i64);
        let g = &mut self.g;
        let split = g.thirds(qkv, width).map(|part| {
            let parts = g.reshape(&part, &[1, tokens, heads, width / heads]);
            g.transpose(&parts, &[0, 2, 1, 3])
        });
        let [queries, keys, values] = &split;
        let keys = g.transpose(keys, &[0, 1, 3, 2]);
        let scores = g.apply("MatMul", &[queries, &keys]);
        let factor = 1.0 / ((width / heads) as f32).sqrt();
        let scores = g.with_number("Mul", &scores, factor);
        let scores = g.apply("Add", &[&scores, exclusion]);
        let weights = g.along("Softmax", &[&scores], 3);
        let averages = g.apply("MatMul", &[&weights, values]);
        let averages = g.transpose(&averages, &[0, 2, 1, 3]);
        g.reshape(&averages, &[1, tokens, width])
    }

    /// Writes the outputs from the tokens; `places` are those of the users, \[1, 16, 2\], and
    /// `destination` that of the destination, \[1, 1, 2\], both relative, metres.
    pub(super) fn heads(
        &mut self,
        tokens: &str,
        [places, destination, reach]: [&str; 3],
        masks: &Masks<'_>,
    ) {
        let users = USERS as i64;
        let mission = self.g.slice(tokens, 1, 0, 1);
        let own = self.g.slice(tokens, 1, 1, 1 + users);
        let motion = self.perceptron("displacement_in", "displacement_out", &mission);
        let hidden = self.linear_of_both("user_in", &own, &mission);
        let hidden = self.g.silu(&hidden);
        let per_user = self.linear("user_out", &hidden);
        let exclusion = self.exclusion(masks.users);
        let g = &mut self.g;
        // [1, 1, 5] of the chosen candidate, and 1 or 0 per candidate.
        let (candidates, size) = (CANDIDATES as i64, CANDIDATE_OUTPUTS as i64);
        let all = g.reshape(&motion, &[1, candidates, size]);
        let logits = g.slice(&all, 2, size - 1, size);
        let first = g.first_largest(&logits, 1);
        let indices: Vec<i64> = (0..candidates).collect();
        let indices = g.integers(&indices);
        let indices = g.reshape(&indices, &[1, candidates, 1]);
        let chosen = g.equal(&indices, &first);
        let motion = g.apply("Mul", &[&all, &chosen]);
        let motion = g.sum(&motion, 1);
        let chosen = g.reshape(&chosen, &[1, 1, candidates]);
        let scores = g.slice(&per_user, 2, 0, 1);
        let scores = g.apply("Mul", &[&scores, masks.users]);
        let dims = g.integers(&[1, users]);
        g.graph.node("Reshape", &[&scores, &dims], "user_scores");

        let pulls = g.slice(&per_user, 2, 1, 1 + candidates);
        let pulls = g.apply("Mul", &[&pulls, &chosen]);
        let pulls = g.sum(&pulls, 2);
        let pulls = g.with_number("Mul", &pulls, PULL_FACTOR);
        let pulls = g.apply("Add", &[&pulls, &exclusion]);
        let weights = g.along("Softmax", &[&pulls], 1);
        let weighted = g.apply("Mul", &[&weights, places]);
        let meeting_point = g.sum(&weighted, 1);
        let free = g.slice(&motion, 2, 0, 2);
        let mut sum = free;
        for (index, place) in [(2, &*meeting_point), (3, destination)] {
            let gate = g.slice(&motion, 2, index, index + 1);
            let gate = g.apply("Sigmoid", &[&gate]);
            let part = g.apply("Mul", &[&gate, place]);
            let part = g.apply("Div", &[&part, reach]);
            sum = g.apply("Add", &[&sum, &part]);
        }
        let squares = g.apply("Mul", &[&sum, &sum]);
        let square = g.sum(&squares, 2);
        let length = g.apply("Sqrt", &[&square]);
        let unit = g.divide_at_least(&sum, &length, 1.0);
        let displacement = g.apply("Mul", &[&unit, reach]);
        let dims = g.integers(&[1, 2]);
        g.graph
            .node("Reshape", &[&displacement, &dims], "displacement");
    }
}
