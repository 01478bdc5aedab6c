//! Input files, read with a limit: a device that never ends must not take all memory.

use std::{
    fs::File,
    io::{self, Read},
    path::Path,
};

/// The longest file that is read, bytes. A policy has some 100 kB, a scenario a few.
pub const LONGEST_BYTES: u64 = 64 << 20;

/// The content of a file.
///
/// # Errors
/// It cannot be read, or is longer than [`LONGEST_BYTES`].
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

/// As [`read`], for text.
///
/// # Errors
/// As there, or it is no UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    String::from_utf8(read(path)?).map_err(|error| {
        io::Error::new(
            io::ErrorKind::InvalidData,
            format!("no UTF-8 text: {}", error.utf8_error()),
        )
    })
}
