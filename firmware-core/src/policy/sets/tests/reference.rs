// SPDX-License-Identifier: MIT OR Apache-2.0
//! The network as the module's table defines it, in double precision, and networks with random
//! weights.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::{vec, vec::Vec as StdVec};

use crate::policy::sets::{features::*, *};

/// Random weights of the usual size for their number of inputs.
pub(super) fn weights(random: &mut Pcg64Mcg, architecture: &Architecture) -> StdVec<f32> {
    let (width, hidden) = (architecture.width.into(), architecture.hidden.into());
    let mut all = StdVec::new();
    let mut linear = |all: &mut StdVec<f32>, inputs: usize, outputs: usize| {
        let most = 2.0 / (inputs as f32).sqrt();
        all.extend((0..inputs * outputs).map(|_| random.random_range(-most..most)));
        all.extend((0..outputs).map(|_| random.random_range(-0.3_f32..0.3)));
    };
    let norm = |all: &mut StdVec<f32>| all.extend((0..width).map(|i| 0.7 + 0.01 * i as f32));
    linear(&mut all, SENSOR_FEATURES, width);
    linear(&mut all, width, width);
    linear(&mut all, MISSION_FEATURES + 2 * width, width);
    linear(&mut all, USER_FEATURES, width);
    for _ in 0..architecture.layers {
        norm(&mut all);
        linear(&mut all, width, 3 * width);
        linear(&mut all, width, width);
        norm(&mut all);
        linear(&mut all, width, hidden);
        linear(&mut all, hidden, width);
    }
    norm(&mut all);
    linear(&mut all, width, width);
    linear(&mut all, width, 15);
    linear(&mut all, 2 * width, width);
    linear(&mut all, width, 4);
    assert_eq!(all.len(), architecture.weight_count());
    all
}

type Vector = StdVec<f64>;

/// Reads weights in their order.
struct Reader<'a>(&'a [f32]);

struct Linear<'a> {
    matrix: &'a [f32],
    bias: &'a [f32],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> &'a [f32] {
        let (taken, rest) = self.0.split_at(count);
        self.0 = rest;
        taken
    }

    fn linear(&mut self, inputs: usize, outputs: usize) -> Linear<'a> {
        Linear {
            matrix: self.take(inputs * outputs),
            bias: self.take(outputs),
        }
    }
}

impl Linear<'_> {
    fn of(&self, x: &[f64]) -> Vector {
        let rows = self.matrix.chunks(x.len()).zip(self.bias);
        let product = |row: &[f32]| {
            row.iter()
                .zip(x)
                .map(|(w, x)| f64::from(*w) * x)
                .sum::<f64>()
        };
        rows.map(|(row, bias)| product(row) + f64::from(*bias))
            .collect()
    }
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn silu(x: Vector) -> Vector {
    x.into_iter().map(|x| x * sigmoid(x)).collect()
}

fn norm(scale: &[f32], x: &[f64]) -> Vector {
    let count = x.len() as f64;
    let mean = x.iter().sum::<f64>() / count;
    let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count;
    let normal = |x: &f64| (x - mean) / (variance + 1e-5).sqrt();
    x.iter()
        .zip(scale)
        .map(|(x, s)| normal(x) * f64::from(*s))
        .collect()
}

fn softmax(x: &[f64]) -> Vector {
    let largest = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let exponentials: Vector = x.iter().map(|x| (x - largest).exp()).collect();
    let total: f64 = exponentials.iter().sum();
    exponentials.into_iter().map(|x| x / total).collect()
}

fn add(to: &mut [f64], x: &[f64]) {
    to.iter_mut().zip(x).for_each(|(to, x)| *to += x);
}

fn double(x: &[f32]) -> Vector {
    x.iter().copied().map(f64::from).collect()
}

