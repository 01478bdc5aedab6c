//! Reads an ONNX policy that follows the contract as an [`Actor`], whichever program wrote it.
//!
//! The graph must have the shape of the contract:
//!
//! ```text
//! x            = observation, shifted and scaled by constants        Sub, Add, Mul, Div
//! x            = relu(W x + b), any number of times                  Gemm, or MatMul and Add; Relu
//! displacement = V_max delta tanh(W x + b)                           Gemm, or MatMul and Add; Tanh; Mul
//! user_scores  = W x + b                                             Gemm, or MatMul and Add
//! ```
//!
//! The hidden layers may all have `Tanh` in place of `Relu`, and the displacement `Clip` to [-1, 1] in
//! place of `Tanh`; the scores may have one of these two as well. The last two layers may be one layer whose output columns are separated by `Slice`. Constants
//! are initializers or `Constant` nodes. Every other operator is an error that names the node.

use std::{collections::HashMap, path::Path};

use anyhow::{Context, bail, ensure};
use files::input;
use firmware_core::{
    USERS_MAX,
    policy::{
        Provenance,
        mlp::{Functions, Limit},
        output_len, state_len,
    },
};
use prost::Message;

use super::{
    folded::Folded,
    metadata::Metadata,
    proto::{GraphProto, ModelProto, NodeProto, TensorProto},
    tensor,
};
use crate::actor::Actor;

/// Reads a file.
///
/// # Errors
/// Says what is wrong, with the file's name.
pub fn read(path: &Path) -> anyhow::Result<Actor> {
    let bytes = input::read(path).with_context(|| path.display().to_string())?;
    parse(&bytes).with_context(|| path.display().to_string())
}

/// Reads the bytes of a file and checks its test vector.
///
/// # Errors
/// Says what is wrong.
pub fn parse(bytes: &[u8]) -> anyhow::Result<Actor> {
    let model = ModelProto::decode(bytes).context("not an ONNX file")?;
    let metadata = Metadata::of_model(&model)?;
    let graph = model.graph.as_ref().context("the file has no graph")?;
    let actor = Walk::over(graph)?.actor(metadata.provenance()?)?;
    metadata.check_test_vector(&actor)?;
    Ok(actor)
}

/// The values computed so far on the way through a graph.
struct Walk<'g> {
    constants: HashMap<&'g str, &'g TensorProto>,
    values: HashMap<&'g str, Folded>,
}

impl<'g> Walk<'g> {
    /// Visits all nodes of a graph, which ONNX sorts topologically.
    fn over(graph: &'g GraphProto) -> anyhow::Result<Self> {
        let input = graph.input.iter().find(|input| input.name == "observation");
        let shape = input
            .and_then(|input| input.kind.as_ref()?.tensor_type.as_ref()?.shape.as_ref())
            .context("the graph has no input named observation with a shape")?;
        let columns = shape.dim.last().and_then(|d| d.dim_value).unwrap_or(0);
        let columns = usize::try_from(columns).unwrap_or(0);
        ensure!(
            (1..=state_len(USERS_MAX)).contains(&columns),
            "observation must have the shape [1, M + 4], M at most {USERS_MAX}"
        );
        let named = graph.initializer.iter().map(|t| (t.name.as_str(), t));
        let mut walk = Self {
            constants: named.collect(),
            values: HashMap::from([("observation", Folded::observation(columns))]),
        };
        for node in &graph.node {
            walk.visit(node)
                .with_context(|| format!("node {:?} ({})", node.name, node.op_type))?;
        }
        Ok(walk)
    }

    /// Joins the two outputs of the graph to an actor.
    fn actor(mut self, provenance: Provenance) -> anyhow::Result<Actor> {
        let mut output = |name: &str| {
            let found = self.values.remove(name);
            found.with_context(|| format!("the graph has no output {name}"))
        };
        let (displacement, scores) = (output("displacement")?, output("user_scores")?);
        let limited = displacement.limit.zip(displacement.reach);
        let (limit, reach_m) =
            limited.context("displacement must be tanh(..) or a clip, times V_max delta")?;
        ensure!(scores.reach.is_none(), "user_scores must not be scaled");
        ensure!(
            displacement.hidden == scores.hidden
                && displacement.activation == scores.activation
                && displacement.normalizer == scores.normalizer,
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
            shape == [state_len(users), output_len(users)],
            "the network goes from {} to {}, but for {users} users it must go from {} to {}",
            shape[0],
            shape[1],
            state_len(users),
            output_len(users)
        );
        let mut layers = displacement.hidden;
        layers.push(last);
        Ok(Actor {
            provenance,
            normalizer: displacement.normalizer,
            layers,
            functions: Functions {
                activation: displacement.activation.unwrap_or_default(),
                displacement: limit,
                scores: scores.limit,
            },
            reach_m,
        })
    }

