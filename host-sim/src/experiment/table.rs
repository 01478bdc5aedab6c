//! CSV files in and out, whole or not at all.

use std::{fmt::Display, fs, path::Path};

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

/// Writes beside the file first: whoever looks finds the old file or the new one. Two writers of
/// one file do not disturb each other.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), String> {
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let thread = rayon::current_thread_index().unwrap_or(usize::MAX);
    let draft = folder.join(format!(".{name}.{}.{thread}", std::process::id()));
    let written = fs::write(&draft, bytes).and_then(|()| fs::rename(&draft, path));
    written.map_err(|error| named(path, error))
}
