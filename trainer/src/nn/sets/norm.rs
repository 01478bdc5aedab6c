//! Layer norm with a scale and no bias: `y = s (x - mean) / sqrt(variance + 1e-5)`.

use pulp::Arch;

use super::{
    functions::{sum_of_lanes, vectorize},
    resize,
};

/// Added to the variance.
pub const EPSILON: f32 = 1e-5;

/// What the backward pass needs of the forward pass, and the result.
#[derive(Clone, Debug, Default)]
pub struct Norm {
    /// The results.
    pub output: Vec<f32>,
    /// `(x - mean) / sqrt(variance + 1e-5)`.
    normalized: Vec<f32>,
    /// `1 / sqrt(variance + 1e-5)` of each row.
    inverse: Vec<f32>,
}

#[inline(always)]
fn sum(row: &[f32], term: impl Fn(usize, f32) -> f32) -> f32 {
    let mut lanes = [0.0; 16];
    for (chunk, values) in row.chunks_exact(16).enumerate() {
        for (lane, value) in values.iter().enumerate() {
            lanes[lane] += term(chunk * 16 + lane, *value);
        }
    }
    sum_of_lanes(lanes)
}

impl Norm {
    /// Normalizes `rows` rows of `x`, each as long as `scales`.
    pub fn forward(&mut self, arch: Arch, scales: &[f32], rows: usize, x: &[f32]) {
        let width = scales.len();
        let output = resize(&mut self.output, rows * width);
        let normalized = resize(&mut self.normalized, rows * width);
        let inverse = resize(&mut self.inverse, rows);
        vectorize(
            arch,
            #[inline(always)]
            || {
                for row in 0..rows {
                    let at = row * width..(row + 1) * width;
                    let (x, output) = (&x[at.clone()], &mut output[at.clone()]);
                    let normalized = &mut normalized[at];
                    let mean = sum(x, |_, x| x) / width as f32;
                    let variance = sum(x, |_, x| (x - mean) * (x - mean)) / width as f32;
                    let scale = 1.0 / (variance + EPSILON).sqrt();
                    inverse[row] = scale;
                    for i in 0..width {
                        normalized[i] = (x[i] - mean) * scale;
                        output[i] = normalized[i] * scales[i];
                    }
                }
            },
        );
    }

    /// Adds the gradient of the scales to `d_scales` and that of the inputs to `dx`, where `dy` is
    /// the gradient of the results.
    pub fn backward(
        &self,
        arch: Arch,
        scales: &[f32],
        rows: usize,
        dy: &[f32],
        d_scales: &mut [f32],
        dx: &mut [f32],
    ) {
        let width = scales.len();
        vectorize(
            arch,
            #[inline(always)]
            || {
                for row in 0..rows {
                    let at = row * width..(row + 1) * width;
                    let (dy, dx) = (&dy[at.clone()], &mut dx[at.clone()]);
                    let normalized = &self.normalized[at];
                    let mean = sum(dy, |i, dy| dy * scales[i]) / width as f32;
                    let along = sum(dy, |i, dy| dy * scales[i] * normalized[i]) / width as f32;
                    for i in 0..width {
                        d_scales[i] += dy[i] * normalized[i];
                        let change = dy[i] * scales[i] - mean - normalized[i] * along;
                        dx[i] += change * self.inverse[row];
                    }
                }
            },
        );
    }
}
