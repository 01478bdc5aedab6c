//! Reads an ONNX policy back as an [`Actor`], whoever wrote it to the contract.
//!
//! The graph is followed from `observation`, and linear operators are folded into layers: `Sub`,
//! `Add`, `Mul`, `Div` by constants, `MatMul`, `Gemm`, `Relu`, `Tanh`, `Slice` of columns,
//! `Identity`, `Constant`. Anything else is an error that names the node.

use std::{collections::HashMap, path::Path};

use anyhow::{Context, anyhow, bail, ensure};
use environment::Normalizer;
use firmware_core::{
    USERS_MAX,
    policy::{Provenance, mlp::SELF_TEST_TOLERANCE},
};
use host_sim::input;
use prost::Message;

use super::{
    FORMAT_VERSION,
    proto::{FLOAT, INT64, ModelProto, NodeProto, TensorProto},
};
use crate::actor::{Actor, Dense};

/// Reads a file.
///
/// # Errors
/// What is wrong, with the file's name.
pub fn read(path: &Path) -> anyhow::Result<Actor> {
    let bytes = input::read(path).with_context(|| path.display().to_string())?;
    parse(&bytes).with_context(|| path.display().to_string())
}

/// Reads a file's bytes and checks its test vector.
///
/// # Errors
/// What is wrong.
pub fn parse(bytes: &[u8]) -> anyhow::Result<Actor> {
    let model = ModelProto::decode(bytes).context("not an ONNX file")?;
    let metadata = Metadata::of_model(&model);
    let version: u32 = metadata.number("format_version")?;
    ensure!(
        version == FORMAT_VERSION,
        "format_version is {version}, but this build reads {FORMAT_VERSION}"
    );
    let actor = Walk::of_model(&model)?.actor(metadata.provenance()?)?;
    let [observation, displacement, scores] =
        ["test_observation", "test_displacement", "test_user_scores"].map(|key| metadata.list(key));
    let (observation, displacement, scores) = (observation?, displacement?, scores?);
    let inputs = actor.normalizer.offset.len();
    ensure!(
        observation.len() == inputs,
        "test_observation has {} numbers, but the network takes {inputs}",
        observation.len()
    );
    let got = actor.evaluate(&observation);
    let expected: Vec<f32> = displacement.into_iter().chain(scores).collect();
    ensure!(
        got.len() == expected.len(),
        "the test vector has {} outputs, but the network has {}",
        expected.len(),
        got.len()
    );
    let score_scale = expected[2..].iter().fold(1.0_f32, |a, b| a.max(b.abs()));
    for (i, (got, &expected)) in got.iter().zip(&expected).enumerate() {
        let scale = if i < 2 { actor.reach_m } else { score_scale };
        let close = (got - f64::from(expected)).abs() <= f64::from(SELF_TEST_TOLERANCE * scale);
        ensure!(
            close,
            "self-test: output {i} is {got}, but the file expects {expected}"
        );
    }
    Ok(actor)
}

struct Metadata<'m>(HashMap<&'m str, &'m str>);

impl<'m> Metadata<'m> {
    fn of_model(model: &'m ModelProto) -> Self {
        let entries = model.metadata_props.iter();
        Self(
            entries
                .map(|e| (e.key.as_str(), e.value.as_str()))
                .collect(),
        )
    }

