// SPDX-License-Identifier: MIT OR Apache-2.0
//! The format of a policy file.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::policy::{
    Provenance,
    container::{self, ContainerError, PREAMBLE},
    output_len, state_len,
};

/// The format version of a file with the functions that [`Functions::default`] returns.
pub const FORMAT_VERSION: u16 = 1;

/// The format version of a file that states its [`Functions`].
pub const FORMAT_VERSION_FUNCTIONS: u16 = 3;

/// The function after each hidden layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Activation {
    /// `max(0, x)`.
    #[default]
    Relu,
    /// `tanh(x)`.
    Tanh,
}

/// A function that limits outputs to `[-1, 1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Limit {
    /// `tanh(u)`.
    #[default]
    Tanh,
    /// `max(-1, min(1, u))`.
    Clip,
}

/// The functions of a network that are not linear. Those of our own training are the default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Functions {
    /// The function after each hidden layer.
    pub activation: Activation,
    /// The function after the outputs for the displacement, before they are scaled to metres.
    pub displacement: Limit,
    /// The function after the scores, if there is one.
    pub scores: Option<Limit>,
}

impl Limit {
    /// Returns the limited value.
    pub(super) fn apply(self, x: f32) -> f32 {
        match self {
            Self::Tanh => libm::tanhf(x),
            Self::Clip => x.clamp(-1.0, 1.0),
        }
    }
}

impl Functions {
    /// Returns the format version of files with these functions.
    pub fn format_version(&self) -> u16 {
        if *self == Self::default() {
            FORMAT_VERSION
        } else {
            FORMAT_VERSION_FUNCTIONS
        }
    }
}

/// The largest width of a layer, input and output included.
pub const WIDTH_MAX: usize = 256;

/// The largest number of layers.
pub const LAYERS_MAX: usize = 6;

/// The header of a policy file, before the numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// The origin of the policy.
    pub provenance: Provenance,
    /// The functions of the network; not in a file of version 1.
    #[serde(skip)]
    pub functions: Functions,
    /// `V_max delta`, metres: the factor of the limited displacement.
    pub reach_m: f32,
    /// Sizes from input to output, for example `[19, 128, 128, 17]`.
    pub sizes: Vec<u16, { LAYERS_MAX + 1 }>,
}

impl Header {
    /// Returns the header of a file and the bytes of its numbers.
    pub(super) fn read(file: &[u8]) -> Result<(Self, &[u8]), LoadError> {
        let header = |_| LoadError::Header;
        if container::format_version(file)? != FORMAT_VERSION_FUNCTIONS {
            let body = container::open(file, FORMAT_VERSION)?;
            return postcard::take_from_bytes(body).map_err(header);
        }
        let body = container::open(file, FORMAT_VERSION_FUNCTIONS)?;
        let ((functions, read), numbers): ((Functions, Self), &[u8]) =
            postcard::take_from_bytes(body).map_err(header)?;
        Ok((Self { functions, ..read }, numbers))
    }

    pub(super) fn inputs(&self) -> usize {
        self.sizes.first().map_or(0, |&n| n.into())
    }

    pub(super) fn outputs(&self) -> usize {
        self.sizes.last().map_or(0, |&n| n.into())
    }

    /// Returns how many numbers follow the header.
    pub fn number_count(&self) -> usize {
        let sizes = || self.sizes.iter().map(|&size| usize::from(size));
        let layers = sizes().zip(sizes().skip(1));
        let layers: usize = layers.map(|(inputs, outputs)| outputs * (inputs + 1)).sum();
        3 * self.inputs() + layers + self.outputs()
    }

    pub(super) fn check(&self) -> Result<(), LoadError> {
        let users = self.provenance.users as usize;
        let ends = [state_len(users), output_len(users)];
        let wide = self
            .sizes
            .iter()
            .any(|&n| n == 0 || usize::from(n) > WIDTH_MAX);
        // The ends differ: fewer than two sizes cannot have both.
        if wide || [self.inputs(), self.outputs()] != ends {
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
#[non_exhaustive]
pub enum LoadError {
    /// The file is of another kind or version, or damaged.
    #[error(transparent)]
    Container(#[from] ContainerError),
    /// The header cannot be decoded.
    #[error("the header cannot be decoded")]
    Header,
    /// The layers do not make a policy for the number of users.
    #[error(
        "layers go from {inputs} to {outputs} for {users} users, but must go from {} to {}, each 1 to \
         {WIDTH_MAX} wide",
        state_len(*users),
        output_len(*users)
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
#[non_exhaustive]
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
/// [module's](super) table.
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
    let (_, body) = file.split_at_mut_checked(PREAMBLE).ok_or(too_long)?;
    let version = header.functions.format_version();
    let head = if version == FORMAT_VERSION {
        postcard::to_slice(header, body)
    } else {
        postcard::to_slice(&(header.functions, header), body)
    };
    let head = head.map_err(|_| too_long)?.len();
    let end = head + expected;
    let room = body.get_mut(head..end).ok_or(too_long)?;
    for (bytes, number) in room.chunks_exact_mut(4).zip(numbers) {
        bytes.copy_from_slice(&number.to_le_bytes());
    }
    let length = PREAMBLE + end;
    let file = file.get_mut(..length).ok_or(too_long)?;
    container::seal(file, version).ok_or(too_long)?;
    Ok(length)
}
