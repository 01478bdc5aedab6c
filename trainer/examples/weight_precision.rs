//! What shorter weights cost: the table in `docs/target.md`.
//!
//! ```text
//! cargo run --release -p trainer --example weight_precision -- --write docs/target.md
//! ```
//!
//! The weights of the shipped SAC policies of the tuned preset are rounded, and each policy flies its
//! own mission. Biases and the normalization stay as they are. Fails if a flight breaks a constraint.

use std::{fmt::Write as _, fs, path::PathBuf};

use anyhow::{Context, Error, Result, ensure};
use clap::Parser;
use environment::Allocation;
use figures::document;
use firmware_core::policy::mlp::Mlp;
use scenario::Scenario;
use trainer::{
    actor::{Actor, Dense},
    evaluate::fly,
    onnx,
};

/// Compares policies with rounded weights.
#[derive(Debug, Parser)]
struct Arguments {
    /// Directory of the policies
    #[arg(long, default_value = "models/cells")]
    policies: PathBuf,
    /// Replace the table of this document; without it the table is printed
    #[arg(long)]
    write: Option<PathBuf>,
}

/// A way of storing weights.
#[derive(Clone, Copy)]
enum Precision {
    /// As they are: 32 bits.
    Single,
    /// Integers of this many bits, and one scale for each output.
    PerOutput(u32),
    /// Integers of this many bits, and one scale for each layer.
    PerLayer(u32),
}

const PRECISIONS: [Precision; 6] = [
    Precision::Single,
    Precision::PerOutput(8),
    Precision::PerLayer(8),
    Precision::PerOutput(6),
    Precision::PerOutput(5),
    Precision::PerOutput(4),
];

impl Precision {
    fn title(self) -> String {
        match self {
            Self::Single => "single precision".into(),
            Self::PerOutput(bits) => format!("{bits} bits, a scale for each output"),
            Self::PerLayer(bits) => format!("{bits} bits, a scale for each layer"),
        }
    }

    /// Returns the bytes of all weights and scales.
    fn bytes(self, layers: &[Dense]) -> usize {
        let weights: usize = layers.iter().map(|layer| layer.weights.len()).sum();
        let outputs: usize = layers.iter().map(|layer| layer.outputs).sum();
        let packed = |bits: u32| (weights * bits as usize).div_ceil(8);
        match self {
            Self::Single => 4 * weights,
            Self::PerOutput(bits) => packed(bits) + 4 * outputs,
            Self::PerLayer(bits) => packed(bits) + 4 * layers.len(),
        }
    }

    fn round(self, layer: &mut Dense) {
        let inputs = layer.inputs;
        match self {
            Self::Single => {}
            Self::PerOutput(bits) => {
                for row in layer.weights.chunks_mut(inputs) {
                    round_to_integers(row, bits);
                }
            }
            Self::PerLayer(bits) => round_to_integers(&mut layer.weights, bits),
        }
    }
}

/// Rounds to multiples of a scale with which the largest number is the largest integer.
fn round_to_integers(weights: &mut [f32], bits: u32) {
    let largest = weights.iter().fold(0.0_f32, |most, w| most.max(w.abs()));
    let scale = largest / ((1 << (bits - 1)) - 1) as f32;
    if scale > 0.0 {
        for weight in weights {
            *weight = (*weight / scale).round() * scale;
        }
    }
}

/// Returns the policies with the missions that they were trained for, in the order of their names.
fn policies(arguments: &Arguments) -> Result<Vec<(Scenario, Actor)>> {
    let mut missions = Vec::new();
    for topology in ["separated", "mixed"] {
        for noise_dbm in [-95.0, -85.0] {
            for mse_threshold in [0.010, 0.015, 0.020, 0.025] {
                let shipped = Scenario::shipped(topology).context("a shipped scenario")?;
                let changed = shipped
                    .with_noise_dbm(noise_dbm)
                    .and_then(|scenario| scenario.with_mse_threshold(mse_threshold));
                missions.push(changed.map_err(Error::msg)?);
            }
        }
    }
    let folder = arguments.policies.display().to_string();
    let mut files = Vec::new();
    for entry in fs::read_dir(&arguments.policies).context(folder.clone())? {
        let path = entry?.path();
        if path.to_string_lossy().ends_with("-sac-tuned-s1.onnx") {
            files.push(path);
        }
    }
    files.sort();
    let mut found = Vec::new();
    for file in files {
        let actor = onnx::read::read(&file)?;
        let digest = &actor.provenance.scenario_digest;
        let mission = missions.iter().find(|m| m.digest() == digest.as_str());
        if let Some(mission) = mission {
            found.push((mission.clone(), actor));
        }
    }
    ensure!(
        found.len() == missions.len(),
        "{folder}: {} policies",
        found.len()
    );
    Ok(found)
}

/// Flies a policy as the microcontroller would, and returns its total, bit/s/Hz.
fn total(mission: &Scenario, actor: &Actor) -> Result<f64> {
    let policy = Mlp::load(actor.to_policy_file()?).map_err(Error::msg)?;
    let flight = fly(&mission.mission, policy, Allocation::Exact)?;
    ensure!(
        flight.is_admissible(),
        "{}: a broken constraint",
        mission.name
    );
    Ok(flight.sum_rate)
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let policies = policies(&arguments)?;
    let exact: Result<Vec<f64>> = policies.iter().map(|(m, actor)| total(m, actor)).collect();
    let exact = exact?;
    let mut table = format!(
        "| weights | bytes | mean total, {} policies | worst |\n|---|--:|--:|--:|\n",
        policies.len()
    );
    for precision in PRECISIONS {
        let mut ratios = Vec::new();
        for ((mission, actor), exact) in policies.iter().zip(&exact) {
            let mut rounded = actor.clone();
            for layer in &mut rounded.layers {
                precision.round(layer);
            }
            ratios.push(total(mission, &rounded)? / exact);
        }
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        let worst = ratios.iter().copied().fold(f64::INFINITY, f64::min);
        let bytes = precision.bytes(&policies[0].1.layers);
        let title = precision.title();
        writeln!(table, "| {title} | {bytes} | {mean:.4} | {worst:.4} |")?;
    }
    match arguments.write {
        Some(document) => document::write_table(&document, "weights", &table).map_err(Error::msg),
        None => {
            print!("{table}");
            Ok(())
        }
    }
}
