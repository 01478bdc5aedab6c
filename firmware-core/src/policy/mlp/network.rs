// SPDX-License-Identifier: MIT OR Apache-2.0
//! The network: loading, self-test and evaluation.

use core::fmt;

use heapless::Vec;

use super::format::{CHECKSUM, FORMAT_VERSION, Header, LoadError, MAGIC, PREAMBLE, WIDTH_MAX};
use crate::mission::MissionChange;
use crate::policy::{Action, Observation, PlanQuality, Policy, Provenance};
use crate::scalar::{Displacement, Scalar};

/// The largest difference from its test vector that a policy may have, as a fraction of full scale.
pub const SELF_TEST_TOLERANCE: f32 = 1e-5;

/// A policy on the bytes of its file: `&'static [u8]` in flash, `Vec<u8>` on a host.
#[derive(Clone)]
pub struct Mlp<B> {
    file: B,
    header: Header,
    /// The offset of the numbers.
    start: usize,
}

impl<B> fmt::Debug for Mlp<B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Mlp")
            .field("header", &self.header)
            .finish_non_exhaustive()
    }
}

impl<B: AsRef<[u8]>> Mlp<B> {
    /// Loads a policy: checks the file's bytes and its test vector.
    ///
    /// # Errors
    /// Returns what is wrong with the file.
    pub fn load(file: B) -> Result<Self, LoadError> {
        let bytes = file.as_ref();
        let (preamble, body) = bytes
            .split_at_checked(PREAMBLE)
            .ok_or(LoadError::NotAPolicy)?;
        if preamble[..4] != MAGIC {
            return Err(LoadError::NotAPolicy);
        }
        let version = u16::from_le_bytes([preamble[4], preamble[5]]);
        if version != FORMAT_VERSION {
            return Err(LoadError::Version { got: version });
        }
        let expected = u32::from_le_bytes([preamble[6], preamble[7], preamble[8], preamble[9]]);
        let got = CHECKSUM.checksum(body);
        if got != expected {
            return Err(LoadError::Checksum { got, expected });
        }
        let (header, numbers): (Header, &[u8]) =
            postcard::take_from_bytes(body).map_err(|_| LoadError::Header)?;
        header.check()?;
        let (got, expected) = (numbers.len(), 4 * header.number_count());
        if got != expected {
            return Err(LoadError::Length { got, expected });
        }
        if let Some((index, value)) = floats(numbers).enumerate().find(|(_, x)| !x.is_finite()) {
            return Err(LoadError::NotFinite { index, value });
        }
        let start = bytes.len() - numbers.len();
        let policy = Self {
            file,
            header,
            start,
        };
        policy.self_test()?;
        Ok(policy)
    }

    /// Returns the origin of the policy.
    pub fn provenance(&self) -> &Provenance {
        &self.header.provenance
    }

    /// Returns the header, with sizes and scale.
    pub fn header(&self) -> &Header {
        &self.header
    }

    fn numbers(&self) -> &[u8] {
        &self.file.as_ref()[self.start..]
    }

    /// Returns the test vector: an observation and the outputs that it must give.
    fn test_vector(&self) -> (&[u8], &[u8]) {
        let numbers = self.numbers();
        let outputs = 4 * self.header.outputs();
        let (rest, expected) = numbers.split_at(numbers.len() - outputs);
        let (_, observation) = rest.split_at(rest.len() - 4 * self.header.inputs());
        (observation, expected)
    }

    fn self_test(&self) -> Result<(), LoadError> {
        let (observation, expected) = self.test_vector();
        let mut buffer = [0.0; WIDTH_MAX];
        for (x, value) in buffer.iter_mut().zip(floats(observation)) {
            *x = value;
        }
        let outputs = self.run(&mut buffer);
        let largest = |values: &[u8]| floats(values).fold(1.0_f32, |a, b| a.max(b.abs()));
        let scores_scale = largest(&expected[8..]);
        for (index, (&got, expected)) in outputs.iter().zip(floats(expected)).enumerate() {
            let scale = if index < 2 {
                self.header.reach_m
            } else {
                scores_scale
            };
            // Written so that a NaN fails.
            let close = (got - expected).abs() <= SELF_TEST_TOLERANCE * scale;
            if !close {
                return Err(LoadError::SelfTest {
                    index,
                    got,
                    expected,
                });
            }
        }
        Ok(())
    }