/// Displacement and scores.
pub(super) fn evaluate(
    architecture: &Architecture,
    weights: &[f32],
    observation: &SetsObservation,
) -> (Vector, Vector) {
    let (width, hidden) = (
        usize::from(architecture.width),
        usize::from(architecture.hidden),
    );
    let mut reader = Reader(weights);
    let (first, second) = (
        reader.linear(SENSOR_FEATURES, width),
        reader.linear(width, width),
    );
    let sensors: StdVec<Vector> = observation
        .sensor_rows()
        .iter()
        .map(|sensor| second.of(&silu(first.of(&double(&sensor_features(sensor))))))
        .collect();
    let mut input = double(&mission_features(&observation.mission));
    let column = |i: usize| sensors.iter().map(move |h| h[i]);
    input.extend((0..width).map(|i| column(i).sum::<f64>() / sensors.len() as f64));
    input.extend((0..width).map(|i| column(i).fold(f64::NEG_INFINITY, f64::max)));
    let mut tokens = vec![reader.linear(input.len(), width).of(&input)];
    let users = reader.linear(USER_FEATURES, width);
    for user in observation.user_rows() {
        let features = user_features(&observation.mission, user);
        tokens.push(users.of(&double(&features)));
    }
    for _ in 0..architecture.layers {
        let scale = reader.take(width);
        let linear = reader.linear(width, 3 * width);
        let merge = reader.linear(width, width);
        let maps: StdVec<Vector> = tokens.iter().map(|z| linear.of(&norm(scale, z))).collect();
        let size = width / 4;
        for (token, own) in tokens.iter_mut().zip(&maps) {
            let mut output = vec![0.0; width];
            for head in 0..4 {
                let part = |i: usize| i * width + head * size..i * width + (head + 1) * size;
                let product = |other: &Vector| {
                    let pairs = own[part(0)].iter().zip(&other[part(1)]);
                    pairs.map(|(q, k)| q * k).sum::<f64>() / (size as f64).sqrt()
                };
                let scores: Vector = maps.iter().map(product).collect();
                for (weight, other) in softmax(&scores).into_iter().zip(&maps) {
                    let value: Vector = other[part(2)].iter().map(|v| weight * v).collect();
                    add(&mut output[part(0)], &value);
                }
            }
            add(token, &merge.of(&output));
        }
        let scale = reader.take(width);
        let (first, second) = (reader.linear(width, hidden), reader.linear(hidden, width));
        for token in &mut tokens {
            let change = second.of(&silu(first.of(&norm(scale, token))));
            add(token, &change);
        }
    }
    let scale = reader.take(width);
    let tokens: StdVec<Vector> = tokens.iter().map(|z| norm(scale, z)).collect();
    let (first, second) = (reader.linear(width, width), reader.linear(width, 15));
    let candidates = second.of(&silu(first.of(&tokens[0])));
    let (mut chosen, mut motion) = (0, &candidates[..5]);
    for (index, candidate) in candidates.chunks(5).enumerate() {
        if candidate[4] > motion[4] {
            (chosen, motion) = (index, candidate);
        }
    }
    let (first, second) = (reader.linear(2 * width, width), reader.linear(width, 4));
    let heads: StdVec<Vector> = tokens[1..]
        .iter()
        .map(|z| second.of(&silu(first.of(&[&z[..], &tokens[0]].concat()))))
        .collect();
    assert!(reader.0.is_empty());
    let pulls: Vector = heads.iter().map(|head| 3.0 * head[1 + chosen]).collect();
    let columns = double(&observation.mission);
    let reach_m = columns[7];
    let mut v = [motion[0], motion[1]];
    for (axis, v) in v.iter_mut().enumerate() {
        let places = observation.user_rows().iter().zip(softmax(&pulls));
        let point: f64 = places
            .map(|(user, weight)| weight * f64::from(user[axis]))
            .sum();
        *v += sigmoid(motion[2]) * point / reach_m + sigmoid(motion[3]) * columns[axis] / reach_m;
    }
    let length = v[0].hypot(v[1]).max(1.0);
    (
        v.iter().map(|v| reach_m * v / length).collect(),
        heads.iter().map(|head| head[0]).collect(),
    )
}
