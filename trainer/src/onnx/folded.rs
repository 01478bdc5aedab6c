//! A network that is built up operator by operator and folded into dense layers.

use anyhow::{Context, bail, ensure};
use environment::Normalizer;

use crate::actor::Dense;

/// A value of the graph, as a function of the observation.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Folded {
    /// The normalization of the observation.
    pub(super) normalizer: Normalizer,
    /// The layers that are followed by ReLU.
    pub(super) hidden: Vec<Dense>,
    /// The layer after them, which is not followed by ReLU.
    pub(super) linear: Option<Dense>,
    /// The factor of `tanh`, once `tanh` was applied.
    pub(super) reach: Option<f32>,
}

impl Folded {
    /// Returns the observation itself, with `columns` components.
    pub(super) fn observation(columns: usize) -> Self {
        Self {
            normalizer: Normalizer {
                offset: vec![0.0; columns],
                scale: vec![1.0; columns],
            },
            hidden: Vec::new(),
            linear: None,
            reach: None,
        }
    }

    /// Adds constants to the observation, or to the bias of the last layer.
    pub(super) fn add(&mut self, values: &[f32], sign: f32) -> anyhow::Result<()> {
        ensure!(self.reach.is_none(), "displacement cannot be shifted");
        if let Some(layer) = &mut self.linear {
            let values = broadcast(values, layer.outputs)?;
            for (bias, x) in layer.bias.iter_mut().zip(values) {
                *bias += sign * x;
            }
            return Ok(());
        }
        let normalizer = self.normalizer_mut()?;
        let values = broadcast(values, normalizer.offset.len())?;
        let rows = normalizer.offset.iter_mut().zip(&normalizer.scale);
        for ((offset, scale), x) in rows.zip(values) {
            *offset -= sign * x / scale;
        }
        Ok(())
    }

    /// Multiplies the observation, or the output of `tanh`, by constants.
    pub(super) fn scale(&mut self, values: &[f32]) -> anyhow::Result<()> {
        if let Some(reach) = &mut self.reach {
            let same = values.iter().all(|x| *x == values[0]);
            ensure!(
                same && !values.is_empty(),
                "both components must have one scale"
            );
            *reach *= values[0];
            return Ok(());
        }
        let normalizer = self.normalizer_mut()?;
        let values = broadcast(values, normalizer.scale.len())?;
        for (scale, x) in normalizer.scale.iter_mut().zip(values) {
            *scale *= x;
        }
        Ok(())
    }

    /// Appends a layer.
    pub(super) fn apply(&mut self, layer: Dense) -> anyhow::Result<()> {
        ensure!(self.reach.is_none(), "a layer after tanh");
        let before = self.linear.as_ref().or(self.hidden.last());
        let width = before.map_or(self.normalizer.offset.len(), |layer| layer.outputs);
        ensure!(
            layer.inputs == width,
            "it takes {} numbers, but gets {width}",
            layer.inputs
        );
        ensure!(
            self.linear.is_none(),
            "two layers with nothing between them"
        );
        self.linear = Some(layer);
        Ok(())
    }

    /// Applies ReLU to the last layer.
    pub(super) fn relu(&mut self) -> anyhow::Result<()> {
        ensure!(self.reach.is_none(), "relu after tanh");
        self.hidden
            .push(self.linear.take().context("relu of no layer")?);
        Ok(())
    }

    /// Applies `tanh` to the last layer.
    pub(super) fn tanh(&mut self) -> anyhow::Result<()> {
        ensure!(self.reach.is_none(), "tanh of tanh");
        self.reach = Some(1.0);
        Ok(())
    }

    /// Keeps the outputs of the last layer from `bounds[0]` to before `bounds[1]`; negative bounds
    /// count from the end.
    pub(super) fn slice(&mut self, bounds: [i64; 2]) -> anyhow::Result<()> {
        ensure!(self.reach.is_none(), "a slice after tanh");
        let layer = self.linear.as_mut().context("a slice of no layer")?;
        let n = layer.outputs as i64;
        let [start, end] = bounds.map(|b| (if b < 0 { b + n } else { b }).clamp(0, n) as usize);
        ensure!(start < end, "an empty slice");
        *layer = layer.rows(start..end);
        Ok(())
    }

    fn normalizer_mut(&mut self) -> anyhow::Result<&mut Normalizer> {
        ensure!(
            self.hidden.is_empty() && self.linear.is_none(),
            "only observations and outputs can be scaled"
        );
        Ok(&mut self.normalizer)
    }
}

/// Broadcasts a constant operand to `n` columns.
fn broadcast(values: &[f32], n: usize) -> anyhow::Result<Vec<f32>> {
    match values.len() {
        1 => Ok(vec![values[0]; n]),
        len if len == n => Ok(values.to_vec()),
        len => bail!("a constant of {len} numbers meets {n} columns"),
    }
}