    /// Computes displacement (metres) and scores from an observation, in the same buffer.
    fn run<'x>(&self, buffer: &'x mut [f32; WIDTH_MAX]) -> &'x [f32] {
        let numbers = self.numbers();
        // Numbers that are aligned to words are read as such: two instructions less for each on a
        // Cortex-M7. The results are the same.
        match bytemuck::try_cast_slice::<u8, f32>(numbers) {
            Ok(numbers) if cfg!(target_endian = "little") => self.run_over(numbers, buffer),
            _ => self.run_over(numbers.as_chunks::<4>().0, buffer),
        }
        for u in &mut buffer[..2] {
            *u = self.header.reach_m * libm::tanhf(*u);
        }
        &buffer[..self.header.outputs()]
    }

    fn run_over<N: Number>(&self, numbers: &[N], buffer: &mut [f32; WIDTH_MAX]) {
        let inputs = self.header.inputs();
        let (offset, rest) = numbers.split_at(inputs);
        let (scale, mut rest) = rest.split_at(inputs);
        for ((x, offset), scale) in buffer.iter_mut().zip(offset).zip(scale) {
            *x = (*x - offset.value()) * scale.value();
        }
        let mut next = [0.0; WIDTH_MAX];
        let layers = self.header.sizes.len() - 1;
        for (layer, pair) in self.header.sizes.windows(2).enumerate() {
            let (inputs, outputs) = (usize::from(pair[0]), usize::from(pair[1]));
            let (weights, more) = rest.split_at(inputs * outputs);
            let (bias, more) = more.split_at(outputs);
            rest = more;
            multiply(weights, &buffer[..inputs], &mut next[..outputs]);
            for ((y, z), bias) in buffer.iter_mut().zip(&next[..outputs]).zip(bias) {
                let z = z + bias.value();
                *y = if layer + 1 < layers { z.max(0.0) } else { z };
            }
        }
    }

    /// Returns displacement (metres) and scores for a raw observation of `M + 4` numbers; missing
    /// numbers count as 0.
    pub fn evaluate(&self, observation: &[f32]) -> Vec<f32, WIDTH_MAX> {
        let mut buffer = [0.0; WIDTH_MAX];
        for (x, &value) in buffer.iter_mut().zip(observation) {
            *x = value;
        }
        self.run(&mut buffer).iter().copied().collect()
    }
}

impl<T: Scalar, B: AsRef<[u8]>, const M: usize> Policy<T, M> for Mlp<B> {
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        let mut state = [T::zero(); WIDTH_MAX];
        let users = self.provenance().users as usize;
        observation.of_first_users(users).write_state(&mut state);
        let mut buffer = state.map(|x| x.to_f64() as f32);
        let outputs = self.run(&mut buffer);
        let number = |&x: &f32| T::of(x.into());
        Action {
            displacement: Displacement::new(number(&outputs[0]), number(&outputs[1])),
            user_scores: outputs[2..].iter().take(M).map(number).collect(),
        }
    }

    /// A trained policy cannot use a change.
    fn revise(&mut self, _: &MissionChange<T>, _: u32) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<PlanQuality> {
        None
    }
}

fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    let (words, _) = bytes.as_chunks::<4>();
    words.iter().map(|&word| f32::from_le_bytes(word))
}

/// A number of a file, aligned to a word or not.
trait Number: Copy {
    fn value(self) -> f32;
}

impl Number for f32 {
    fn value(self) -> f32 {
        self
    }
}

impl Number for [u8; 4] {
    fn value(self) -> f32 {
        f32::from_le_bytes(self)
    }
}

/// The number of rows that are multiplied together: each input is read once for all of them, and
/// their additions do not depend on one another.
const ROWS: usize = 8;

/// Computes `W x`, with a row of `W` per output.
fn multiply<N: Number>(weights: &[N], x: &[f32], outputs: &mut [f32]) {
    let (blocks, rest) = outputs.as_chunks_mut::<ROWS>();
    let (block_weights, rest_weights) = weights.split_at(blocks.len() * ROWS * x.len());
    for (block, weights) in blocks
        .iter_mut()
        .zip(block_weights.chunks_exact(ROWS * x.len()))
    {
        *block = [0.0; ROWS];
        // Slices of the same length, which the compiler can see.
        let rows: [&[N]; ROWS] = core::array::from_fn(|row| &weights[row * x.len()..][..x.len()]);
        for (column, &x) in x.iter().enumerate() {
            for (sum, row) in block.iter_mut().zip(rows) {
                *sum += row[column].value() * x;
            }
        }
    }
    for (output, row) in rest.iter_mut().zip(rest_weights.chunks_exact(x.len())) {
        *output = row.iter().zip(x).map(|(w, x)| w.value() * x).sum();
    }
}
