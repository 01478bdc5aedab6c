//! CSV files in and out, whole or not at all.

use std::{fmt::Display, path::Path};

use serde::{Serialize, de::DeserializeOwned};

/// The problem with the file in front.
pub(crate) fn named(path: &Path, problem: impl Display) -> String {
    format!("{}: {problem}", path.display())
}

/// All rows of a file.
///
/// # Errors
/// A file that cannot be read, has other columns or no rows, in one line.
pub fn read<Row: DeserializeOwned>(path: &Path) -> Result<Vec<Row>, String> {
    let mut reader = csv::Reader::from_path(path).map_err(|error| named(path, error))?;
    let rows: Result<Vec<Row>, _> = reader.deserialize().collect();
    let rows = rows.map_err(|error| named(path, error))?;
    if rows.is_empty() {
        return Err(named(path, "has no rows: measure it anew"));
    }
    Ok(rows)
}

/// Writes all rows.
///
/// # Errors
/// A file that cannot be written, in one line.
pub fn write<Row: Serialize>(path: &Path, rows: &[Row]) -> Result<(), String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row).map_err(|error| named(path, error))?;
    }
    let bytes = writer.into_inner().map_err(|error| named(path, error))?;
    write_bytes(path, &bytes)
}

/// Writes a text.
///
/// # Errors
/// A file that cannot be written, in one line.
pub fn write_text(path: &Path, text: &str) -> Result<(), String> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), String> {
    files::output::write(path, bytes).map_err(|error| named(path, error))
}
