//! One figure of a benchmark's table, how numbers are printed, and the lines that a benchmark image
//! prints.

use std::{collections::BTreeMap, path::Path};

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use crate::qemu;

/// One figure of the table.
#[derive(Debug, Default)]
pub(crate) struct Figure {
    pub(crate) name: &'static str,
    pub(crate) unit: &'static str,
    pub(crate) value: u64,
    /// The mean over all slots, if there are any.
    pub(crate) mean: Option<u64>,
    pub(crate) aim: Option<u64>,
    /// The largest value with which the benchmark succeeds.
    pub(crate) limit: Option<u64>,
}

/// Returns the lines that a bench prints, by the names of their parts.
pub(crate) fn printed(root: &Path, image: &Path) -> Result<BTreeMap<String, Value>> {
    let output = qemu::run_to_end(root, image)?;
    let said = String::from_utf8(output.stdout)?;
    ensure!(
        output.status.success(),
        "the bench ended with {}: {said}",
        output.status
    );
    let mut lines = BTreeMap::new();
    for line in said.lines() {
        let line: Value = serde_json::from_str(line).with_context(|| line.to_owned())?;
        let name = line["part"]
            .as_str()
            .context("the bench printed a line without a part")?;
        lines.insert(name.to_owned(), line);
    }
    Ok(lines)
}

/// Formats 12345678 as 12,345,678.
pub(crate) fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut grouped = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped
}
