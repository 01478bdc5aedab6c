// SPDX-License-Identifier: MIT OR Apache-2.0
//! What all versions of a `.policy` file have in common: the preamble, numbers, and how a test
//! vector is compared.
//!
//! | part | bytes | |
//! |---|---|---|
//! | magic | 4 | `UAVP` |
//! | version | 2 | the version of the format, little endian |
//! | checksum | 4 | CRC-32/ISO-HDLC over all that follows, little endian |

use crc::{CRC_32_ISO_HDLC, Crc};

/// The largest difference from its test vector that a policy may have, as a fraction of full scale.
pub const SELF_TEST_TOLERANCE: f32 = 1e-5;

const MAGIC: [u8; 4] = *b"UAVP";

/// The length of the preamble, bytes.
pub(super) const PREAMBLE: usize = 10;

const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Error returned when bytes are not a policy file of the expected version, or are damaged.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ContainerError {
    /// The file is of another kind, or is incomplete.
    #[error("not a .policy file: it does not start with UAVP")]
    NotAPolicy,
    /// The file has another format version.
    #[error("format version is {got}, but this build reads {expected}")]
    Version {
        /// The file's version.
        got: u16,
        /// The version that can be read.
        expected: u16,
    },
    /// The file is damaged or incomplete.
    #[error("checksum is {got:#010x}, but the file says {expected:#010x}: the file is damaged")]
    Checksum {
        /// The checksum of the bytes.
        got: u32,
        /// The checksum in the file.
        expected: u32,
    },
}

/// Returns the format version of a `.policy` file: which type loads it.
///
/// # Errors
/// Returns an error if the bytes do not begin as a `.policy` file does.
pub fn format_version(file: &[u8]) -> Result<u16, ContainerError> {
    Ok(preamble(file)?.0)
}

/// Returns version, checksum and what follows them.
fn preamble(file: &[u8]) -> Result<(u16, u32, &[u8]), ContainerError> {
    let (&[m0, m1, m2, m3, v0, v1, c0, c1, c2, c3], body) = file
        .split_first_chunk::<PREAMBLE>()
        .ok_or(ContainerError::NotAPolicy)?;
    if [m0, m1, m2, m3] != MAGIC {
        return Err(ContainerError::NotAPolicy);
    }
    let version = u16::from_le_bytes([v0, v1]);
    Ok((version, u32::from_le_bytes([c0, c1, c2, c3]), body))
}

/// Returns what follows the preamble of a file, whose version and checksum are right.
pub(super) fn open(file: &[u8], version: u16) -> Result<&[u8], ContainerError> {
    let (got, checksum, body) = preamble(file)?;
    let expected = version;
    if got != expected {
        return Err(ContainerError::Version { got, expected });
    }
    let (got, expected) = (CHECKSUM.checksum(body), checksum);
    if got != expected {
        return Err(ContainerError::Checksum { got, expected });
    }
    Ok(body)
}

/// Writes the preamble before the body of a file; `None` if the file is shorter than a preamble.
pub(super) fn seal(file: &mut [u8], version: u16) -> Option<()> {
    let (preamble, body) = file.split_first_chunk_mut::<PREAMBLE>()?;
    let [m0, m1, m2, m3] = MAGIC;
    let [v0, v1] = version.to_le_bytes();
    let [c0, c1, c2, c3] = CHECKSUM.checksum(body).to_le_bytes();
    *preamble = [m0, m1, m2, m3, v0, v1, c0, c1, c2, c3];
    Some(())
}

/// Returns the numbers of a part of a file.
pub(super) fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> + Clone + '_ {
    let (words, _) = bytes.as_chunks::<4>();
    words.iter().map(|&word| f32::from_le_bytes(word))
}

/// An output that is too far from the test vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Deviation {
    pub(super) index: usize,
    pub(super) got: f32,
    pub(super) expected: f32,
}

/// Compares outputs, first the displacement (metres) and then the scores, with those that are
/// expected. Displacements are measured by the reach, scores by the largest of them, at least 1.
pub(super) fn deviation(
    outputs: impl Iterator<Item = f32>,
    expected: impl Iterator<Item = f32> + Clone,
    reach_m: f32,
) -> Option<Deviation> {
    let scores = expected.clone().skip(2);
    let scores_scale = scores.fold(1.0_f32, |largest, score| largest.max(score.abs()));
    for (index, (got, expected)) in outputs.zip(expected).enumerate() {
        let scale = if index < 2 { reach_m } else { scores_scale };
        // Written so that a NaN fails.
        let close = (got - expected).abs() <= SELF_TEST_TOLERANCE * scale;
        if !close {
            return Some(Deviation {
                index,
                got,
                expected,
            });
        }
    }
    None
}
