//! The `metadata_props` of a policy file: provenance and test vector.

use std::{collections::HashMap, str::FromStr};

use anyhow::{Context, anyhow, ensure};
use firmware_core::policy::{Provenance, REQUIRED_METADATA, mlp::SELF_TEST_TOLERANCE};

use super::{contract::FORMAT_VERSION, proto::ModelProto};
use crate::actor::Actor;

/// The entries of `metadata_props` by key.
pub(super) struct Metadata<'m>(HashMap<&'m str, &'m str>);

impl<'m> Metadata<'m> {
    /// Collects the entries of a model and checks the version of the contract.
    pub(super) fn of_model(model: &'m ModelProto) -> anyhow::Result<Self> {
        let entries = model.metadata_props.iter();
        let metadata = Self(
            entries
                .map(|e| (e.key.as_str(), e.value.as_str()))
                .collect(),
        );
        let missing = REQUIRED_METADATA
            .into_iter()
            .filter(|key| !metadata.0.contains_key(key));
        let missing: Vec<&str> = missing.collect();
        ensure!(
            missing.is_empty(),
            "metadata_props has no {}",
            missing.join(", ")
        );
        let version: u32 = metadata.number("format_version")?;
        ensure!(
            version == FORMAT_VERSION,
            "format_version is {version}, but this build reads {FORMAT_VERSION}"
        );
        Ok(metadata)
    }

    /// Returns what the policy was trained for.
    pub(super) fn provenance(&self) -> anyhow::Result<Provenance> {
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

    /// Evaluates the actor on the file's test vector and compares the outputs.
    pub(super) fn check_test_vector(&self, actor: &Actor) -> anyhow::Result<()> {
        let observation = self.list("test_observation")?;
        let displacement = self.list("test_displacement")?;
        let scores = self.list("test_user_scores")?;
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
        Ok(())
    }

    fn text(&self, key: &str) -> anyhow::Result<&'m str> {
        let found = self.0.get(key).copied();
        found.ok_or_else(|| anyhow!("metadata_props has no {key}"))
    }

    fn number<N: FromStr>(&self, key: &str) -> anyhow::Result<N> {
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

    fn bounded<const N: usize>(&self, key: &str) -> anyhow::Result<heapless::String<N>> {
        let text = self.text(key)?;
        let fits = heapless::String::try_from(text);
        fits.map_err(|_| anyhow!("metadata_props {key} is longer than {N} bytes"))
    }
}
