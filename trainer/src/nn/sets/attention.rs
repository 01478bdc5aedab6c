//! Attention between the tokens of each state, with four heads:
//! `out_i = sum_j softmax_j(q_i . k_j / sqrt(D / 4)) v_j`.

use pulp::Arch;

use super::{
    super::product::padded,
    batch::SetBatch,
    functions::{exp, sum_of_lanes, vectorize},
    layout::HEADS,
    resize,
};

/// The weights of the last forward pass, which the backward pass needs.
#[derive(Clone, Debug, Default)]
pub struct Attention {
    /// For each state, head and token: the weights of all tokens of the state, padded with zeros.
    weights: Vec<f32>,
}

/// Calls a function for the width of a head, which is a constant so that loops are unrolled.
macro_rules! with_head_width {
    ($width:expr, $function:ident($($argument:expr),*)) => {
        match $width / HEADS {
            8 => $function::<8>($($argument),*),
            16 => $function::<16>($($argument),*),
            24 => $function::<24>($($argument),*),
            32 => $function::<32>($($argument),*),
            other => unreachable!("no layout has heads of width {other}"),
        }
    };
}

impl Attention {
    /// Computes `out` (one row of `width` per token) from queries, keys and values (rows of
    /// `3 width`).
    pub fn forward(
        &mut self,
        arch: Arch,
        batch: &SetBatch,
        width: usize,
        qkv: &[f32],
        out: &mut [f32],
    ) {
        let tokens = |state| batch.tokens_of(state).len();
        let len = (0..batch.len()).map(|state| weights_len(tokens(state)));
        let weights = resize(&mut self.weights, len.sum());
        vectorize(
            arch,
            #[inline(always)]
            || {
                with_head_width!(width, forward_heads(batch, qkv, out, weights));
            },
        );
    }

    /// Computes the gradient of queries, keys and values from the gradient of `out`.
    pub fn backward(
        &self,
        arch: Arch,
        batch: &SetBatch,
        width: usize,
        qkv: &[f32],
        d_out: &[f32],
        d_qkv: &mut [f32],
    ) {
        vectorize(
            arch,
            #[inline(always)]
            || {
                with_head_width!(
                    width,
                    backward_heads(batch, qkv, &self.weights, d_out, d_qkv)
                );
            },
        );
    }
}

/// Returns the number of weights of a state.
fn weights_len(tokens: usize) -> usize {
    HEADS * tokens * padded(tokens)
}

/// Returns `W` numbers of a row as an array.
#[inline(always)]
fn array<const W: usize>(values: &[f32], start: usize) -> [f32; W] {
    let mut array = [0.0; W];
    array.copy_from_slice(&values[start..start + W]);
    array
}

/// Writes the transpose of one head's part of keys or values: row `d` has component `d` of all
/// tokens, padded with zeros.
#[inline(always)]
fn transpose<const W: usize>(
    part: &[f32],
    stride: usize,
    tokens: usize,
    to: &mut [f32],
    to_stride: usize,
) {
    to[..W * to_stride].fill(0.0);
    for token in 0..tokens {
        let row: [f32; W] = array(part, token * stride);
        for d in 0..W {
            to[d * to_stride + token] = row[d];
        }
    }
}

/// Computes the products of `row` with the columns from `column` on of a transposed matrix.
#[inline(always)]
fn products<const W: usize>(
    row: &[f32; W],
    transposed: &[f32],
    stride: usize,
    column: usize,
) -> [f32; 16] {
    let mut sums = [0.0_f32; 16];
    for d in 0..W {
        let values: [f32; 16] = array(transposed, d * stride + column);
        for lane in 0..16 {
            sums[lane] = row[d].mul_add(values[lane], sums[lane]);
        }
    }
    sums
}

/// Replaces scores by their softmax; elements from `tokens` on become zero.
#[inline(always)]
fn softmax(scores: &mut [f32], tokens: usize) {
    let largest = scores[..tokens].iter().fold(f32::MIN, |a, &b| a.max(b));
    let mut lanes = [0.0_f32; 16];
    for (chunk, scores) in scores.chunks_exact_mut(16).enumerate() {
        for lane in 0..16 {
            let value = exp(scores[lane] - largest);
            scores[lane] = if chunk * 16 + lane < tokens {
                value
            } else {
                0.0
            };
            lanes[lane] += scores[lane];
        }
    }
    let scale = 1.0 / sum_of_lanes(lanes);
    scores.iter_mut().for_each(|score| *score *= scale);
}

