// SPDX-License-Identifier: MIT OR Apache-2.0
//! The network: loading, self-test and evaluation.

use core::fmt;

use heapless::Vec;

use super::format::{Activation, Header, LoadError, WIDTH_MAX};
use crate::collect::collect_first;
use crate::mission::MissionChange;
use crate::policy::container::{self, floats};
use crate::policy::{Action, MeasuredGains, Observation, PlanQuality, Policy, Provenance};
use crate::scalar::{Displacement, Scalar};

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
        let (header, numbers) = Header::read(bytes)?;
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

    /// Returns the numbers of the file. They were there when the file was loaded; `None` means that
    /// `B` returns other bytes now.
    fn numbers(&self) -> Option<&[u8]> {
        self.file.as_ref().get(self.start..)
    }

    /// Returns the test vector: an observation and the outputs that it must give.
    fn test_vector(&self) -> Option<(&[u8], &[u8])> {
        let numbers = self.numbers()?;
        let outputs = 4 * self.header.outputs();
        let (rest, expected) = numbers.split_at_checked(numbers.len().checked_sub(outputs)?)?;
        let inputs = 4 * self.header.inputs();
        let (_, observation) = rest.split_at_checked(rest.len().checked_sub(inputs)?)?;
        Some((observation, expected))
    }

    fn self_test(&self) -> Result<(), LoadError> {
        let (observation, expected) = self.test_vector().ok_or(LoadError::Header)?;
        let mut buffer = [0.0; WIDTH_MAX];
        for (x, value) in buffer.iter_mut().zip(floats(observation)) {
            *x = value;
        }
        let outputs = self.run(&mut buffer).ok_or(LoadError::Header)?;
        let outputs = outputs.iter().copied();
        match container::deviation(outputs, floats(expected), self.header.reach_m) {
            None => Ok(()),
            Some(container::Deviation {
                index,
                got,
                expected,
            }) => Err(LoadError::SelfTest {
                index,
                got,
                expected,
            }),
        }
    }

    /// Computes displacement (metres) and scores from an observation, in the same buffer. `None`
    /// means that the numbers do not fit the header, which `load` has checked.
    fn run<'x>(&self, buffer: &'x mut [f32; WIDTH_MAX]) -> Option<&'x [f32]> {
        let numbers = self.numbers()?;
        // Numbers that are aligned to words are read as such: two instructions less for each on a
        // Cortex-M7. The results are the same.
        match bytemuck::try_cast_slice::<u8, f32>(numbers) {
            Ok(numbers) if cfg!(target_endian = "little") => self.run_over(numbers, buffer)?,
            _ => self.run_over(numbers.as_chunks::<4>().0, buffer)?,
        }
        let functions = self.header.functions;
        for u in buffer.iter_mut().take(2) {
            *u = self.header.reach_m * functions.displacement.apply(*u);
        }
        if let Some(limit) = functions.scores {
            for score in buffer.iter_mut().take(self.header.outputs()).skip(2) {
                *score = limit.apply(*score);
            }
        }
        buffer.get(..self.header.outputs())
    }

    fn run_over<N: Number>(&self, numbers: &[N], buffer: &mut [f32; WIDTH_MAX]) -> Option<()> {
        let sizes = || self.header.sizes.iter().map(|&size| usize::from(size));
        let inputs = self.header.inputs();
        let (offset, rest) = numbers.split_at_checked(inputs)?;
        let (scale, mut rest) = rest.split_at_checked(inputs)?;
        for ((x, offset), scale) in buffer.iter_mut().zip(offset).zip(scale) {
            *x = (*x - offset.value()) * scale.value();
        }
        let mut next = [0.0; WIDTH_MAX];
        let layers = sizes().zip(sizes().skip(1));
        let mut layers_left = layers.len();
        for (inputs, outputs) in layers {
            layers_left -= 1;
            let (weights, more) = rest.split_at_checked(inputs * outputs)?;
            let (bias, more) = more.split_at_checked(outputs)?;
            rest = more;
            let next = next.get_mut(..outputs)?;
            multiply(weights, buffer.get(..inputs)?, next)?;
            for ((y, z), bias) in buffer.iter_mut().zip(&*next).zip(bias) {
                let z = z + bias.value();
                *y = match self.header.functions.activation {
                    _ if layers_left == 0 => z,
                    Activation::Relu => z.max(0.0),
                    Activation::Tanh => libm::tanhf(z),
                };
            }
        }
        Some(())
    }

    /// Returns displacement (metres) and scores for a raw observation of `M + 4` numbers; missing
    /// numbers count as 0.
    pub fn evaluate(&self, observation: &[f32]) -> Vec<f32, WIDTH_MAX> {
        let mut buffer = [0.0; WIDTH_MAX];
        for (x, &value) in buffer.iter_mut().zip(observation) {
            *x = value;
        }
        collect_first(self.run(&mut buffer).unwrap_or_default().iter().copied())
    }
}

impl<T: Scalar, B: AsRef<[u8]>, const M: usize> Policy<T, M> for Mlp<B> {
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        let mut state = [T::zero(); WIDTH_MAX];
        let users = self.provenance().users as usize;
        observation.of_first_users(users).write_state(&mut state);
        let mut buffer = state.map(|x| x.to_f64() as f32);
        // Without outputs the action is not sound, and the controller reports it as broken.
        let mut numbers = self.run(&mut buffer).unwrap_or_default().iter();
        let mut next = || Some(T::of((*numbers.next()?).into()));
        let mut component = || next().unwrap_or(T::of(f64::NAN));
        Action {
            displacement: Displacement::new(component(), component()),
            user_scores: collect_first(core::iter::from_fn(next)),
        }
    }

    /// A trained policy cannot use a change.
    fn revise(&mut self, _: &MissionChange<T>, _: u32) {}

    fn note_gains(&mut self, _: &MeasuredGains<'_, T>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<PlanQuality> {
        None
    }
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

/// Computes `W x`, with a row of `W` per output. `None` means that the sizes do not fit.
fn multiply<N: Number>(weights: &[N], x: &[f32], outputs: &mut [f32]) -> Option<()> {
    let columns = x.len();
    let (blocks, rest) = outputs.as_chunks_mut::<ROWS>();
    let mut weights = weights;
    for block in blocks {
        let (rows, more) = weights.split_at_checked(ROWS * columns)?;
        weights = more;
        *block = multiply_block(rows, x)?;
    }
    for output in rest {
        let (row, more) = weights.split_at_checked(columns)?;
        weights = more;
        *output = row.iter().zip(x).map(|(w, x)| w.value() * x).sum();
    }
    Some(())
}

/// Computes the products of `x` with [`ROWS`] rows.
fn multiply_block<N: Number>(rows: &[N], x: &[f32]) -> Option<[f32; ROWS]> {
    // Slices of the same length, which the compiler can see.
    let columns = x.len();
    let (a, rows) = rows.split_at_checked(columns)?;
    let (b, rows) = rows.split_at_checked(columns)?;
    let (c, rows) = rows.split_at_checked(columns)?;
    let (d, rows) = rows.split_at_checked(columns)?;
    let (e, rows) = rows.split_at_checked(columns)?;
    let (f, rows) = rows.split_at_checked(columns)?;
    let (g, rows) = rows.split_at_checked(columns)?;
    let h = rows.get(..columns)?;
    let rows = [a, b, c, d, e, f, g, h];
    let mut sums = [0.0; ROWS];
    for (column, &x) in x.iter().enumerate() {
        for (sum, row) in sums.iter_mut().zip(rows) {
            *sum += row[column].value() * x;
        }
    }
    Some(sums)
}
