//! Writes an [`Actor`] as an ONNX file.

use prost::Message;

use super::{
    contract::{FORMAT_VERSION, OPSET},
    proto::{
        ATTRIBUTE_INT, Attribute, Dimension, FLOAT, GraphProto, ModelProto, NodeProto,
        OperatorSetId, StringStringEntry, TensorProto, TensorShape, TensorType, TypeProto,
        ValueInfo,
    },
};
use crate::actor::{Actor, Dense};

/// The ONNX IR version that belongs to operator set 17.
const IR_VERSION: i64 = 8;

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
        x = graph.dense(layer, &x, &format!("hidden{index}"));
        x = graph.node("Relu", &[&x], &format!("hidden{index}.relu"));
    }
    let u = graph.dense(&last.rows(0..2), &x, "displacement.linear");
    let a = graph.node("Tanh", &[&u], "displacement.unit");
    let reach = graph.constant("reach_m", &[1, 1], &[actor.reach_m]);
    graph.node("Mul", &[&a, &reach], "displacement");
    graph.dense(&last.rows(2..2 + users), &x, "user_scores");

    let model = ModelProto {
        ir_version: IR_VERSION,
        producer_name: "trainer".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        graph: Some(GraphProto {
            node: graph.nodes,
            name: "policy".into(),
            initializer: graph.constants,
            input: vec![value_info("observation", n)],
            output: vec![
                value_info("displacement", 2),
                value_info("user_scores", users as i64),
            ],
        }),
        opset_import: vec![OperatorSetId {
            domain: String::new(),
            version: OPSET,
        }],
        metadata_props: metadata(actor),
    };
    model.encode_to_vec()
}

/// Returns the `metadata_props`.
fn metadata(actor: &Actor) -> Vec<StringStringEntry> {
    let p = &actor.provenance;
    let test = actor.test_vector();
    let counts = (0..p.users).map(|user| format!("count_{user}"));
    let names = counts.chain(["rate", "mse", "east_m", "north_m"].map(String::from));
    let list = |values: &[f32]| join(values.iter().map(f32::to_string));
    let entries = [
        ("format_version", FORMAT_VERSION.to_string()),
        ("users", p.users.to_string()),
        ("max_speed_mps", p.max_speed_mps.to_string()),
        ("slot_duration_s", p.slot_duration_s.to_string()),
        ("area_m", list(&p.area_m)),
        ("observation_names", join(names)),
        ("algorithm", p.algorithm.to_string()),
        ("scenario", p.scenario.to_string()),
        ("scenario_digest", p.scenario_digest.to_string()),
        ("episodes", p.episodes.to_string()),
        ("seed", p.seed.to_string()),
        ("test_observation", list(&test.observation)),
        ("test_displacement", list(&test.displacement)),
        ("test_user_scores", list(&test.user_scores)),
    ];
    entries
        .into_iter()
        .map(|(key, value)| StringStringEntry {
            key: key.into(),
            value,
        })
        .collect()
}

fn join(items: impl Iterator<Item = String>) -> String {
    items.collect::<Vec<_>>().join(",")
}

/// The nodes and constants written so far.
#[derive(Default)]
struct Graph {
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
}

impl Graph {
    fn constant(&mut self, name: &str, dims: &[i64], values: &[f32]) -> String {
        self.constants.push(TensorProto {
            dims: dims.to_vec(),
            data_type: FLOAT,
            name: name.into(),
            raw_data: values.iter().flat_map(|x| x.to_le_bytes()).collect(),
            ..TensorProto::default()
        });
        name.into()
    }

    fn node(&mut self, op: &str, inputs: &[&str], output: &str) -> String {
        self.nodes.push(NodeProto {
            input: inputs.iter().map(|&name| name.into()).collect(),
            output: vec![output.into()],
            name: format!("{output}:{op}"),
            op_type: op.into(),
            attribute: Vec::new(),
        });
        output.into()
    }

    fn dense(&mut self, layer: &Dense, input: &str, output: &str) -> String {
        let dims = [layer.outputs as i64, layer.inputs as i64];
        let weights = self.constant(&format!("{output}.weight"), &dims, &layer.weights);
        let bias = self.constant(&format!("{output}.bias"), &dims[..1], &layer.bias);
        self.node("Gemm", &[input, &weights, &bias], output);
        if let Some(node) = self.nodes.last_mut() {
            node.attribute.push(Attribute {
                name: "transB".into(),
                i: 1,
                kind: ATTRIBUTE_INT,
                ..Attribute::default()
            });
        }
        output.into()
    }
}

fn value_info(name: &str, columns: i64) -> ValueInfo {
    let dimension = |n| Dimension { dim_value: Some(n) };
    ValueInfo {
        name: name.into(),
        kind: Some(TypeProto {
            tensor_type: Some(TensorType {
                elem_type: FLOAT,
                shape: Some(TensorShape {
                    dim: vec![dimension(1), dimension(columns)],
                }),
            }),
        }),
    }
}