#[inline(always)]
fn forward_heads<const W: usize>(
    batch: &SetBatch,
    qkv: &[f32],
    out: &mut [f32],
    weights: &mut [f32],
) {
    let width = HEADS * W;
    let stride = 3 * width;
    let scale = 1.0 / (W as f32).sqrt();
    let mut keys = Vec::new();
    let mut rest = weights;
    for state in 0..batch.len() {
        let range = batch.tokens_of(state);
        let (tokens, columns) = (range.len(), padded(range.len()));
        let keys = resize(&mut keys, W * columns);
        let qkv = &qkv[range.start * stride..range.end * stride];
        let out = &mut out[range.start * width..range.end * width];
        for head in 0..HEADS {
            let (query, key, value) = (head * W, width + head * W, 2 * width + head * W);
            transpose::<W>(&qkv[key..], stride, tokens, keys, columns);
            for token in 0..tokens {
                let (row, after) = rest.split_at_mut(columns);
                rest = after;
                let q: [f32; W] = array(qkv, token * stride + query);
                for column in (0..columns).step_by(16) {
                    let sums = products(&q, keys, columns, column);
                    for lane in 0..16 {
                        row[column + lane] = sums[lane] * scale;
                    }
                }
                softmax(row, tokens);
                let mut mixed = [0.0_f32; W];
                for other in 0..tokens {
                    let v: [f32; W] = array(qkv, other * stride + value);
                    for d in 0..W {
                        mixed[d] = row[other].mul_add(v[d], mixed[d]);
                    }
                }
                let at = token * width + head * W;
                out[at..at + W].copy_from_slice(&mixed);
            }
        }
    }
}

#[inline(always)]
fn backward_heads<const W: usize>(
    batch: &SetBatch,
    qkv: &[f32],
    weights: &[f32],
    d_out: &[f32],
    d_qkv: &mut [f32],
) {
    let width = HEADS * W;
    let stride = 3 * width;
    let scale = 1.0 / (W as f32).sqrt();
    let (mut values, mut d_scores) = (Vec::new(), Vec::new());
    let mut rest = weights;
    for state in 0..batch.len() {
        let range = batch.tokens_of(state);
        let (tokens, columns) = (range.len(), padded(range.len()));
        let values = resize(&mut values, W * columns);
        let d_scores = resize(&mut d_scores, columns);
        let qkv = &qkv[range.start * stride..range.end * stride];
        let d_out = &d_out[range.start * width..range.end * width];
        let d_qkv = &mut d_qkv[range.start * stride..range.end * stride];
        d_qkv.fill(0.0);
        for head in 0..HEADS {
            let (query, key, value) = (head * W, width + head * W, 2 * width + head * W);
            transpose::<W>(&qkv[value..], stride, tokens, values, columns);
            for token in 0..tokens {
                let (row, after) = rest.split_at(columns);
                rest = after;
                let d_mixed: [f32; W] = array(d_out, token * width + head * W);
                let mut lanes = [0.0_f32; 16];
                for column in (0..columns).step_by(16) {
                    let sums = products(&d_mixed, values, columns, column);
                    for lane in 0..16 {
                        d_scores[column + lane] = sums[lane];
                        lanes[lane] += sums[lane] * row[column + lane];
                    }
                }
                let along = sum_of_lanes(lanes);
                for column in 0..columns {
                    d_scores[column] = row[column] * (d_scores[column] - along) * scale;
                }
                let q: [f32; W] = array(qkv, token * stride + query);
                let mut d_q = [0.0_f32; W];
                for other in 0..tokens {
                    let at = other * stride;
                    let k: [f32; W] = array(qkv, at + key);
                    let mut d_k: [f32; W] = array(d_qkv, at + key);
                    let mut d_v: [f32; W] = array(d_qkv, at + value);
                    for d in 0..W {
                        d_q[d] = d_scores[other].mul_add(k[d], d_q[d]);
                        d_k[d] = d_scores[other].mul_add(q[d], d_k[d]);
                        d_v[d] = row[other].mul_add(d_mixed[d], d_v[d]);
                    }
                    d_qkv[at + key..at + key + W].copy_from_slice(&d_k);
                    d_qkv[at + value..at + value + W].copy_from_slice(&d_v);
                }
                let at = token * stride + query;
                d_qkv[at..at + W].copy_from_slice(&d_q);
            }
        }
    }
}
