//! Reads a network back from a file of [`write`](super::write()).

use std::path::Path;

use anyhow::{Context, ensure};
use files::input;
use firmware_core::policy::sets::{
    FORMAT_VERSION, Precision, SetsNetwork, SetsObservation, SetsWork,
};
use prost::Message;

use super::{
    super::{metadata::Entries, proto::ModelProto},
    metadata::{provenance, test_vector},
    weights::Weights,
};
use crate::imitation::trained::TrainedNetwork;

/// Returns whether the bytes are an ONNX file of a policy for any mission.
pub fn is_for_any_mission(file: &[u8]) -> bool {
    let version = FORMAT_VERSION.to_string();
    ModelProto::decode(file).is_ok_and(|model| {
        let mut entries = model.metadata_props.iter();
        entries.any(|entry| entry.key == "format_version" && entry.value == version)
    })
}

/// Reads a file.
///
/// # Errors
/// Says what is wrong, with the file's name.
pub fn read(path: &Path) -> anyhow::Result<(TrainedNetwork, Precision)> {
    let bytes = input::read(path).with_context(|| path.display().to_string())?;
    parse(&bytes).with_context(|| path.display().to_string())
}

/// Reads the bytes of a file. Its graph is not interpreted: the weights are found by their names,
/// and the test vector shows that the network with these weights is meant.
///
/// # Errors
/// Says what is wrong.
pub fn parse(bytes: &[u8]) -> anyhow::Result<(TrainedNetwork, Precision)> {
    let model = ModelProto::decode(bytes).context("not an ONNX file")?;
    let entries = Entries::of_model(&model);
    let version: u16 = entries.number("format_version")?;
    ensure!(
        version == FORMAT_VERSION,
        "format_version is {version}, but a policy for any mission has {FORMAT_VERSION}"
    );
    let graph = model.graph.as_ref().context("the file has no graph")?;
    let weights = Weights::of(graph);
    let architecture = weights.architecture()?;
    let precision = weights.precision()?;
    let network = TrainedNetwork {
        architecture,
        parameters: weights.parameters(architecture)?,
        provenance: provenance(&entries)?,
    };
    let (observation, expected) = test_vector(&entries)?;
    check(&network, precision, &observation, &expected)?;
    Ok((network, precision))
}

/// Checks that the network gives the outputs that the file expects.
fn check(
    network: &TrainedNetwork,
    precision: Precision,
    observation: &SetsObservation,
    expected: &[f32],
) -> anyhow::Result<()> {
    let mut work = SetsWork::default();
    let flying = SetsNetwork::load(network.to_policy_file(precision)?, &mut work)?;
    let output = flying.evaluate(observation, &mut work);
    let output = output.context("the network cannot be evaluated")?;
    output.check(observation, expected.iter().copied())?;
    Ok(())
}
