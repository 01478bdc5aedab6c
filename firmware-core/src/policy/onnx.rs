// SPDX-License-Identifier: MIT OR Apache-2.0
//! Trained policies as ONNX files, run by tract (feature `onnx`, needs std).
//!
//! The contract (`docs/training.md`): input `observation` f32\[1, M + 4\] in raw units, outputs
//! `displacement` f32\[1, 2\] in metres and `user_scores` f32\[1, M\], normalizer and scaling in
//! the graph; `metadata_props` with what it was trained for and a test vector. [`OnnxPolicy`]
//! checks all of it when it loads, also for files from other programs.
//!
//! In flight the input is written in place; an output that is not finite goes on to the shield,
//! which replaces and reports it, and a displacement is cut at `V_max delta` per axis.

use std::{
    collections::HashMap,
    format,
    string::{String, ToString},
    sync::Arc,
    vec, // for tract's `tvec!`
    vec::Vec as StdVec,
};

use heapless::Vec;
use tract_onnx::prelude::*;

use super::{
    Action, MeasuredGains, Observation, PlanQuality, Policy, Provenance, REQUIRED_METADATA,
    mlp::SELF_TEST_TOLERANCE, state_len,
};
use crate::mission::MissionChange;
use crate::scalar::{Displacement, Scalar};

/// The version of the contract that this crate reads.
pub const FORMAT_VERSION: u32 = 1;

/// Error returned when a file is not a valid policy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OnnxError {
    /// tract cannot read or run the network.
    #[error("not a network that can be run: {reason}")]
    Network {
        /// tract's message, in one line.
        reason: String,
    },
    /// Metadata entries are missing.
    #[error("metadata_props has no {keys}")]
    Missing {
        /// The keys of all missing entries, with commas between.
        keys: String,
    },
    /// A metadata entry has an invalid value.
    #[error("metadata_props {key} is {value:?}, but must be {expected}")]
    Metadata {
        /// The key of the entry.
        key: &'static str,
        /// The invalid value.
        value: String,
        /// The valid values.
        expected: String,
    },
    /// An input or output has another name or shape.
    #[error("{what} is {got}, but must be {expected}")]
    Signature {
        /// The name of the input or output.
        what: &'static str,
        /// What the file has.
        got: String,
        /// The required signature.
        expected: String,
    },
    /// The network does not reproduce its test vector.
    #[error("self-test: output {index} is {got}, but the file expects {expected}")]
    SelfTest {
        /// The index of the output: 0 and 1 the displacement, then the scores.
        index: usize,
        /// The computed value.
        got: f32,
        /// The expected value.
        expected: f32,
    },
}

impl OnnxError {
    fn network(error: impl Into<TractError>) -> Self {
        let reason = format!("{:#}", error.into());
        Self::Network {
            reason: reason.replace('\n', " "),
        }
    }
}

/// A network that was loaded, optimised and checked.
#[derive(Debug)]
pub struct OnnxPolicy {
    state: TypedSimpleState,
    /// Written in place: the state returns it after every run.
    input: Arc<Tensor>,
    provenance: Provenance,
}

impl OnnxPolicy {
    /// Loads a policy from a file's bytes.
    ///
    /// # Errors
    /// Returns what is wrong with the file.
    pub fn load(file: &[u8]) -> Result<Self, OnnxError> {
        let mut reader = file;
        let model = tract_onnx::onnx()
            .model_for_read(&mut reader)
            .map_err(OnnxError::network)?;
        let metadata = Metadata::of_model(&model);
        metadata.check_keys()?;
        let version: u32 = metadata.number("format_version")?;
        if version != FORMAT_VERSION {
            return Err(OnnxError::Metadata {
                key: "format_version",
                value: version.to_string(),
                expected: format!("{FORMAT_VERSION}"),
            });
        }
        let provenance = metadata.provenance()?;
        let users = provenance.users as usize;
        let inputs = state_len(users);
        check_names(&model)?;
        let model = model
            .with_input_fact(0, f32::fact([1, inputs]).into())
            .and_then(|model| model.into_optimized())
            .map_err(OnnxError::network)?;
        for (index, (what, columns)) in [("displacement", 2), ("user_scores", users)]
            .into_iter()
            .enumerate()
        {
            let fact = model.output_fact(index).map_err(OnnxError::network)?;
            if fact.datum_type != f32::datum_type()
                || fact.shape.as_concrete() != Some(&[1, columns])
            {
                return Err(OnnxError::Signature {
                    what,
                    got: format!("{fact:?}"),
                    expected: format!("f32[1, {columns}]"),
                });
            }
        }
        let plan = model.into_runnable().map_err(OnnxError::network)?;
        let mut policy = Self {
            state: plan.spawn().map_err(OnnxError::network)?,
            input: Tensor::zero::<f32>(&[1, inputs])
                .map_err(OnnxError::network)?
                .into(),
            provenance,
        };
        policy.self_test(&metadata)?;
        Ok(policy)
    }