    fn visit(&mut self, node: &'g NodeProto) -> anyhow::Result<()> {
        let output = node.output.first().context("it has no output")?;
        if node.op_type == "Constant" {
            let tensor = node.attribute.iter().find_map(|a| a.t.as_ref());
            self.constants
                .insert(output, tensor.context("it has no tensor")?);
            return Ok(());
        }
        let (position, mut value) = self.operand(node)?;
        // The constant operand, of operators that have one.
        let other = 1 - position.min(1);
        let constant = || tensor::floats(self.constant(node, other)?, other);
        match node.op_type.as_str() {
            "Sub" if position == 0 => value.add(&constant()?, -1.0)?,
            "Add" => value.add(&constant()?, 1.0)?,
            "Mul" => value.scale(&constant()?)?,
            "Div" if position == 0 => {
                let inverse: Vec<f32> = constant()?.iter().map(|x| 1.0 / x).collect();
                value.scale(&inverse)?;
            }
            "MatMul" if position == 0 => {
                value.apply(tensor::layer(self.constant(node, 1)?, 1, false)?)?;
            }
            "Gemm" if position == 0 => {
                let attribute = |name: &str| node.attribute.iter().find(|a| a.name == name);
                let plain = |name: &str| attribute(name).is_none_or(|a| a.f == 1.0);
                let transposed = |name: &str| attribute(name).is_some_and(|a| a.i != 0);
                ensure!(
                    plain("alpha") && plain("beta") && !transposed("transA"),
                    "alpha and beta must be 1 and transA 0"
                );
                let weights = self.constant(node, 1)?;
                let mut layer = tensor::layer(weights, 1, transposed("transB"))?;
                if node.input.len() > 2 {
                    let bias = tensor::floats(self.constant(node, 2)?, 2)?;
                    ensure!(bias.len() == layer.outputs, "its bias has the wrong length");
                    layer.bias = bias;
                }
                value.apply(layer)?;
            }
            "Relu" => value.relu()?,
            "Tanh" => value.limit(Limit::Tanh)?,
            "Clip" if position == 0 => {
                let bound = |index| tensor::floats(self.constant(node, index)?, index);
                ensure!(
                    bound(1)? == [-1.0] && bound(2)? == [1.0],
                    "only a clip to [-1, 1] can limit the displacement"
                );
                value.limit(Limit::Clip)?;
            }
            "Slice" => {
                let bound = |index| tensor::integer(self.constant(node, index)?, index);
                let optional = |index: usize, absent| match node.input.len() > index {
                    true => bound(index),
                    false => Ok(absent),
                };
                let (axis, step) = (optional(3, 0)?, optional(4, 1)?);
                ensure!(
                    (axis == 1 || axis == -1) && step == 1,
                    "only columns can be sliced"
                );
                value.slice([bound(1)?, bound(2)?])?;
            }
            other => bail!("{other} is not an operator that a policy is made of"),
        }
        self.values.insert(output, value);
        Ok(())
    }

    /// Returns the index and value of the one input that depends on the observation.
    fn operand(&self, node: &NodeProto) -> anyhow::Result<(usize, Folded)> {
        let inputs = node.input.iter().enumerate();
        let mut operands = inputs.filter_map(|(i, name)| Some((i, self.values.get(&**name)?)));
        let (position, value) = operands
            .next()
            .context("no input depends on the observation")?;
        ensure!(
            operands.next().is_none(),
            "two inputs depend on the observation"
        );
        Ok((position, value.clone()))
    }

