// SPDX-License-Identifier: MIT OR Apache-2.0
//! Products of weights with several vectors at once.
//!
//! Vectors are kept side by side in *panels* of [`LANES`] vectors: entry `i` of a panel holds entry
//! `i` of each of them. Each weight is read and converted once for all lanes, and the additions of
//! the lanes do not depend on one another. `None` means that sizes do not fit together.

use super::half;

/// The number of vectors in a panel.
pub(super) const LANES: usize = 4;

/// An entry of the vectors of a panel.
pub(super) type Lanes = [f32; LANES];

/// The number of rows of a matrix that are multiplied together: their sums stay in registers.
const ROWS: usize = 4;

/// A weight as it is stored in a file.
pub(super) trait Weight: Copy {
    /// Returns the weight, which must be finite.
    fn value(self) -> f32;

    /// Returns whether the weight is finite.
    fn is_finite(self) -> bool;
}

impl Weight for [u8; 2] {
    fn value(self) -> f32 {
        half::to_single(u16::from_le_bytes(self))
    }

    fn is_finite(self) -> bool {
        half::is_finite(u16::from_le_bytes(self))
    }
}

impl Weight for [u8; 4] {
    fn value(self) -> f32 {
        f32::from_le_bytes(self)
    }

    fn is_finite(self) -> bool {
        self.value().is_finite()
    }
}

/// The weights of a network, from the first to the last.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights<'a, W>(pub(super) &'a [W]);

impl<'a, W: Weight> Weights<'a, W> {
    /// Takes the next weights.
    pub(super) fn take(&mut self, count: usize) -> Option<&'a [W]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    /// Takes the next linear map.
    pub(super) fn linear(&mut self, inputs: usize, outputs: usize) -> Option<Linear<'a, W>> {
        Some(Linear {
            inputs,
            matrix: self.take(inputs * outputs)?,
            bias: self.take(outputs)?,
        })
    }
}

/// A linear map `W x + b`, with a row of `W` per output.
#[derive(Clone, Copy, Debug)]
pub(super) struct Linear<'a, W> {
    inputs: usize,
    matrix: &'a [W],
    bias: &'a [W],
}

impl<W: Weight> Linear<'_, W> {
    /// Returns the map to the outputs from `first` on, `count` of them.
    pub(super) fn outputs(&self, first: usize, count: usize) -> Option<Self> {
        let (begin, end) = (first, first + count);
        Some(Self {
            inputs: self.inputs,
            matrix: self.matrix.get(begin * self.inputs..end * self.inputs)?,
            bias: self.bias.get(begin..end)?,
        })
    }

    /// Writes the outputs for the inputs at the beginning of `x` to the beginning of `y`.
    pub(super) fn apply(&self, x: &[Lanes], y: &mut [Lanes]) -> Option<()> {
        let x = x.get(..self.inputs)?;
        let y = y.get_mut(..self.bias.len())?;
        let (blocks, last) = y.as_chunks_mut::<ROWS>();
        let (biases, last_biases) = self.bias.as_chunks::<ROWS>();
        let mut matrix = self.matrix;
        for (block, bias) in blocks.iter_mut().zip(biases) {
            let (rows, rest) = matrix.split_at_checked(ROWS * self.inputs)?;
            matrix = rest;
            *block = multiply_rows(rows, bias, x)?;
        }
        for (output, bias) in last.iter_mut().zip(last_biases) {
            let (row, rest) = matrix.split_at_checked(self.inputs)?;
            matrix = rest;
            *output = [bias.value(); LANES];
            for (weight, x) in row.iter().zip(x) {
                add_product(output, weight.value(), x);
            }
        }
        Some(())
    }
}

/// Computes the products of [`ROWS`] rows with the vectors of a panel, and adds the biases.
fn multiply_rows<W: Weight>(rows: &[W], bias: &[W; ROWS], x: &[Lanes]) -> Option<[Lanes; ROWS]> {
    let (a, rows) = rows.split_at_checked(x.len())?;
    let (b, rows) = rows.split_at_checked(x.len())?;
    let (c, d) = rows.split_at_checked(x.len())?;
    let mut sums = bias.map(|bias| [bias.value(); LANES]);
    for ((((x, a), b), c), d) in x.iter().zip(a).zip(b).zip(c).zip(d) {
        for (sum, weight) in sums.iter_mut().zip([a, b, c, d]) {
            add_product(sum, weight.value(), x);
        }
    }
    Some(sums)
}

/// Adds `factor x` to a sum.
pub(super) fn add_product(sum: &mut Lanes, factor: f32, x: &Lanes) {
    for (sum, x) in sum.iter_mut().zip(x) {
        *sum += factor * x;
    }
}

/// Writes a vector into a lane of a panel.
pub(super) fn write_lane(panel: &mut [Lanes], lane: usize, vector: impl IntoIterator<Item = f32>) {
    for (entry, x) in panel.iter_mut().zip(vector) {
        if let Some(entry) = entry.get_mut(lane) {
            *entry = x;
        }
    }
}

/// Returns the vector in a lane of a panel.
pub(super) fn read_lane(panel: &[Lanes], lane: usize) -> impl Iterator<Item = f32> + '_ {
    panel
        .iter()
        .filter_map(move |entry| entry.get(lane).copied())
}

/// Adds a panel to another one.
pub(super) fn add(sum: &mut [Lanes], x: &[Lanes]) {
    for (sum, x) in sum.iter_mut().zip(x) {
        add_product(sum, 1.0, x);
    }
}

/// Applies `silu(x) = x / (1 + exp(-x))` to every number.
pub(super) fn silu(panel: &mut [Lanes]) {
    for x in panel.iter_mut().flatten() {
        *x *= sigmoid(*x);
    }
}

/// Returns `1 / (1 + exp(-x))`.
pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-x))
}

/// Added to the variance in [`normalize`].
const VARIANCE_OFFSET: f32 = 1e-5;

/// Writes the vectors of `x`, less their mean and divided by their standard deviation, times
/// `scale`, to the beginning of `y`.
pub(super) fn normalize<W: Weight>(scale: &[W], x: &[Lanes], y: &mut [Lanes]) -> Option<()> {
    let x = x.get(..scale.len())?;
    let y = y.get_mut(..scale.len())?;
    let fraction = 1.0 / scale.len() as f32;
    let mut mean = [0.0; LANES];
    x.iter().for_each(|x| add_product(&mut mean, fraction, x));
    let mut variance = [VARIANCE_OFFSET; LANES];
    for (x, y) in x.iter().zip(y.iter_mut()) {
        *y = *x;
        add_product(y, -1.0, &mean);
        for (variance, y) in variance.iter_mut().zip(y) {
            *variance += fraction * *y * *y;
        }
    }
    let inverse = variance.map(|variance| 1.0 / libm::sqrtf(variance));
    for (y, scale) in y.iter_mut().zip(scale) {
        let scale = scale.value();
        for (y, inverse) in y.iter_mut().zip(inverse) {
            *y *= scale * inverse;
        }
    }
    Some(())
}