    fn text(&self, key: &str) -> anyhow::Result<&'m str> {
        let found = self.0.get(key).copied();
        found.ok_or_else(|| anyhow!("metadata_props has no {key}"))
    }

    fn number<N: std::str::FromStr>(&self, key: &str) -> anyhow::Result<N> {
        let text = self.text(key)?;
        let parsed = text.trim().parse().ok();
        parsed.ok_or_else(|| anyhow!("metadata_props {key} is {text:?}, but must be a number"))
    }

    fn list(&self, key: &str) -> anyhow::Result<Vec<f32>> {
        let text = self.text(key)?;
        let numbers = text.split(',').map(|x| x.trim().parse::<f32>().ok());
        let numbers: Option<Vec<f32>> = numbers.collect();
        numbers.ok_or_else(|| anyhow!("metadata_props {key} must be numbers with commas between"))
    }

    fn provenance(&self) -> anyhow::Result<Provenance> {
        let area = self.list("area_m")?;
        let area_m = area[..]
            .try_into()
            .context("metadata_props area_m must be two numbers")?;
        Ok(Provenance {
            users: self.number("users")?,
            max_speed_mps: self.number("max_speed_mps")?,
            slot_duration_s: self.number("slot_duration_s")?,
            area_m,
            algorithm: self.bounded("algorithm")?,
            scenario: self.bounded("scenario")?,
            scenario_digest: self.bounded("scenario_digest")?,
            episodes: self.number("episodes")?,
            seed: self.number("seed")?,
        })
    }

    fn bounded<const N: usize>(&self, key: &str) -> anyhow::Result<heapless::String<N>> {
        let text = self.text(key)?;
        let fits = heapless::String::try_from(text);
        fits.map_err(|_| anyhow!("metadata_props {key} is longer than {N} bytes"))
    }
}

/// A value that depends on the observation.
#[derive(Clone, Debug, PartialEq)]
struct Branch {
    normalizer: Normalizer,
    /// Layers closed by ReLU.
    hidden: Vec<Dense>,
    /// A linear map after them.
    linear: Option<Dense>,
    /// `tanh`, and what it was multiplied with.
    reach: Option<f32>,
}

struct Walk {
    constants: HashMap<String, TensorProto>,
    values: HashMap<String, Branch>,
}

impl Walk {
    fn of_model(model: &ModelProto) -> anyhow::Result<Self> {
        let graph = model.graph.as_ref().context("the file has no graph")?;
        let input = graph.input.iter().find(|input| input.name == "observation");
        let shape = input
            .and_then(|input| input.kind.as_ref()?.tensor_type.as_ref()?.shape.as_ref())
            .context("the graph has no input named observation with a shape")?;
        let columns = shape.dim.last().and_then(|d| d.dim_value).unwrap_or(0);
        let columns = usize::try_from(columns).unwrap_or(0);
        ensure!(
            (1..=USERS_MAX + 4).contains(&columns),
            "observation must have the shape [1, M + 4], M at most {USERS_MAX}"
        );
        let identity = Branch {
            normalizer: Normalizer {
                offset: vec![0.0; columns],
                scale: vec![1.0; columns],
            },
            hidden: Vec::new(),
            linear: None,
            reach: None,
        };
        let named = graph
            .initializer
            .iter()
            .map(|t| (t.name.clone(), t.clone()));
        let mut walk = Self {
            constants: named.collect(),
            values: HashMap::from([("observation".to_owned(), identity)]),
        };
        for node in &graph.node {
            walk.visit(node)
                .with_context(|| format!("node {:?} ({})", node.name, node.op_type))?;
        }
        Ok(walk)
    }

    fn actor(mut self, provenance: Provenance) -> anyhow::Result<Actor> {
        let mut output = |name: &str| {
            let found = self.values.remove(name);
            found.with_context(|| format!("the graph has no output {name}"))
        };
        let (displacement, scores) = (output("displacement")?, output("user_scores")?);
        let reach_m = displacement
            .reach
            .context("displacement must be tanh(..) times V_max delta")?;
        ensure!(
            scores.reach.is_none(),
            "user_scores must be linear in the last hidden layer"
        );
        ensure!(
            displacement.hidden == scores.hidden && displacement.normalizer == scores.normalizer,
            "displacement and user_scores must share their hidden layers"
        );
        let (u, s) = (displacement.linear, scores.linear);
        let (mut last, s) = u.zip(s).context("an output has no layer of its own")?;
        last.outputs += s.outputs;
        last.weights.extend(s.weights);
        last.bias.extend(s.bias);
        let users = provenance.users as usize;
        let shape = [displacement.normalizer.offset.len(), last.outputs];
        ensure!(
            shape == [users + 4, users + 2],
            "the network goes from {} to {}, but for {users} users it must go from users + 4 to \
             users + 2",
            shape[0],
            shape[1]
        );
        let mut layers = displacement.hidden;
        layers.push(last);
        Ok(Actor {
            provenance,
            normalizer: displacement.normalizer,
            layers,
            reach_m,
        })
    }