    fn constant(&self, node: &NodeProto, index: usize) -> anyhow::Result<&'g TensorProto> {
        let name = node.input.get(index);
        let found = name.and_then(|name| self.constants.get(name.as_str()));
        found
            .copied()
            .with_context(|| format!("input {index} is not a constant"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        actor::Dense,
        learner::Learner,
        onnx::write::write,
        sac::Sac,
        settings::{Algorithm, Preset, TrainingSettings},
    };
    use firmware_core::policy::mlp::{Activation, Mlp};
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;
    use scenario::Scenario;

    /// Returns a policy that is not trained.
    fn actor() -> Actor {
        let scenario = Scenario::shipped("separated").expect("shipped");
        let settings = TrainingSettings::preset(Preset::Paper, Algorithm::Sac, 1);
        let environment = environment::Environment::new(
            scenario.mission.clone(),
            &settings.environment_settings(),
        );
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let sac = Sac::new(&settings, environment.dimensions(), &mut rng);
        Actor::new(sac.deterministic(), &scenario, &settings, 0)
    }

    /// An input may have no scale: it is ignored, and the file's own test does not divide by it.
    #[test]
    fn an_input_without_a_scale_is_written_and_read() {
        let mut ignoring = actor();
        ignoring.normalizer.scale[3] = 0.0;
        // No ReLU hides a NaN.
        let (inputs, outputs) = (ignoring.normalizer.scale.len(), 2 + 15);
        ignoring.layers = vec![Dense {
            inputs,
            outputs,
            weights: vec![0.1; inputs * outputs],
            bias: vec![0.0; outputs],
        }];
        let again = parse(&write(&ignoring)).expect("a policy");
        assert_eq!(again.normalizer, ignoring.normalizer);
    }

    /// The functions of other trainers are written and read, and a file of the microcontroller has them.
    #[test]
    fn the_functions_of_other_trainers_are_kept() {
        let limits = [Limit::Tanh, Limit::Clip];
        for activation in [Activation::Relu, Activation::Tanh] {
            for (displacement, scores) in [
                (limits[0], None),
                (limits[0], Some(limits[0])),
                (limits[1], Some(limits[1])),
            ] {
                let mut other = actor();
                other.functions = Functions {
                    activation,
                    displacement,
                    scores,
                };
                assert_eq!(parse(&write(&other)).expect("a policy"), other);
                let file = other.to_policy_file().expect("small");
                let loaded = Mlp::load(&file[..]).expect("valid");
                assert_eq!(loaded.header().functions, other.functions);
                let observation = other.random_observation(&mut Pcg64Mcg::seed_from_u64(2));
                let expected = other.evaluate(&observation);
                for (got, expected) in loaded.evaluate(&observation).iter().zip(expected) {
                    assert!((f64::from(*got) - expected).abs() < 1e-4);
                }
            }
        }
    }

    /// Returns the error message for a policy file that `spoil` has changed.
    fn refused(spoil: impl Fn(&mut GraphProto)) -> String {
        let bytes = write(&actor());
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
            matrix.dims[0] = 0;
            (matrix.raw_data, matrix.float_data) = (Vec::new(), Vec::new());
        });
        assert!(error.contains("is empty"), "{error}");
    }

    /// Operators beyond the contract are rejected, and the error names the node.
    #[test]
    fn graphs_of_another_shape_are_refused() {
        let rename = |graph: &mut GraphProto, from: &str, to: &str| {
            let mut nodes = graph.node.iter_mut();
            let node = nodes.find(|node| node.op_type == from).expect("a node");
            node.op_type = to.into();
        };
        let error = refused(|graph| rename(graph, "Relu", "Sigmoid"));
        let expected = "(Sigmoid): Sigmoid is not an operator that a policy is made of";
        assert!(error.ends_with(expected), "{error}");
        let error = refused(|graph| rename(graph, "Relu", "Tanh"));
        let expected = "hidden layers have different activations";
        assert!(error.ends_with(expected), "{error}");
        let error = refused(|graph| {
            let scale = graph.node[1].clone();
            let relu = graph.node.iter_mut().find(|node| node.op_type == "Relu");
            let relu = relu.expect("a node");
            relu.op_type = scale.op_type;
            relu.input.push(scale.input[1].clone());
        });
        let expected = "only observations and outputs can be scaled";
        assert!(error.ends_with(expected), "{error}");
    }
}