    /// Returns the origin of the policy.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// Returns displacement (metres) and scores for a raw observation; missing numbers count as 0.
    ///
    /// # Errors
    /// Returns tract's error; none is known for a network that was loaded.
    pub fn evaluate(&mut self, observation: &[f32]) -> Result<StdVec<f32>, OnnxError> {
        let outputs = self
            .run(observation.iter().copied())
            .map_err(OnnxError::network)?;
        let mut numbers = StdVec::with_capacity(2 + self.provenance.users as usize);
        for output in &outputs {
            let view = output.try_as_plain_ram().map_err(OnnxError::network)?;
            numbers.extend_from_slice(view.as_slice::<f32>().map_err(OnnxError::network)?);
        }
        Ok(numbers)
    }

    fn run(&mut self, observation: impl Iterator<Item = f32>) -> TractResult<TVec<TValue>> {
        let input = Arc::make_mut(&mut self.input);
        let mut view = input.try_as_plain_ram_mut()?;
        for (slot, x) in view
            .as_slice_mut::<f32>()?
            .iter_mut()
            .zip(observation.chain(core::iter::repeat(0.0)))
        {
            *slot = x;
        }
        self.state
            .run(tvec!(TValue::from_const(Arc::clone(&self.input))))
    }

    /// Returns `V_max delta`, metres.
    fn reach_m(&self) -> f32 {
        self.provenance.max_speed_mps * self.provenance.slot_duration_s
    }

    fn self_test(&mut self, metadata: &Metadata) -> Result<(), OnnxError> {
        let inputs = state_len(self.provenance.users as usize);
        let observation = metadata.list("test_observation", inputs)?;
        let mut expected = metadata.list("test_displacement", 2)?;
        let scores = metadata.list("test_user_scores", inputs - 4)?;
        let score_scale = scores.iter().fold(1.0_f32, |a, b| a.max(b.abs()));
        expected.extend(scores);
        let outputs = self.evaluate(&observation)?;
        for (index, (&got, expected)) in outputs.iter().zip(expected).enumerate() {
            let scale = if index < 2 {
                self.reach_m()
            } else {
                score_scale
            };
            // Written so that a NaN fails.
            let close = (got - expected).abs() <= SELF_TEST_TOLERANCE * scale;
            if !close {
                return Err(OnnxError::SelfTest {
                    index,
                    got,
                    expected,
                });
            }
        }
        Ok(())
    }
}

impl<T: Scalar, const M: usize> Policy<T, M> for OnnxPolicy {
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        let mut state = [T::zero(); 4 + crate::policy::mlp::WIDTH_MAX];
        let observation = observation.of_first_users(self.provenance().users as usize);
        let len = observation.write_state(&mut state).min(state.len());
        let reach = self.reach_m();
        let outputs = self.run(state[..len].iter().map(|x| x.to_f64() as f32));
        let mut action = Action {
            // Unless it is overwritten below, the shield receives an invalid output.
            displacement: Displacement::repeat(T::of(f64::NAN)),
            user_scores: Vec::new(),
        };
        let Ok(outputs) = outputs else {
            return action;
        };
        let floats = |index: usize| {
            let view = outputs.get(index)?.try_as_plain_ram().ok()?;
            view.as_slice::<f32>().ok()
        };
        if let (Some(&[x, y]), Some(scores)) = (floats(0), floats(1)) {
            // NaN stays NaN under clamp.
            let component = |x: f32| T::of(x.clamp(-reach, reach).into());
            action.displacement = Displacement::new(component(x), component(y));
            let scores = scores.iter().take(M);
            action.user_scores = scores.map(|&score| T::of(score.into())).collect();
        }
        action
    }

    /// A trained policy cannot use a change.
    fn revise(&mut self, _: &MissionChange<T>, _: u32) {}

    fn note_gains(&mut self, _: &MeasuredGains<'_, T>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<PlanQuality> {
        None
    }
}