    fn visit(&mut self, node: &NodeProto) -> anyhow::Result<()> {
        let output = node.output.first().context("it has no output")?.clone();
        if node.op_type == "Constant" {
            let tensor = node.attribute.iter().find_map(|a| a.t.clone());
            self.constants
                .insert(output, tensor.context("it has no tensor")?);
            return Ok(());
        }
        let (position, mut branch) = self.operand(node)?;
        // The constant operand, of operators that have one.
        let other = |walk: &Self| walk.floats(node, 1 - position.min(1));
        match node.op_type.as_str() {
            "Identity" | "Flatten" => {}
            "Sub" if position == 0 => branch.add(&other(self)?, -1.0)?,
            "Add" => branch.add(&other(self)?, 1.0)?,
            "Mul" => branch.scale(&other(self)?)?,
            "Div" if position == 0 => {
                let inverse: Vec<f32> = other(self)?.iter().map(|x| 1.0 / x).collect();
                branch.scale(&inverse)?;
            }
            "MatMul" if position == 0 => branch.apply(self.matrix(node, 1, false)?)?,
            "Gemm" if position == 0 => {
                let attribute = |name: &str| node.attribute.iter().find(|a| a.name == name);
                let plain = |name: &str| attribute(name).is_none_or(|a| a.f == 1.0);
                let transposed = |name: &str| attribute(name).is_some_and(|a| a.i != 0);
                ensure!(
                    plain("alpha") && plain("beta") && !transposed("transA"),
                    "alpha and beta must be 1 and transA 0"
                );
                let mut layer = self.matrix(node, 1, transposed("transB"))?;
                if node.input.len() > 2 {
                    let bias = self.floats(node, 2)?;
                    ensure!(bias.len() == layer.outputs, "its bias has the wrong length");
                    layer.bias = bias;
                }
                branch.apply(layer)?;
            }
            "Relu" => branch.relu()?,
            "Tanh" => {
                ensure!(branch.reach.is_none(), "tanh of tanh");
                branch.reach = Some(1.0);
            }
            "Slice" => branch.slice(&self.slice_bounds(node)?)?,
            other => bail!("{other} is not an operator that a policy is made of"),
        }
        self.values.insert(output, branch);
        Ok(())
    }

    /// Which input depends on the observation, and its value.
    fn operand(&self, node: &NodeProto) -> anyhow::Result<(usize, Branch)> {
        let known = |(i, name): (usize, &String)| Some((i, self.values.get(name)?.clone()));
        let mut operands = node.input.iter().enumerate().filter_map(known);
        let first = operands
            .next()
            .context("no input depends on the observation")?;
        ensure!(
            operands.next().is_none(),
            "two inputs depend on the observation"
        );
        Ok(first)
    }

    fn constant(&self, node: &NodeProto, index: usize) -> anyhow::Result<&TensorProto> {
        let name = node.input.get(index);
        let found = name.and_then(|name| self.constants.get(name));
        found.with_context(|| format!("input {index} is not a constant"))
    }

    fn floats(&self, node: &NodeProto, index: usize) -> anyhow::Result<Vec<f32>> {
        let tensor = self.constant(node, index)?;
        ensure!(
            tensor.data_type == FLOAT,
            "input {index} must be of 32-bit floats"
        );
        if !tensor.float_data.is_empty() {
            return Ok(tensor.float_data.clone());
        }
        let (words, _) = tensor.raw_data.as_chunks::<4>();
        Ok(words.iter().map(|&word| f32::from_le_bytes(word)).collect())
    }

