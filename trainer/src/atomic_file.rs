//! Files that are replaced as a whole.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

/// Writes a file such that a reader, also after a crash, sees either the previous content or the new
/// one.
///
/// # Errors
/// Returns the file system's error.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".partial");
    let partial: PathBuf = path.with_file_name(name);
    let mut file = File::create(&partial)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&partial, path)?;
    if let Some(directory) = path.parent().filter(|d| !d.as_os_str().is_empty()) {
        // The rename has to reach the disk as well; not every file system supports this.
        let _ = File::open(directory).and_then(|directory| directory.sync_all());
    }
    Ok(())
}
