//! The weights of a file: their names and shapes, in the order of the vector of parameters.

use anyhow::{Context, bail, ensure};
use firmware_core::policy::sets::{Precision, half};

use super::super::proto::{FLOAT, FLOAT16, GraphProto, TensorProto};
use crate::{
    imitation::encoder::FEATURES,
    nn::sets::{Architecture, Heads, Layout, layout::Part},
};

/// Returns all groups of weights with their names, in the order of the parameters.
pub(super) fn named_parts(architecture: Architecture) -> Vec<(String, Part)> {
    let ends = |names: &[&str]| -> Vec<String> { names.iter().map(|&s| s.into()).collect() };
    let mut names = ends(&["sensor_in", "sensor_out", "mission", "user"]);
    for layer in 0..architecture.layers {
        let parts = ["attention_norm", "qkv", "mix", "hidden_norm", "up", "down"];
        names.extend(parts.map(|part| format!("layer{layer}.{part}")));
    }
    names.push("final_norm".into());
    names.extend(ends(&["displacement_in", "displacement_out"]));
    names.extend(ends(&["user_in", "user_out"]));
    let parts = Layout::new(architecture, FEATURES, Heads::Policy).parts();
    names.into_iter().zip(parts).collect()
}

/// Returns the columns of a matrix as its rows.
pub(super) fn transposed(values: &[f32], columns: usize) -> Vec<f32> {
    let column = |c: usize| values.iter().skip(c).step_by(columns).copied();
    (0..columns).flat_map(column).collect()
}

/// The weights of a file.
pub(super) struct Weights<'g> {
    tensors: &'g [TensorProto],
}

impl<'g> Weights<'g> {
    pub(super) fn of(graph: &'g GraphProto) -> Self {
        Self {
            tensors: &graph.initializer,
        }
    }

    fn tensor(&self, name: &str) -> anyhow::Result<&'g TensorProto> {
        let found = self.tensors.iter().find(|tensor| tensor.name == name);
        found.with_context(|| {
            format!("the graph has no weights {name:?}: only files of `trainer export` can be read")
        })
    }

    /// Returns a dimension of a tensor.
    fn dimension(&self, name: &str, axis: usize) -> anyhow::Result<usize> {
        let dims = &self.tensor(name)?.dims;
        let dimension = dims.get(axis).and_then(|&n| usize::try_from(n).ok());
        dimension.with_context(|| format!("{name} has the shape {dims:?}"))
    }

    /// Returns the sizes of the network.
    pub(super) fn architecture(&self) -> anyhow::Result<Architecture> {
        let layer = |index: usize| self.tensor(&format!("layer{index}.qkv.weight")).is_ok();
        let architecture = Architecture {
            width: self.dimension("user.weight", 1)?,
            hidden: self.dimension("layer0.up.weight", 1)?,
            layers: (0..).take_while(|&index| layer(index)).count(),
        };
        architecture.check().map_err(anyhow::Error::msg)?;
        Ok(architecture)
    }

    /// Returns how the weights are stored.
    pub(super) fn precision(&self) -> anyhow::Result<Precision> {
        match self.tensor("user.weight")?.data_type {
            FLOAT => Ok(Precision::Single),
            FLOAT16 => Ok(Precision::Half),
            other => bail!("user.weight has the data type {other}, but must be of floats"),
        }
    }

    /// Returns the vector of parameters.
    pub(super) fn parameters(&self, architecture: Architecture) -> anyhow::Result<Vec<f32>> {
        let mut parameters = Vec::new();
        for (name, part) in named_parts(architecture) {
            match part {
                Part::Scales(_, width) => parameters.extend(self.numbers(&name, &[width])?),
                Part::Linear(linear) => {
                    let (inputs, outputs) = (linear.inputs, linear.outputs);
                    let weights = self.numbers(&format!("{name}.weight"), &[inputs, outputs])?;
                    parameters.extend(transposed(&weights, outputs));
                    parameters.extend(self.numbers(&format!("{name}.bias"), &[outputs])?);
                }
            }
        }
        Ok(parameters)
    }

    fn numbers(&self, name: &str, dims: &[usize]) -> anyhow::Result<Vec<f32>> {
        let tensor = self.tensor(name)?;
        let expected: Vec<i64> = dims.iter().map(|&n| n as i64).collect();
        let got = &tensor.dims;
        ensure!(
            *got == expected,
            "{name} has the shape {got:?}, but must have {expected:?}"
        );
        let numbers: Vec<f32> = match tensor.data_type {
            FLOAT => words(&tensor.raw_data).map(f32::from_le_bytes).collect(),
            FLOAT16 => words(&tensor.raw_data)
                .map(|word| half::to_single(u16::from_le_bytes(word)))
                .collect(),
            other => bail!("{name} has the data type {other}, but must be of floats"),
        };
        let count: usize = dims.iter().product();
        ensure!(
            numbers.len() == count,
            "{name} has {} numbers, but must have {count}",
            numbers.len()
        );
        Ok(numbers)
    }
}

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.as_chunks::<N>().0.iter().copied()
}