    /// Starts, ends, axes and steps of an opset-10-or-later `Slice`: one range of columns.
    fn slice_bounds(&self, node: &NodeProto) -> anyhow::Result<[i64; 2]> {
        let integer = |index: usize| -> anyhow::Result<i64> {
            let tensor = self.constant(node, index)?;
            ensure!(
                tensor.data_type == INT64,
                "input {index} must be a 64-bit integer"
            );
            let (words, _) = tensor.raw_data.as_chunks::<8>();
            let raw = words.iter().map(|&word| i64::from_le_bytes(word));
            let mut values = tensor.int64_data.iter().copied().chain(raw);
            let value = values.next().context("an empty range")?;
            ensure!(values.next().is_none(), "only one axis can be sliced");
            Ok(value)
        };
        let axis = if node.input.len() > 3 { integer(3)? } else { 0 };
        let step = if node.input.len() > 4 { integer(4)? } else { 1 };
        ensure!(
            (axis == 1 || axis == -1) && step == 1,
            "only columns can be sliced"
        );
        Ok([integer(1)?, integer(2)?])
    }

    /// A constant matrix as a layer without bias: rows are outputs.
    fn matrix(&self, node: &NodeProto, index: usize, transposed: bool) -> anyhow::Result<Dense> {
        let values = self.floats(node, index)?;
        let dims = &self.constant(node, index)?.dims;
        let &[rows, columns] = &dims[..] else {
            bail!("input {index} must be a matrix");
        };
        let (rows, columns) = (usize::try_from(rows)?, usize::try_from(columns)?);
        ensure!(
            rows.checked_mul(columns) == Some(values.len()),
            "input {index} is cut: {rows} x {columns}, but {} numbers",
            values.len()
        );
        ensure!(rows > 0 && columns > 0, "input {index} is empty");
        let (outputs, inputs) = if transposed {
            (rows, columns)
        } else {
            (columns, rows)
        };
        let at = |o: usize, i: usize| {
            if transposed {
                o * inputs + i
            } else {
                i * outputs + o
            }
        };
        let elements = (0..outputs).flat_map(|o| (0..inputs).map(move |i| (o, i)));
        Ok(Dense {
            inputs,
            outputs,
            weights: elements.map(|(o, i)| values[at(o, i)]).collect(),
            bias: vec![0.0; outputs],
        })
    }
}

impl Branch {
    fn add(&mut self, values: &[f32], sign: f32) -> anyhow::Result<()> {
        ensure!(self.reach.is_none(), "displacement cannot be shifted");
        if let Some(layer) = &mut self.linear {
            let values = spread(values, layer.outputs)?;
            layer
                .bias
                .iter_mut()
                .zip(values)
                .for_each(|(b, x)| *b += sign * x);
            return Ok(());
        }
        let normalizer = self.normalizer_mut()?;
        let values = spread(values, normalizer.offset.len())?;
        let rows = normalizer.offset.iter_mut().zip(&normalizer.scale);
        rows.zip(values)
            .for_each(|((offset, scale), x)| *offset -= sign * x / scale);
        Ok(())
    }

    fn scale(&mut self, values: &[f32]) -> anyhow::Result<()> {
        if let Some(reach) = &mut self.reach {
            let same = values.iter().all(|x| *x == values[0]);
            ensure!(
                same && !values.is_empty(),
                "both components must have one scale"
            );
            *reach *= values[0];
            return Ok(());
        }
        if let Some(layer) = &mut self.linear {
            let inputs = layer.inputs;
            let rows = layer.weights.chunks_exact_mut(inputs).zip(&mut layer.bias);
            for ((row, bias), x) in rows.zip(spread(values, layer.outputs)?) {
                row.iter_mut().for_each(|w| *w *= x);
                *bias *= x;
            }
            return Ok(());
        }
        let normalizer = self.normalizer_mut()?;
        let values = spread(values, normalizer.scale.len())?;
        normalizer
            .scale
            .iter_mut()
            .zip(values)
            .for_each(|(scale, x)| *scale *= x);
        Ok(())
    }

