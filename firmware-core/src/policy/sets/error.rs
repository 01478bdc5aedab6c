// SPDX-License-Identifier: MIT OR Apache-2.0
//! What can be wrong with a file.

use crate::policy::container::ContainerError;

/// Error returned when bytes are not a valid policy for any mission.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SetsLoadError {
    /// The file is of another kind or version, or damaged.
    #[error(transparent)]
    Container(#[from] ContainerError),
    /// The header cannot be decoded.
    #[error("the header cannot be decoded")]
    Header,
    /// The policy observes other columns.
    #[error("the policy observes {got} columns of a {what}, but this build has {expected}")]
    Columns {
        /// `mission`, `user` or `sensor`.
        what: &'static str,
        /// The number of columns of the policy.
        got: u16,
        /// The number of columns of this build.
        expected: usize,
    },
    /// A size of the network is outside its range.
    #[error("{what} is {got}, but must be {expected}")]
    Architecture {
        /// The name of the size.
        what: &'static str,
        /// The invalid value.
        got: u16,
        /// The valid values.
        expected: &'static str,
    },
    /// The test vector has no users or sensors, or too many.
    #[error("the test vector has {got} {what}, but must have 1 to {most}")]
    TestVector {
        /// `users` or `sensors`.
        what: &'static str,
        /// How many it has.
        got: u16,
        /// The largest number.
        most: usize,
    },
    /// The reach in the test vector is not above 0.
    #[error("reach_m of the test vector is {value}, but must be above 0")]
    Reach {
        /// The invalid value.
        value: f32,
    },
    /// The file has too few or too many weights.
    #[error("the file has {got} bytes of weights and test vector, but its header needs {expected}")]
    Length {
        /// The number of bytes in the file.
        got: usize,
        /// The number of bytes needed.
        expected: usize,
    },
    /// A number is NaN or infinite.
    #[error("{what} {index} is not finite")]
    NotFinite {
        /// `weight` or `test number`.
        what: &'static str,
        /// The index of the number.
        index: usize,
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
pub enum SetsWriteError {
    /// The file could not be loaded again.
    #[error(transparent)]
    Unsound(#[from] SetsLoadError),
    /// The buffer is too small.
    #[error("a policy does not fit into {capacity} bytes")]
    TooLong {
        /// The size of the buffer, bytes.
        capacity: usize,
    },
}
