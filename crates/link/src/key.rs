//! Reads key files: for MAVLink 2 signing 64 hexadecimal digits or 32 raw bytes, for the ground link
//! 64 hexadecimal digits.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

use firmware_core::{
    autopilot::wire::signing::SigningKey,
    link::{Credentials, GroundKey},
};
use zeroize::Zeroizing;

/// Error returned when a key file cannot be used. No message contains the key itself.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("key file {path}: {error}")]
    Read {
        /// The path of the file.
        path: String,
        /// The reason.
        error: std::io::Error,
    },
    /// Others than the owner can read or change the file.
    #[error(
        "key file {path}: mode {mode:03o} gives others access; it must be 600 or 400 (chmod 600)"
    )]
    Permissions {
        /// The path of the file.
        path: String,
        /// The permission bits of the file.
        mode: u32,
    },
    /// The content is not a key of the ground link.
    #[error("key file {path}: it must hold 64 hexadecimal digits and nothing else")]
    NotHexadecimal {
        /// The path of the file.
        path: String,
    },
    /// The operating system has no random numbers.
    #[error("no random numbers: {0}")]
    Random(getrandom::Error),
    /// The content is not a key.
    #[error("key file {path}: {length} bytes; it must hold 64 hexadecimal digits or 32 bytes")]
    Format {
        /// The path of the file.
        path: String,
        /// The length of the content. At most 67 bytes are read.
        length: usize,
    },
}

/// Reads a key for MAVLink 2 signing.
///
/// # Errors
/// Returns an error if the file cannot be read, is accessible to others, or does not contain a key.
pub fn read(path: &Path) -> Result<SigningKey, KeyError> {
    let content = content(path)?;
    parse(content.bytes()).ok_or_else(|| KeyError::Format {
        path: path.display().to_string(),
        length: content.length,
    })
}

/// Reads a key of the ground link.
///
/// # Errors
/// Returns an error if the file cannot be read, is accessible to others, or does not contain 64
/// hexadecimal digits.
pub fn read_ground(path: &Path) -> Result<GroundKey, KeyError> {
    let digits = hexadecimal(content(path)?.bytes());
    let key = digits.map(GroundKey::new);
    key.ok_or_else(|| KeyError::NotHexadecimal {
        path: path.display().to_string(),
    })
}

/// Returns the credentials of an end that starts now: its nonces begin with random bytes of the
/// operating system.
///
/// # Errors
/// Returns an error if the operating system has no random numbers.
pub fn credentials(key: &GroundKey) -> Result<Credentials, KeyError> {
    let mut start = [0; 12];
    getrandom::fill(&mut start).map_err(KeyError::Random)?;
    let key = key.clone();
    Ok(Credentials { key, start })
}

/// The beginning of a key file: enough to see that it is too long. It is erased when it is dropped,
/// and nothing of it is copied.
struct Content {
    bytes: Zeroizing<[u8; 67]>,
    length: usize,
}

impl Content {
    fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// Reads the beginning of a file that only its owner can read and change.
fn content(path: &Path) -> Result<Content, KeyError> {
    let failed = |error| KeyError::Read {
        path: path.display().to_string(),
        error,
    };
    let mut file = File::open(path).map_err(failed)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The permissions are read from the open file, because its path may name another file by
        // now.
        let mode = file.metadata().map_err(failed)?.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(KeyError::Permissions {
                path: path.display().to_string(),
                mode,
            });
        }
    }
    let mut content = Content {
        bytes: Zeroizing::new([0; 67]),
        length: 0,
    };
    loop {
        match file.read(&mut content.bytes[content.length..]) {
            Ok(0) => return Ok(content),
            Ok(read) => content.length += read,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(failed(error)),
        }
    }
}

fn parse(bytes: &[u8]) -> Option<SigningKey> {
    if let Ok(raw) = bytes.try_into() {
        return Some(SigningKey::new(raw));
    }
    hexadecimal(bytes).map(SigningKey::new)
}

/// Reads 64 hexadecimal digits, after which there may be white space.
fn hexadecimal(bytes: &[u8]) -> Option<[u8; 32]> {
    let digits = bytes.trim_ascii_end();
    if digits.len() != 64 {
        return None;
    }
    let digit = |b: u8| char::from(b).to_digit(16);
    let mut key = [0; 32];
    for (byte, pair) in key.iter_mut().zip(digits.chunks_exact(2)) {
        *byte = (digit(pair[0])? * 16 + digit(pair[1])?) as u8;
    }
    Some(key)
}

#[cfg(all(test, unix))]
mod tests {
    use std::io::Write;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn file(content: &[u8], mode: u32) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(content).unwrap();
        let permissions = std::fs::Permissions::from_mode(mode);
        file.as_file().set_permissions(permissions).unwrap();
        file
    }

    #[test]
    fn keys_are_read_from_private_files_only_and_never_shown() {
        let hex = [b"0f".repeat(32), b"\n".to_vec()].concat();
        for content in [&hex[..], &[15; 32]] {
            let key = read(file(content, 0o600).path()).unwrap();
            assert_eq!(format!("{key:?}"), "SigningKey(..)");
        }
        let error = read(file(&hex, 0o644).path()).unwrap_err().to_string();
        assert!(
            error.contains("mode 644") && error.contains("chmod 600"),
            "{error}"
        );
        for content in [&b"secret"[..], &[b'z'; 64], &[1; 33], &[b'a'; 70]] {
            let error = read(file(content, 0o600).path()).unwrap_err().to_string();
            assert!(error.contains("64 hexadecimal digits"), "{error}");
            assert!(!error.contains("secret"));
        }
        let missing = read(Path::new("no-such.key")).unwrap_err().to_string();
        assert!(missing.contains("no-such.key"), "{missing}");
    }

    #[test]
    fn a_ground_key_is_hexadecimal_digits_and_each_start_has_its_own_nonces() {
        let hex = [b"0f".repeat(32), b"\n".to_vec()].concat();
        let key = read_ground(file(&hex, 0o600).path()).unwrap();
        assert!(key == GroundKey::new([15; 32]));
        let [one, other] = [(); 2].map(|()| credentials(&key).unwrap());
        assert_ne!(one.start, other.start);
        let short = &hex[..62];
        for content in [short, &[15; 32], b"", &b"0g".repeat(32), &hex.repeat(2)] {
            let error = read_ground(file(content, 0o600).path()).unwrap_err();
            let words = error.to_string();
            assert!(
                words.ends_with("64 hexadecimal digits and nothing else"),
                "{words}"
            );
        }
        let open = read_ground(file(&hex, 0o640).path()).unwrap_err();
        assert!(open.to_string().contains("mode 640"), "{open}");
    }
}