/// Checks the names of input and outputs, in order.
fn check_names(model: &InferenceModel) -> Result<(), OnnxError> {
    let names = |outlets: &[OutletId]| -> String {
        let name = |outlet: &OutletId| match model.outlet_label(*outlet) {
            Some(label) => label,
            None => model.node(outlet.node).name.as_str(),
        };
        outlets.iter().map(name).collect::<StdVec<_>>().join(", ")
    };
    let check = |what, got: String, expected: &str| {
        if got == expected {
            return Ok(());
        }
        let expected = expected.to_string();
        Err(OnnxError::Signature {
            what,
            got,
            expected,
        })
    };
    let inputs = names(model.input_outlets().map_err(OnnxError::network)?);
    check("the input", inputs, "observation")?;
    let outputs = names(model.output_outlets().map_err(OnnxError::network)?);
    check("the list of outputs", outputs, "displacement, user_scores")
}

/// The entries of `metadata_props`.
struct Metadata(HashMap<String, String>);

impl Metadata {
    fn of_model(model: &InferenceModel) -> Self {
        let entry = |(key, value): (&String, &Arc<Tensor>)| {
            let key = key.strip_prefix("onnx.metadata_props.")?;
            let view = value.try_as_plain_ram().ok()?;
            Some((key.to_string(), view.to_scalar::<String>().ok()?.clone()))
        };
        Self(model.properties.iter().filter_map(entry).collect())
    }

    /// Checks that every required entry is there.
    fn check_keys(&self) -> Result<(), OnnxError> {
        let missing = REQUIRED_METADATA
            .into_iter()
            .filter(|&key| !self.0.contains_key(key));
        let missing: StdVec<&str> = missing.collect();
        if missing.is_empty() {
            return Ok(());
        }
        let keys = missing.join(", ");
        Err(OnnxError::Missing { keys })
    }

    fn text(&self, key: &'static str) -> Result<&str, OnnxError> {
        let found = self.0.get(key).map(String::as_str);
        found.ok_or_else(|| OnnxError::Missing { keys: key.into() })
    }

    fn wrong(&self, key: &'static str, expected: impl Into<String>) -> OnnxError {
        OnnxError::Metadata {
            key,
            value: self.0.get(key).cloned().unwrap_or_default(),
            expected: expected.into(),
        }
    }

    fn number<N: core::str::FromStr>(&self, key: &'static str) -> Result<N, OnnxError> {
        let parsed = self.text(key)?.trim().parse().ok();
        parsed.ok_or_else(|| self.wrong(key, "a number"))
    }

    fn list(&self, key: &'static str, len: usize) -> Result<StdVec<f32>, OnnxError> {
        let numbers = self.text(key)?.split(',').map(|x| x.trim().parse().ok());
        let numbers: Option<StdVec<f32>> = numbers.collect();
        let right = numbers.filter(|n| n.len() == len && n.iter().all(|x| x.is_finite()));
        right.ok_or_else(|| self.wrong(key, format!("{len} numbers with commas between")))
    }

    fn bounded<const N: usize>(&self, key: &'static str) -> Result<heapless::String<N>, OnnxError> {
        let fits = heapless::String::try_from(self.text(key)?);
        fits.map_err(|_| self.wrong(key, format!("at most {N} bytes")))
    }

    fn provenance(&self) -> Result<Provenance, OnnxError> {
        let area = self.list("area_m", 2)?;
        let users: u32 = self.number("users")?;
        if users == 0 || users as usize > crate::policy::mlp::WIDTH_MAX {
            return Err(self.wrong("users", "a number from 1 to 256"));
        }
        Ok(Provenance {
            users,
            max_speed_mps: self.number("max_speed_mps")?,
            slot_duration_s: self.number("slot_duration_s")?,
            area_m: [area[0], area[1]],
            algorithm: self.bounded("algorithm")?,
            scenario: self.bounded("scenario")?,
            scenario_digest: self.bounded("scenario_digest")?,
            episodes: self.number("episodes")?,
            seed: self.number("seed")?,
        })
    }
}
