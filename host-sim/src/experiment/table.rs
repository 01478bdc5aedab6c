//! Reads and writes CSV files. A file is either written completely or not at all.

use std::path::Path;

use files::named;
use serde::{Serialize, de::DeserializeOwned};

/// Returns all rows of a file.
///
/// # Errors
/// Returns a message of one line if the file cannot be read or has other columns or no rows.
pub fn read<Row: DeserializeOwned>(path: &Path) -> Result<Vec<Row>, String> {
    let mut reader = csv::Reader::from_path(path).map_err(|error| named(path, error))?;
    let rows: Result<Vec<Row>, _> = reader.deserialize().collect();
    let rows = rows.map_err(|error| named(path, error))?;
    if rows.is_empty() {
        return Err(named(path, "has no rows: measure it again"));
    }
    Ok(rows)
}

/// Writes all rows.
///
/// # Errors
/// Returns a message of one line if the file cannot be written.
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
/// Returns a message of one line if the file cannot be written.
pub fn write_text(path: &Path, text: &str) -> Result<(), String> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), String> {
    files::output::write(path, bytes).map_err(|error| named(path, error))
}
