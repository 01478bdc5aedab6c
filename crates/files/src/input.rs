//! Reads input files up to a limit, so that a device without an end cannot exhaust the memory.

use std::{
    fs::File,
    io::{self, Read},
    path::Path,
};

/// The longest file that is read, bytes. A policy has about 100 kB, a scenario a few.
pub const LONGEST_BYTES: u64 = 64 << 20;

/// Returns the content of a file.
///
/// # Errors
/// Returns an error if the file cannot be read or is longer than [`LONGEST_BYTES`].
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut content = Vec::new();
    let mut file = File::open(path)?.take(LONGEST_BYTES + 1);
    file.read_to_end(&mut content)?;
    if content.len() as u64 > LONGEST_BYTES {
        let problem = format!("longer than {} MiB", LONGEST_BYTES >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, problem));
    }
    Ok(content)
}

/// Returns the content of a text file.
///
/// # Errors
/// Returns the errors of [`read`], or an error if the content is not valid UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    String::from_utf8(read(path)?).map_err(|error| {
        io::Error::new(
            io::ErrorKind::InvalidData,
            format!("no UTF-8 text: {}", error.utf8_error()),
        )
    })
}
