// SPDX-License-Identifier: MIT OR Apache-2.0
//! Trained policies as ONNX files, run by tract (feature `onnx`, needs std).
//!
//! The contract is in `docs/training.md`: named inputs in raw units, outputs `displacement`
//! f32\[1, 2\] in metres and `user_scores`, normalizer and scaling in the graph, and
//! `metadata_props` with what the policy was trained for and a test vector. [`OnnxPolicy`] runs
//! files of version 1, for one mission, and [`SetsOnnx`] those of version 2, for any mission. Both
//! check all of it when they load, also for files from other programs.

mod error;
mod metadata;
mod mission;
mod model;
mod sets;

pub use error::OnnxError;
pub use mission::OnnxPolicy;
pub use sets::SetsOnnx;

use model::Model;

/// A network of any version.
#[derive(Debug)]
pub enum OnnxNetwork {
    /// For one mission.
    OneMission(OnnxPolicy),
    /// For any mission.
    AnyMission(SetsOnnx),
}

impl OnnxNetwork {
    /// Loads a network from a file's bytes.
    ///
    /// # Errors
    /// Returns what is wrong with the file.
    pub fn load(file: &[u8]) -> Result<Self, OnnxError> {
        let model = Model::read(file)?;
        match model.metadata.version() {
            Some(2) => SetsOnnx::of_model(model).map(Self::AnyMission),
            _ => OnnxPolicy::of_model(model).map(Self::OneMission),
        }
    }
}
