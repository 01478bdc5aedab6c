//! A trained policy without an allocator: a multilayer perceptron that reads its weights in place,
//! in flash or in a file's bytes.
//!
//! ```text
//! x = (observation - offset) * scale
//! x = max(0, W x + b)                      every layer but the last
//! [u_x, u_y, scores..] = W x + b           the last
//! displacement = reach tanh(u)             metres
//! ```
//!
//! A `.policy` file, all numbers little endian:
//!
//! | part | bytes | |
//! |---|---|---|
//! | magic | 4 | `UAVP` |
//! | version | 2 | [`FORMAT_VERSION`] |
//! | checksum | 4 | CRC-32/ISO-HDLC over all that follows |
//! | header | varies | [`Header`] in postcard's encoding |
//! | numbers | 4 each | `f32`: offset, scale, then per layer weights (a row per output) and biases, then the test vector: an observation, and the displacement and scores it gives |
//!
//! [`Mlp::load`] checks all of it, including the test vector. Worst case of a decision: one pass
//! over the weights and two `tanh`; about 41,000 multiplications and additions at 128 neurons.

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::{Action, Observation, Policy, Provenance};
use crate::scalar::{Displacement, Scalar};

/// The format version that this crate reads and writes.
pub const FORMAT_VERSION: u16 = 1;
/// The largest width of a layer, input and output included.
pub const WIDTH_MAX: usize = 256;
/// The largest number of layers.
pub const LAYERS_MAX: usize = 6;
/// The largest difference from its test vector that a policy may have, as a fraction of full scale.
pub const SELF_TEST_TOLERANCE: f32 = 1e-5;

const MAGIC: [u8; 4] = *b"UAVP";
const PREAMBLE: usize = 10;
const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// The header of a policy file, before the numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// The origin of the policy.
    pub provenance: Provenance,
    /// `V_max delta`, metres: the factor of `tanh`.
    pub reach_m: f32,
    /// Sizes from input to output, for example `[19, 128, 128, 17]`.
    pub sizes: Vec<u16, { LAYERS_MAX + 1 }>,
}

impl Header {
    fn inputs(&self) -> usize {
        self.sizes.first().map_or(0, |&n| n.into())
    }

    fn outputs(&self) -> usize {
        self.sizes.last().map_or(0, |&n| n.into())
    }

    /// Returns how many numbers follow the header.
    pub fn number_count(&self) -> usize {
        let layers = self.sizes.windows(2);
        let layers: usize = layers
            .map(|pair| usize::from(pair[1]) * (usize::from(pair[0]) + 1))
            .sum();
        3 * self.inputs() + layers + self.outputs()
    }

    fn check(&self) -> Result<(), LoadError> {
        let users = self.provenance.users as usize;
        let ends = [users.saturating_add(4), users.saturating_add(2)];
        let wide = self
            .sizes
            .iter()
            .any(|&n| n == 0 || usize::from(n) > WIDTH_MAX);
        if self.sizes.len() < 2 || wide || [self.inputs(), self.outputs()] != ends {
            return Err(LoadError::Shape {
                inputs: self.inputs(),
                outputs: self.outputs(),
                users,
            });
        }
        if !(self.reach_m.is_finite() && self.reach_m > 0.0) {
            return Err(LoadError::Reach {
                value: self.reach_m,
            });
        }
        Ok(())
    }
}

/// Error returned when bytes are not a valid policy.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LoadError {
    /// The file is of another kind, or is incomplete.
    #[error("not a .policy file: it does not start with UAVP")]
    NotAPolicy,
    /// The file has another format version.
    #[error("format version is {got}, but this build reads {FORMAT_VERSION}")]
    Version {
        /// The file's version.
        got: u16,
    },
    /// The file is damaged or incomplete.
    #[error("checksum is {got:#010x}, but the file says {expected:#010x}: it is damaged")]
    Checksum {
        /// The checksum of the bytes.
        got: u32,
        /// The checksum in the file.
        expected: u32,
    },
    /// The header cannot be decoded.
    #[error("the header cannot be decoded")]
    Header,
    /// The layers do not make a policy for the number of users.
    #[error(
        "layers go from {inputs} to {outputs} for {users} users, but must go from users + 4 to \
         users + 2, each 1 to {WIDTH_MAX} wide"
    )]
    Shape {
        /// The size of the input.
        inputs: usize,
        /// The size of the output.
        outputs: usize,
        /// `M`, the number of users.
        users: usize,
    },
    /// The reach is not a finite number above 0.
    #[error("reach_m is {value}, but must be a finite number above 0")]
    Reach {
        /// The invalid value.
        value: f32,
    },
    /// The file has too few or too many numbers.
    #[error("the file has {got} bytes of numbers, but its layers need {expected}")]
    Length {
        /// The number of bytes in the file.
        got: usize,
        /// The number of bytes needed.
        expected: usize,
    },
    /// A number is NaN or infinite.
    #[error("number {index} is {value}, but must be finite")]
    NotFinite {
        /// The index of the number.
        index: usize,
        /// The invalid value.
        value: f32,
    },
    /// The network does not reproduce its test vector.
    #[error("self-test: output {index} is {got}, but the file expects {expected}")]
    SelfTest {
        /// The index of the output: 0 and 1 the displacement, then the scores.
        index: usize,
        /// The computed value.
        got: f32,
        /// The expected value.
        expected: f32,
    },
}

