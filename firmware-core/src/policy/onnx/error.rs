// SPDX-License-Identifier: MIT OR Apache-2.0
//! What can be wrong with a file.

use std::{format, string::String};

use tract_onnx::prelude::TractError;

use crate::policy::sets::SetsLoadError;

/// Error returned when a file is not a valid policy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OnnxError {
    /// tract cannot read or run the network.
    #[error("not a network that can be run: {reason}")]
    Network {
        /// tract's message, in one line.
        reason: String,
    },
    /// Metadata entries are missing.
    #[error("metadata_props has no {keys}")]
    Missing {
        /// The keys of all missing entries, with commas between.
        keys: String,
    },
    /// A metadata entry has an invalid value.
    #[error("metadata_props {key} is {value:?}, but must be {expected}")]
    Metadata {
        /// The key of the entry.
        key: &'static str,
        /// The invalid value.
        value: String,
        /// The valid values.
        expected: String,
    },
    /// An input or output has another name or shape.
    #[error("{what} is {got}, but must be {expected}")]
    Signature {
        /// The name of the input or output.
        what: &'static str,
        /// What the file has.
        got: String,
        /// The required signature.
        expected: String,
    },
    /// A policy for any mission does not reproduce its test vector.
    #[error(transparent)]
    Sets(#[from] SetsLoadError),
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

impl OnnxError {
    pub(super) fn network(error: impl Into<TractError>) -> Self {
        let reason = format!("{:#}", error.into());
        Self::Network {
            reason: reason.replace('\n', " "),
        }
    }
}
