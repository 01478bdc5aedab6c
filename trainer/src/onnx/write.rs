//! Writes an [`Actor`] as an ONNX file.

use super::{
    contract::FORMAT_VERSION,
    graph::{Graph, integer, listed},
};
use crate::actor::{Actor, Dense};
use firmware_core::policy::mlp::{Activation, Limit};

/// Returns the bytes of an `.onnx` file. The same actor always gives the same bytes.
pub fn write(actor: &Actor) -> Vec<u8> {
    let users = actor.users();
    let mut graph = Graph::default();
    let n = actor.normalizer.offset.len() as i64;
    let offset = graph.constant("normalizer.offset", &[1, n], &actor.normalizer.offset);
    let scale = graph.constant("normalizer.scale", &[1, n], &actor.normalizer.scale);
    let mut x = graph.node("Sub", &["observation", &offset], "centred");
    x = graph.node("Mul", &[&x, &scale], "normalised");
    let (last, hidden) = actor.layers.split_last().expect("a network has layers");
    for (index, layer) in hidden.iter().enumerate() {
        x = dense(&mut graph, layer, &x, &format!("hidden{index}"));
        x = match actor.functions.activation {
            Activation::Relu => graph.node("Relu", &[&x], &format!("hidden{index}.relu")),
            Activation::Tanh => graph.node("Tanh", &[&x], &format!("hidden{index}.tanh")),
        };
    }
    let u = dense(&mut graph, &last.rows(0..2), &x, "displacement.linear");
    let a = limited(
        &mut graph,
        actor.functions.displacement,
        &u,
        "displacement.unit",
    );
    let reach = graph.constant("reach_m", &[1, 1], &[actor.reach_m]);
    graph.node("Mul", &[&a, &reach], "displacement");
    let scores = last.rows(2..2 + users);
    match actor.functions.scores {
        None => dense(&mut graph, &scores, &x, "user_scores"),
        Some(limit) => {
            let linear = dense(&mut graph, &scores, &x, "user_scores.linear");
            limited(&mut graph, limit, &linear, "user_scores")
        }
    };
    graph.finish(
        &[("observation", &[1, n])],
        &[
            ("displacement", &[1, 2]),
            ("user_scores", &[1, users as i64]),
        ],
        metadata(actor),
    )
}

/// Returns the `metadata_props`.
fn metadata(actor: &Actor) -> Vec<(&'static str, String)> {
    let p = &actor.provenance;
    let test = actor.test_vector();
    let counts = (0..p.users).map(|user| format!("count_{user}"));
    let names = counts.chain(["rate", "mse", "east_m", "north_m"].map(String::from));
    vec![
        ("format_version", FORMAT_VERSION.to_string()),
        ("users", p.users.to_string()),
        ("max_speed_mps", p.max_speed_mps.to_string()),
        ("slot_duration_s", p.slot_duration_s.to_string()),
        ("area_m", listed(p.area_m)),
        ("observation_names", listed(names)),
        ("algorithm", p.algorithm.to_string()),
        ("scenario", p.scenario.to_string()),
        ("scenario_digest", p.scenario_digest.to_string()),
        ("episodes", p.episodes.to_string()),
        ("seed", p.seed.to_string()),
        ("test_observation", listed(&test.observation)),
        ("test_displacement", listed(&test.displacement)),
        ("test_user_scores", listed(&test.user_scores)),
    ]
}

/// Adds the function that limits a value to `[-1, 1]`.
fn limited(graph: &mut Graph, limit: Limit, input: &str, output: &str) -> String {
    match limit {
        Limit::Tanh => graph.node("Tanh", &[input], output),
        Limit::Clip => {
            let low = graph.constant(&format!("{output}.low"), &[], &[-1.0]);
            let high = graph.constant(&format!("{output}.high"), &[], &[1.0]);
            graph.node("Clip", &[input, &low, &high], output)
        }
    }
}

fn dense(graph: &mut Graph, layer: &Dense, input: &str, output: &str) -> String {
    let dims = [layer.outputs as i64, layer.inputs as i64];
    let weights = graph.constant(&format!("{output}.weight"), &dims, &layer.weights);
    let bias = graph.constant(&format!("{output}.bias"), &dims[..1], &layer.bias);
    let attributes = vec![integer("transB", 1)];
    graph.node_with("Gemm", &[input, &weights, &bias], &[output], attributes);
    output.into()
}
