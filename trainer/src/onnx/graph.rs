//! A graph while it is written: nodes, constants, inputs and outputs.

use prost::Message;

use super::{
    contract::OPSET,
    proto::{
        ATTRIBUTE_INT, ATTRIBUTE_INTS, Attribute, Dimension, FLOAT, FLOAT16, GraphProto, INT64,
        ModelProto, NodeProto, OperatorSetId, StringStringEntry, TensorProto, TensorShape,
        TensorType, TypeProto, ValueInfo,
    },
};

/// The ONNX IR version that belongs to operator set 17.
const IR_VERSION: i64 = 8;

/// The nodes and constants written so far. Every value has a name.
#[derive(Debug, Default)]
pub(super) struct Graph {
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
}

impl Graph {
    /// Adds a tensor of 32-bit floats.
    pub(super) fn constant(&mut self, name: &str, dims: &[i64], values: &[f32]) -> String {
        let bytes = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.tensor(name, dims, FLOAT, bytes)
    }

    /// Adds a tensor of 16-bit floats, given by their bits.
    pub(super) fn halves(&mut self, name: &str, dims: &[i64], bits: &[u16]) -> String {
        let bytes = bits.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.tensor(name, dims, FLOAT16, bytes)
    }

    /// Adds a vector of 64-bit integers.
    pub(super) fn integers(&mut self, name: &str, values: &[i64]) -> String {
        let bytes = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.tensor(name, &[values.len() as i64], INT64, bytes)
    }

    fn tensor(&mut self, name: &str, dims: &[i64], data_type: i32, raw_data: Vec<u8>) -> String {
        self.constants.push(TensorProto {
            dims: dims.to_vec(),
            data_type,
            name: name.into(),
            raw_data,
            ..TensorProto::default()
        });
        name.into()
    }

    /// Adds a node with one output, which gives the node its name.
    pub(super) fn node(&mut self, op: &str, inputs: &[&str], output: &str) -> String {
        self.node_with(op, inputs, &[output], Vec::new());
        output.into()
    }

    /// Adds a node with attributes.
    pub(super) fn node_with(
        &mut self,
        op: &str,
        inputs: &[&str],
        outputs: &[&str],
        attribute: Vec<Attribute>,
    ) {
        let names = |names: &[&str]| names.iter().map(|&name| name.into()).collect();
        self.nodes.push(NodeProto {
            input: names(inputs),
            output: names(outputs),
            name: format!("{}:{op}", outputs.first().unwrap_or(&"")),
            op_type: op.into(),
            attribute,
        });
    }

    /// Returns the bytes of the file. The same graph always gives the same bytes.
    pub(super) fn finish(
        self,
        inputs: &[(&str, &[i64])],
        outputs: &[(&str, &[i64])],
        metadata: Vec<(&str, String)>,
    ) -> Vec<u8> {
        let values = |values: &[(&str, &[i64])]| {
            let value = |&(name, dims): &(&str, &[i64])| value_info(name, dims);
            values.iter().map(value).collect()
        };
        let entry = |(key, value): (&str, String)| StringStringEntry {
            key: key.into(),
            value,
        };
        let model = ModelProto {
            ir_version: IR_VERSION,
            producer_name: "trainer".into(),
            producer_version: env!("CARGO_PKG_VERSION").into(),
            graph: Some(GraphProto {
                node: self.nodes,
                name: "policy".into(),
                initializer: self.constants,
                input: values(inputs),
                output: values(outputs),
            }),
            opset_import: vec![OperatorSetId {
                domain: String::new(),
                version: OPSET,
            }],
            metadata_props: metadata.into_iter().map(entry).collect(),
        };
        model.encode_to_vec()
    }
}

/// Returns an attribute that is an integer.
pub(super) fn integer(name: &str, i: i64) -> Attribute {
    Attribute {
        name: name.into(),
        i,
        kind: ATTRIBUTE_INT,
        ..Attribute::default()
    }
}

/// Returns an attribute that is a list of integers.
pub(super) fn integers(name: &str, ints: &[i64]) -> Attribute {
    Attribute {
        name: name.into(),
        ints: ints.to_vec(),
        kind: ATTRIBUTE_INTS,
        ..Attribute::default()
    }
}

/// Returns numbers as one entry of the metadata.
pub(super) fn listed<N: ToString>(values: impl IntoIterator<Item = N>) -> String {
    let texts: Vec<String> = values.into_iter().map(|value| value.to_string()).collect();
    texts.join(",")
}

fn value_info(name: &str, dims: &[i64]) -> ValueInfo {
    let dimension = |&n| Dimension { dim_value: Some(n) };
    ValueInfo {
        name: name.into(),
        kind: Some(TypeProto {
            tensor_type: Some(TensorType {
                elem_type: FLOAT,
                shape: Some(TensorShape {
                    dim: dims.iter().map(dimension).collect(),
                }),
            }),
        }),
    }
}
