//! The `metadata_props` of a policy file: provenance and test vector.

use std::{collections::HashMap, str::FromStr};

use anyhow::{Context, anyhow, ensure};
use firmware_core::policy::{Provenance, REQUIRED_METADATA, mlp::SELF_TEST_TOLERANCE};

use super::{contract::FORMAT_VERSION, proto::ModelProto};
use crate::actor::Actor;

/// The entries of `metadata_props` by key.
pub(super) struct Entries<'m>(HashMap<&'m str, &'m str>);

impl<'m> Entries<'m> {
    /// Collects the entries of a model.
    pub(super) fn of_model(model: &'m ModelProto) -> Self {
        let entries = model.metadata_props.iter();
        Self(
            entries
                .map(|e| (e.key.as_str(), e.value.as_str()))
                .collect(),
        )
    }

    /// Checks that all entries are there.
    pub(super) fn require(&self, keys: &[&str]) -> anyhow::Result<()> {
        let missing = keys.iter().filter(|&key| !self.0.contains_key(key));
        let missing: Vec<&str> = missing.copied().collect();
        ensure!(
            missing.is_empty(),
            "metadata_props has no {}",
            missing.join(", ")
        );
        Ok(())
    }

    fn text(&self, key: &str) -> anyhow::Result<&'m str> {
        let found = self.0.get(key).copied();
        found.ok_or_else(|| anyhow!("metadata_props has no {key}"))
    }

    pub(super) fn number<N: FromStr>(&self, key: &str) -> anyhow::Result<N> {
        let text = self.text(key)?;
        let parsed = text.trim().parse().ok();
        parsed.ok_or_else(|| anyhow!("metadata_props {key} is {text:?}, but must be a number"))
    }

    pub(super) fn list(&self, key: &str) -> anyhow::Result<Vec<f32>> {
        let text = self.text(key)?;
        let numbers = text.split(',').map(|x| x.trim().parse::<f32>().ok());
        let numbers: Option<Vec<f32>> = numbers.collect();
        numbers.ok_or_else(|| anyhow!("metadata_props {key} must be numbers with commas between"))
    }

    pub(super) fn bounded<const N: usize>(&self, key: &str) -> anyhow::Result<heapless::String<N>> {
        let text = self.text(key)?;
        let fits = heapless::String::try_from(text);
        fits.map_err(|_| anyhow!("metadata_props {key} is longer than {N} bytes"))
    }
}

/// The metadata of a policy for one mission.
pub(super) struct Metadata<'m>(Entries<'m>);

impl<'m> Metadata<'m> {
    /// Collects the entries of a model and checks the version of the contract.
    pub(super) fn of_model(model: &'m ModelProto) -> anyhow::Result<Self> {
        let entries = Entries::of_model(model);
        entries.require(&REQUIRED_METADATA)?;
        let version: u32 = entries.number("format_version")?;
        ensure!(
            version == FORMAT_VERSION,
            "format_version is {version}, but this build reads {FORMAT_VERSION}"
        );
        Ok(Self(entries))
    }

    /// Returns what the policy was trained for.
    pub(super) fn provenance(&self) -> anyhow::Result<Provenance> {
        let area = self.0.list("area_m")?;
        let area_m = area[..]
            .try_into()
            .context("metadata_props area_m must be two numbers")?;
        Ok(Provenance {
            users: self.0.number("users")?,
            max_speed_mps: self.0.number("max_speed_mps")?,
            slot_duration_s: self.0.number("slot_duration_s")?,
            area_m,
            algorithm: self.0.bounded("algorithm")?,
            scenario: self.0.bounded("scenario")?,
            scenario_digest: self.0.bounded("scenario_digest")?,
            episodes: self.0.number("episodes")?,
            seed: self.0.number("seed")?,
        })
    }

    /// Evaluates the actor on the file's test vector and compares the outputs.
    pub(super) fn check_test_vector(&self, actor: &Actor) -> anyhow::Result<()> {
        let observation = self.0.list("test_observation")?;
        let displacement = self.0.list("test_displacement")?;
        let scores = self.0.list("test_user_scores")?;
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
}
