//! `write_onnx`: a network as an `.onnx` file of the contract in `docs/training.md`. The writer is that
//! of the trainer.

use environment::Normalizer;
use firmware_core::policy::{
    Provenance,
    mlp::{Activation, Functions, Limit},
    output_len, state_len,
};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::{
    prelude::*,
    types::{PyBytes, PyList},
};
use trainer::{
    actor::{Actor, Dense},
    onnx,
};

use crate::mission::{Mission, value_error};

/// Returns the bytes of an `.onnx` file. `layers` are pairs of weights, a row per output, and biases.
#[pyfunction]
#[pyo3(signature = (
    mission, layers, *, activation, displacement, scores, normalize, algorithm, episodes, seed
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments")]
pub(crate) fn write_onnx<'py>(
    py: Python<'py>,
    mission: PyRef<'py, Mission>,
    layers: &Bound<'py, PyList>,
    activation: &str,
    displacement: &str,
    scores: Option<&str>,
    normalize: bool,
    algorithm: &str,
    episodes: u32,
    seed: u64,
) -> PyResult<Bound<'py, PyBytes>> {
    let functions = Functions {
        activation: match activation {
            "relu" => Activation::Relu,
            "tanh" => Activation::Tanh,
            _ => {
                return Err(value_error(format!(
                    "activation is {activation:?}, but must be relu or tanh"
                )));
            }
        },
        displacement: limit_named("displacement", displacement)?,
        scores: scores.map(|name| limit_named("scores", name)).transpose()?,
    };
    let users = mission.mission().user_count();
    let (inputs, outputs) = (state_len(users), output_len(users));
    let layers = dense_layers(layers, inputs, outputs)?;
    let bounded = |name: &str, what: &str| {
        value_error(format!(
            "{what} is {name:?}, which is longer than the contract allows"
        ))
    };
    let parameters = mission.mission().parameters();
    let digest = mission.scenario.digest();
    let name = &mission.scenario.name;
    let mut scenario = heapless::String::new();
    for c in name.chars() {
        if scenario.push(c).is_err() {
            break;
        }
    }
    let actor = Actor {
        provenance: Provenance {
            users: users as u32,
            max_speed_mps: parameters.max_speed_mps as f32,
            slot_duration_s: parameters.slot_duration_s as f32,
            area_m: [
                parameters.area.east_m as f32,
                parameters.area.north_m as f32,
            ],
            algorithm: heapless::String::try_from(algorithm)
                .map_err(|_| bounded(algorithm, "algorithm"))?,
            scenario,
            scenario_digest: heapless::String::try_from(digest.as_str())
                .map_err(|_| bounded(&digest, "scenario_digest"))?,
            episodes,
            seed,
        },
        normalizer: if normalize {
            Normalizer::of_mission(mission.mission())
        } else {
            Normalizer {
                offset: vec![0.0; inputs],
                scale: vec![1.0; inputs],
            }
        },
        layers,
        functions,
        reach_m: mission.mission().reach_m() as f32,
    };
    let file = onnx::write(&actor);
    // A file that cannot be loaded, or not be converted for the microcontroller, is not returned.
    onnx::to_policy_file(&file).map_err(|error| value_error(format!("{error:#}")))?;
    Ok(PyBytes::new(py, &file))
}

fn limit_named(what: &str, name: &str) -> PyResult<Limit> {
    match name {
        "tanh" => Ok(Limit::Tanh),
        "clip" => Ok(Limit::Clip),
        _ => Err(value_error(format!(
            "{what} is {name:?}, but must be tanh or clip"
        ))),
    }
}

/// Reads pairs of weights and biases and checks that each layer takes what the one before it returns.
fn dense_layers(layers: &Bound<'_, PyList>, inputs: usize, outputs: usize) -> PyResult<Vec<Dense>> {
    let mut read: Vec<Dense> = Vec::new();
    for (index, layer) in layers.iter().enumerate() {
        let (weights, bias): (Bound<'_, PyArray2<f32>>, Bound<'_, PyArray1<f32>>) =
            layer.extract()?;
        let [rows, columns] = [weights.shape()[0], weights.shape()[1]];
        let expected = read.last().map_or(inputs, |before| before.outputs);
        if columns != expected || bias.len() != rows {
            return Err(value_error(format!(
                "layers[{index}] has weights ({rows}, {columns}) and {} biases, but must have weights \
                 (outputs, {expected}) and a bias per output",
                bias.len()
            )));
        }
        let [weights, bias] = [weights.to_vec()?, bias.to_vec()?];
        if weights.iter().chain(&bias).any(|x| !x.is_finite()) {
            return Err(value_error(format!(
                "layers[{index}] has a number that is not finite"
            )));
        }
        read.push(Dense {
            inputs: columns,
            outputs: rows,
            weights,
            bias,
        });
    }
    let last = read.last().map(|layer| layer.outputs);
    if last != Some(outputs) {
        return Err(value_error(format!(
            "the last layer has {} outputs, but must have {outputs}: the displacement and a score per user",
            last.unwrap_or(0)
        )));
    }
    Ok(read)
}