    fn normalizer_mut(&mut self) -> anyhow::Result<&mut Normalizer> {
        ensure!(
            self.hidden.is_empty(),
            "only observations and outputs can be scaled"
        );
        Ok(&mut self.normalizer)
    }

    fn apply(&mut self, layer: Dense) -> anyhow::Result<()> {
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

    fn relu(&mut self) -> anyhow::Result<()> {
        ensure!(self.reach.is_none(), "relu after tanh");
        self.hidden
            .push(self.linear.take().context("relu of no layer")?);
        Ok(())
    }

    fn slice(&mut self, bounds: &[i64; 2]) -> anyhow::Result<()> {
        ensure!(self.reach.is_none(), "a slice after tanh");
        let layer = self.linear.as_mut().context("a slice of no layer")?;
        let n = layer.outputs as i64;
        let [start, end] = bounds.map(|b| (if b < 0 { b + n } else { b }).clamp(0, n) as usize);
        ensure!(start < end, "an empty slice");
        layer.weights = layer.weights[start * layer.inputs..end * layer.inputs].to_vec();
        layer.bias = layer.bias[start..end].to_vec();
        layer.outputs = end - start;
        Ok(())
    }
}

/// A constant operand broadcast to `n` columns.
fn spread(values: &[f32], n: usize) -> anyhow::Result<Vec<f32>> {
    match values.len() {
        1 => Ok(vec![values[0]; n]),
        len if len == n => Ok(values.to_vec()),
        len => bail!("a constant of {len} numbers meets {n} columns"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        learner::Learner,
        onnx::{proto::GraphProto, write},
        sac::Sac,
        settings::{Algorithm, Preset, Settings},
    };
    use host_sim::scenario::Scenario;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    /// A shipped mission's untrained policy with something spoilt: an error, not a panic.
    fn refused(spoil: impl Fn(&mut GraphProto)) -> String {
        let scenario = Scenario::shipped("separated").expect("shipped");
        let settings = Settings::preset(Preset::Paper, Algorithm::Sac, 1);
        let environment = environment::Environment::new(
            scenario.mission.clone(),
            &settings.environment_settings(),
        );
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let sac = Sac::new(&settings, environment.dimensions(), &mut rng);
        let bytes = write(&Actor::new(sac.deterministic(), &scenario, &settings, 0));
        let mut model = ModelProto::decode(&bytes[..]).expect("an ONNX file");
        spoil(model.graph.as_mut().expect("a graph"));
        let error = parse(&model.encode_to_vec()).expect_err("unsound");
        format!("{error:#}")
    }

    fn set_observation_dim(graph: &mut GraphProto, index: usize, value: i64) {
        let kind = graph.input[0].kind.as_mut().expect("a type");
        let shape = kind.tensor_type.as_mut().and_then(|t| t.shape.as_mut());
        shape.expect("a shape").dim[index].dim_value = Some(value);
    }

    fn matrix(graph: &mut GraphProto) -> &mut TensorProto {
        let mut constants = graph.initializer.iter_mut();
        let found = constants.find(|tensor| tensor.dims.len() == 2 && tensor.dims[0] > 2);
        found.expect("weights")
    }

    #[test]
    fn shapes_that_do_not_fit_their_numbers_are_refused() {
        let error = refused(|graph| set_observation_dim(graph, 1, 1 << 62));
        assert!(error.contains("must have the shape [1, M + 4]"), "{error}");
        // 2^32 by 2^32 is 0 in 64 bits, and so are the numbers that are there.
        let error = refused(|graph| {
            let matrix = matrix(graph);
            matrix.dims = vec![1 << 32, 1 << 32];
            (matrix.raw_data, matrix.float_data) = (Vec::new(), Vec::new());
        });
        assert!(error.contains("is cut"), "{error}");
        let error = refused(|graph| {
            let matrix = matrix(graph);
            matrix.dims = vec![0, 19];
            (matrix.raw_data, matrix.float_data) = (Vec::new(), Vec::new());
        });
        assert!(error.contains("is empty"), "{error}");
    }
}