/// Error returned when a policy file cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum WriteError {
    /// The file could not be loaded again.
    #[error(transparent)]
    Unsound(#[from] LoadError),
    /// The buffer is too small.
    #[error("a policy does not fit into {capacity} bytes")]
    TooLong {
        /// The size of the buffer, bytes.
        capacity: usize,
    },
}

/// Writes a policy file into `file` and returns its length. `numbers` are in the order of the
/// [module's](self) table.
///
/// # Errors
/// Returns an error if the header is invalid, if the number of numbers is wrong, or if the buffer
/// is too small.
pub fn write(
    header: &Header,
    numbers: impl ExactSizeIterator<Item = f32>,
    file: &mut [u8],
) -> Result<usize, WriteError> {
    header.check()?;
    let (got, expected) = (4 * numbers.len(), 4 * header.number_count());
    if got != expected {
        return Err(LoadError::Length { got, expected }.into());
    }
    let too_long = WriteError::TooLong {
        capacity: file.len(),
    };
    let (preamble, body) = file.split_at_mut_checked(PREAMBLE).ok_or(too_long)?;
    let head = postcard::to_slice(header, body)
        .map_err(|_| too_long)?
        .len();
    let end = head + expected;
    let room = body.get_mut(head..end).ok_or(too_long)?;
    for (bytes, number) in room.chunks_exact_mut(4).zip(numbers) {
        bytes.copy_from_slice(&number.to_le_bytes());
    }
    preamble[..4].copy_from_slice(&MAGIC);
    preamble[4..6].copy_from_slice(&FORMAT_VERSION.to_le_bytes());
    preamble[6..].copy_from_slice(&CHECKSUM.checksum(&body[..end]).to_le_bytes());
    Ok(PREAMBLE + end)
}

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
        observation.write_state(&mut state);
        let mut buffer = state.map(|x| x.to_f64() as f32);
        let outputs = self.run(&mut buffer);
        let number = |&x: &f32| T::of(x.into());
        Action {
            displacement: Displacement::new(number(&outputs[0]), number(&outputs[1])),
            user_scores: outputs[2..].iter().take(M).map(number).collect(),
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_missions::table_one;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;
    use std::{string::ToString, vec, vec::Vec as StdVec};

    const SIZES: [u16; 4] = [19, 30, 23, 17];

    fn text<const N: usize>(text: &str) -> heapless::String<N> {
        heapless::String::try_from(text).expect("short")
    }

    fn header() -> Header {
        Header {
            provenance: Provenance {
                users: 15,
                max_speed_mps: 30.0,
                slot_duration_s: 1.0,
                area_m: [1000.0, 1000.0],
                algorithm: text("sac"),
                scenario: text("separated"),
                scenario_digest: text(&"0123456789abcdef".repeat(4)),
                episodes: 4000,
                seed: 1,
            },
            reach_m: 30.0,
            sizes: Vec::from_slice(&SIZES).expect("short"),
        }
    }

    /// The network as the module's header defines it, in double precision.
    fn reference(numbers: &[f32], observation: &[f32]) -> StdVec<f64> {
        let number = |i: usize| f64::from(numbers[i]);
        let mut x: StdVec<f64> = (0..19)
            .map(|i| (f64::from(observation[i]) - number(i)) * number(19 + i))
            .collect();
        let mut at = 38;
        for (layer, pair) in SIZES.windows(2).enumerate() {
            let (inputs, outputs) = (usize::from(pair[0]), usize::from(pair[1]));
            x = (0..outputs)
                .map(|o| {
                    let bias = number(at + inputs * outputs + o);
                    let sum: f64 = (0..inputs)
                        .map(|i| number(at + o * inputs + i) * x[i])
                        .sum();
                    if layer < 2 {
                        (sum + bias).max(0.0)
                    } else {
                        sum + bias
                    }
                })
                .collect();
            at += outputs * (inputs + 1);
        }
        x[..2].iter_mut().for_each(|u| *u = 30.0 * u.tanh());
        x
    }

    fn numbers() -> StdVec<f32> {
        let mut rng = Pcg64Mcg::seed_from_u64(6);
        let count = header().number_count();
        let mut numbers: StdVec<f32> = (0..count)
            .map(|_| rng.random_range(-0.3_f32..0.3))
            .collect();
        let start = count - 17 - 19;
        let observation = numbers[start..start + 19].to_vec();
        let expected = reference(&numbers, &observation);
        for (slot, value) in numbers[start + 19..].iter_mut().zip(expected) {
            *slot = value as f32;
        }
        numbers
    }

    fn file() -> StdVec<u8> {
        let mut file = vec![0; 20_000];
        let length = write(&header(), numbers().into_iter(), &mut file).expect("sound");
        file.truncate(length);
        file
    }

    /// With a matching checksum: only what comes after it is at fault.
    fn sealed(mut file: StdVec<u8>) -> StdVec<u8> {
        let checksum = CHECKSUM.checksum(&file[PREAMBLE..]);
        file[6..10].copy_from_slice(&checksum.to_le_bytes());
        file
    }

    #[test]
    fn outputs_agree_with_double_precision() {
        let policy = Mlp::load(file()).expect("sound");
        let numbers = numbers();
        let mut rng = Pcg64Mcg::seed_from_u64(8);
        for _ in 0..1000 {
            let observation: StdVec<f32> = (0..19).map(|_| rng.random_range(-3.0..3.0)).collect();
            let expected = reference(&numbers, &observation);
            let got = policy.evaluate(&observation);
            for (i, (got, expected)) in got.iter().zip(&expected).enumerate() {
                let scale = if i < 2 { 30.0 } else { 1.0 };
                assert!(
                    (f64::from(*got) - expected).abs() < 1e-5 * scale,
                    "{i}: {got} {expected}"
                );
            }
        }
    }

    /// Any single damaged byte is found, and so is every cut.
    #[test]
    fn damage_is_found() {
        let file = file();
        for at in (0..file.len()).step_by(13) {
            let mut damaged = file.clone();
            damaged[at] ^= 0x10;
            assert!(Mlp::load(damaged).is_err(), "byte {at}");
            assert!(Mlp::load(&file[..at]).is_err(), "cut at {at}");
        }
    }

    #[test]
    fn each_fault_is_named() {
        let message = |file: StdVec<u8>| Mlp::load(file).expect_err("unsound").to_string();
        let sound = file();
        assert!(message(b"ONNX".to_vec()).contains("UAVP"));
        let mut other = sound.clone();
        other[4] = 9;
        assert_eq!(
            message(other),
            "format version is 9, but this build reads 1"
        );
        let end = sound.len();
        let mut other = sound.clone();
        other[end - 4..].copy_from_slice(&3.5_f32.to_le_bytes());
        assert!(message(sealed(other)).starts_with("self-test: output 16 is "));
        let mut other = sound.clone();
        other[end - 400..end - 396].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(message(sealed(other)).contains("NaN"));
        let mut other = sound.clone();
        other.extend([0; 4]);
        assert!(message(sealed(other)).contains("bytes of numbers"));
        let mut wrong = header();
        wrong.provenance.users = 14;
        let error = write(&wrong, numbers().into_iter(), &mut vec![0; 20_000]);
        assert!(matches!(
            error,
            Err(WriteError::Unsound(LoadError::Shape { users: 14, .. }))
        ));
    }

    #[test]
    fn a_policy_for_another_mission_is_refused_with_both_values() {
        let provenance = header().provenance;
        assert_eq!(provenance.check(&table_one::<f64>()), Ok(()));
        assert_eq!(provenance.check(&table_one::<f32>()), Ok(()));
        let slow = Provenance {
            max_speed_mps: 20.0,
            ..provenance
        };
        let message = slow
            .check(&table_one::<f64>())
            .expect_err("slow")
            .to_string();
        let expected = "the policy is for max_speed_mps = 20, but the mission has 30";
        assert_eq!(message, expected);
    }
}
