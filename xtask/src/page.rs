//! Documents with parts that commands write.

use std::{fs, path::Path};

use anyhow::{Context, Result};

/// Replaces what a document has between two marks.
pub(crate) fn replace(path: &Path, [begin, end]: [&str; 2], text: &str) -> Result<()> {
    let page = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let place = || {
        let (before, rest) = page.split_once(begin)?;
        let (_, after) = rest.split_once(end)?;
        Some((before, after))
    };
    let (before, after) =
        place().with_context(|| format!("{}: no {begin} and {end}", path.display()))?;
    let page = format!("{before}{begin}\n{text}\n{end}{after}");
    fs::write(path, page).with_context(|| path.display().to_string())
}
