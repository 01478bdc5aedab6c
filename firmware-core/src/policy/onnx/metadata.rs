// SPDX-License-Identifier: MIT OR Apache-2.0
//! The entries of `metadata_props`.

use std::{
    collections::HashMap,
    format,
    string::{String, ToString},
    sync::Arc,
    vec::Vec as StdVec,
};

use tract_onnx::prelude::*;

use super::error::OnnxError;

/// The entries of `metadata_props`.
pub(super) struct Metadata(HashMap<String, String>);

impl Metadata {
    pub(super) fn of_model(model: &InferenceModel) -> Self {
        let entry = |(key, value): (&String, &Arc<Tensor>)| {
            let key = key.strip_prefix("onnx.metadata_props.")?;
            let view = value.try_as_plain_ram().ok()?;
            Some((key.to_string(), view.to_scalar::<String>().ok()?.clone()))
        };
        Self(model.properties.iter().filter_map(entry).collect())
    }

    /// Checks that every required entry is there.
    pub(super) fn require(&self, keys: &[&str]) -> Result<(), OnnxError> {
        let missing = keys.iter().filter(|&&key| !self.0.contains_key(key));
        let missing: StdVec<&str> = missing.copied().collect();
        if missing.is_empty() {
            return Ok(());
        }
        let keys = missing.join(", ");
        Err(OnnxError::Missing { keys })
    }

    /// Returns the version of the contract that the file follows.
    pub(super) fn version(&self) -> Option<u32> {
        self.number("format_version").ok()
    }

    /// Checks the version of the contract.
    pub(super) fn check_version(&self, expected: u32) -> Result<(), OnnxError> {
        let version: u32 = self.number("format_version")?;
        if version == expected {
            return Ok(());
        }
        Err(self.wrong("format_version", expected.to_string()))
    }

    fn text(&self, key: &'static str) -> Result<&str, OnnxError> {
        let found = self.0.get(key).map(String::as_str);
        found.ok_or_else(|| OnnxError::Missing { keys: key.into() })
    }

    pub(super) fn wrong(&self, key: &'static str, expected: impl Into<String>) -> OnnxError {
        OnnxError::Metadata {
            key,
            value: self.0.get(key).cloned().unwrap_or_default(),
            expected: expected.into(),
        }
    }

    pub(super) fn number<N: core::str::FromStr>(&self, key: &'static str) -> Result<N, OnnxError> {
        let parsed = self.text(key)?.trim().parse().ok();
        parsed.ok_or_else(|| self.wrong(key, "a number"))
    }

    pub(super) fn list(&self, key: &'static str, len: usize) -> Result<StdVec<f32>, OnnxError> {
        let numbers = self.text(key)?.split(',').map(|x| x.trim().parse().ok());
        let numbers: Option<StdVec<f32>> = numbers.collect();
        let right = numbers.filter(|n| n.len() == len && n.iter().all(|x| x.is_finite()));
        right.ok_or_else(|| self.wrong(key, format!("{len} numbers with commas between")))
    }

    pub(super) fn bounded<const N: usize>(
        &self,
        key: &'static str,
    ) -> Result<heapless::String<N>, OnnxError> {
        let fits = heapless::String::try_from(self.text(key)?);
        fits.map_err(|_| self.wrong(key, format!("at most {N} bytes")))
    }

    /// Returns the numbers of 1 to `most` rows.
    pub(super) fn rows(
        &self,
        key: &'static str,
        columns: usize,
        most: usize,
    ) -> Result<StdVec<f32>, OnnxError> {
        let count = self.text(key)?.split(',').count();
        if count % columns != 0 || count > most * columns {
            let expected = format!("1 to {most} times {columns} numbers with commas between");
            return Err(self.wrong(key, expected));
        }
        self.list(key, count)
    }

    /// Checks the names of columns.
    pub(super) fn check_names(&self, key: &'static str, names: &[&str]) -> Result<(), OnnxError> {
        match self.text(key)?.split(',').eq(names.iter().copied()) {
            true => Ok(()),
            false => Err(self.wrong(key, names.join(","))),
        }
    }
}
