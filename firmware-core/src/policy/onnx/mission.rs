// SPDX-License-Identifier: MIT OR Apache-2.0
//! A policy for one mission: format version 1.

use std::{
    sync::Arc,
    vec, // for tract's `tvec!`
    vec::Vec as StdVec,
};

use heapless::Vec;
use tract_onnx::prelude::*;

use super::{error::OnnxError, metadata::Metadata, model::Model};
use crate::mission::MissionChange;
use crate::policy::{
    Action, MeasuredGains, Observation, PlanQuality, Policy, Provenance, REQUIRED_METADATA,
    mlp::SELF_TEST_TOLERANCE, state_len,
};
use crate::scalar::{Displacement, Scalar};

/// The version of the contract that is read here.
const FORMAT_VERSION: u32 = 1;

/// A network for one mission that was loaded, optimised and checked.
///
/// In flight the input is written in place; an output that is not finite goes on to the shield, which
/// replaces and reports it, and a displacement is cut at `V_max delta` per axis.
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
        Self::of_model(Model::read(file)?)
    }

    pub(super) fn of_model(model: Model) -> Result<Self, OnnxError> {
        let metadata = &model.metadata;
        metadata.require(&REQUIRED_METADATA)?;
        metadata.check_version(FORMAT_VERSION)?;
        let provenance = provenance(metadata)?;
        let users = provenance.users as usize;
        let inputs = state_len(users);
        let (state, metadata) = model.prepare(
            &[("observation", &[1, inputs])],
            &[("displacement", &[1, 2]), ("user_scores", &[1, users])],
        )?;
        let mut policy = Self {
            state,
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

fn provenance(metadata: &Metadata) -> Result<Provenance, OnnxError> {
    let area = metadata.list("area_m", 2)?;
    let users: u32 = metadata.number("users")?;
    if users == 0 || users as usize > crate::policy::mlp::WIDTH_MAX {
        return Err(metadata.wrong("users", "a number from 1 to 256"));
    }
    Ok(Provenance {
        users,
        max_speed_mps: metadata.number("max_speed_mps")?,
        slot_duration_s: metadata.number("slot_duration_s")?,
        area_m: [area[0], area[1]],
        algorithm: metadata.bounded("algorithm")?,
        scenario: metadata.bounded("scenario")?,
        scenario_digest: metadata.bounded("scenario_digest")?,
        episodes: metadata.number("episodes")?,
        seed: metadata.number("seed")?,
    })
}
