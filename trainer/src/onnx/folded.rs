//! A network that is built up operator by operator and folded into dense layers.

use anyhow::{Context, bail, ensure};
use environment::Normalizer;

use crate::actor::Dense;
use firmware_core::policy::mlp::{Activation, Limit};

/// A value of the graph, as a function of the observation.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Folded {
    /// The normalization of the observation.
    pub(super) normalizer: Normalizer,
    /// The layers that are followed by an activation.
    pub(super) hidden: Vec<Dense>,
    /// The activation of the hidden layers, if there are any.
    pub(super) activation: Option<Activation>,
    /// The layer after them, which is not followed by an activation.
    pub(super) linear: Option<Dense>,
    /// The function that limits the output, once it was applied.
    pub(super) limit: Option<Limit>,
    /// The factor of the limited output. A `tanh` without one may turn out to be an activation.
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
            activation: None,
            linear: None,
            limit: None,
            reach: None,
        }
    }

    /// Adds constants to the observation, or to the bias of the last layer.
    pub(super) fn add(&mut self, values: &[f32], sign: f32) -> anyhow::Result<()> {
        ensure!(self.limit.is_none(), "displacement cannot be shifted");
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
        if self.limit.is_some() {
            let same = values.iter().all(|x| *x == values[0]);
            ensure!(
                same && !values.is_empty(),
                "both components must have one scale"
            );
            *self.reach.get_or_insert(1.0) *= values[0];
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
        ensure!(self.reach.is_none(), "a layer after tanh and its scale");
        match self.limit.take() {
            None => {}
            Some(Limit::Tanh) => self.activate(Activation::Tanh)?,
            Some(Limit::Clip) => bail!("a layer after a clip"),
        }
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
        ensure!(self.limit.is_none(), "relu after tanh");
        self.activate(Activation::Relu)
    }

    /// Makes the last layer a hidden one.
    fn activate(&mut self, activation: Activation) -> anyhow::Result<()> {
        let layer = self.linear.take();
        ensure!(
            *self.activation.get_or_insert(activation) == activation,
            "hidden layers have different activations"
        );
        self.hidden
            .push(layer.context("an activation of no layer")?);
        Ok(())
    }

    /// Limits the last layer to `[-1, 1]`. A `tanh` is an activation if another layer follows.
    pub(super) fn limit(&mut self, limit: Limit) -> anyhow::Result<()> {
        ensure!(self.limit.is_none(), "an output that is limited twice");
        ensure!(self.linear.is_some(), "a limit of no layer");
        self.limit = Some(limit);
        Ok(())
    }

    /// Keeps the outputs of the last layer from `bounds[0]` to before `bounds[1]`; negative bounds
    /// count from the end.
    pub(super) fn slice(&mut self, bounds: [i64; 2]) -> anyhow::Result<()> {
        ensure!(self.limit.is_none(), "a slice after tanh");
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
