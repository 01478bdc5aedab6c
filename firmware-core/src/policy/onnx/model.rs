// SPDX-License-Identifier: MIT OR Apache-2.0
//! A model as tract reads it, and its signature.

use std::{
    format,
    string::{String, ToString},
    vec::Vec as StdVec,
};

use tract_onnx::prelude::*;

use super::{error::OnnxError, metadata::Metadata};

/// The name and shape of an input or output.
pub(super) type Value<'a> = (&'static str, &'a [usize]);

/// A model with its metadata.
pub(super) struct Model {
    graph: InferenceModel,
    pub(super) metadata: Metadata,
}

impl Model {
    /// Reads the bytes of a file.
    pub(super) fn read(file: &[u8]) -> Result<Self, OnnxError> {
        let mut reader = file;
        let graph = tract_onnx::onnx()
            .model_for_read(&mut reader)
            .map_err(OnnxError::network)?;
        let metadata = Metadata::of_model(&graph);
        Ok(Self { graph, metadata })
    }

    /// Checks inputs and outputs, all of 32-bit floats and in this order, optimises the network and
    /// makes it ready to run.
    pub(super) fn prepare(
        self,
        inputs: &[Value<'_>],
        outputs: &[Value<'_>],
    ) -> Result<(TypedSimpleState, Metadata), OnnxError> {
        self.check_names(inputs, outputs)?;
        let mut graph = self.graph;
        for (index, (_, dims)) in inputs.iter().enumerate() {
            graph = graph
                .with_input_fact(index, f32::fact(*dims).into())
                .map_err(OnnxError::network)?;
        }
        let graph = graph.into_optimized().map_err(OnnxError::network)?;
        for (index, &(what, dims)) in outputs.iter().enumerate() {
            let fact = graph.output_fact(index).map_err(OnnxError::network)?;
            if fact.datum_type != f32::datum_type() || fact.shape.as_concrete() != Some(dims) {
                let dims: StdVec<String> = dims.iter().map(usize::to_string).collect();
                return Err(OnnxError::Signature {
                    what,
                    got: format!("{fact:?}"),
                    expected: format!("f32[{}]", dims.join(", ")),
                });
            }
        }
        let plan = graph.into_runnable().map_err(OnnxError::network)?;
        let state = plan.spawn().map_err(OnnxError::network)?;
        Ok((state, self.metadata))
    }

    /// Checks the names of inputs and outputs.
    fn check_names(&self, inputs: &[Value<'_>], outputs: &[Value<'_>]) -> Result<(), OnnxError> {
        let got = |outlets: &[OutletId]| -> String {
            let name = |outlet: &OutletId| match self.graph.outlet_label(*outlet) {
                Some(label) => label,
                None => self.graph.node(outlet.node).name.as_str(),
            };
            outlets.iter().map(name).collect::<StdVec<_>>().join(", ")
        };
        let check = |what, got: String, expected: &[Value<'_>]| {
            let names: StdVec<&str> = expected.iter().map(|(name, _)| *name).collect();
            let expected = names.join(", ");
            match got == expected {
                true => Ok(()),
                false => Err(OnnxError::Signature {
                    what,
                    got,
                    expected,
                }),
            }
        };
        let outlets = self.graph.input_outlets().map_err(OnnxError::network)?;
        let what = match inputs {
            [_] => "the input",
            _ => "the list of inputs",
        };
        check(what, got(outlets), inputs)?;
        let outlets = self.graph.output_outlets().map_err(OnnxError::network)?;
        check("the list of outputs", got(outlets), outputs)
    }
}
