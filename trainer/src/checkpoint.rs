//! Checkpoints: everything that the continuation of a run depends on, in one file that is written
//! atomically.
//!
//! The file consists of `UAVC`, the version (u16), the CRC-32 of the rest (u32), and the data in
//! postcard format. Checkpoints are taken between episodes, so they do not contain the state of the
//! environments.

use std::{fs, io, path::Path};

use anyhow::{Context, bail, ensure};
use crc::{CRC_32_ISO_HDLC, Crc};
use files::output;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    actor::Actor,
    evaluate::Flight,
    metrics::MetricsRow,
    replay::Replay,
    settings::{Algorithm, TrainingSettings},
};

const MAGIC: [u8; 4] = *b"UAVC";
const VERSION: u16 = 3;
const CHECKSUM: Crc<u32, crc::Table<16>> = Crc::<u32, crc::Table<16>>::new(&CRC_32_ISO_HDLC);

/// A policy together with its evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluated {
    /// The number of episodes after which it was evaluated.
    pub episode: u32,
    /// The policy.
    pub actor: Actor,
    /// The evaluation flight.
    pub flight: Flight,
}

/// The part of a checkpoint that does not depend on the learner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingProgress {
    /// The settings of the run.
    pub settings: TrainingSettings,
    /// The fairness prices, bit/s/Hz; empty if the settings do not enable them.
    pub prices: Vec<f64>,
    /// The scenario's name.
    pub scenario: String,
    /// The digest of its mission.
    pub scenario_digest: String,
    /// Number of episodes completed.
    pub episode: u32,
    /// Number of slots completed.
    pub global_step: u64,
    /// The latest policy.
    pub latest: Actor,
    /// The best policy so far.
    pub best: Option<Evaluated>,
    /// The metrics of all episodes.
    pub rows: Vec<MetricsRow>,
    /// The random number generator.
    pub rng: Pcg64Mcg,
}

/// A run between two episodes.
#[derive(Clone, Debug, Deserialize)]
pub struct Checkpoint<S> {
    /// The part that can be read without knowing the learner.
    pub progress: TrainingProgress,
    /// The state of the learner.
    pub learner: S,
    /// The replay memory.
    pub replay: Replay,
}

/// Writes a checkpoint, which replaces the previous one.
///
/// # Errors
/// Returns the file system's error with the file's name.
pub fn write<S: Serialize>(
    path: &Path,
    progress: &TrainingProgress,
    learner: &S,
    replay: &Replay,
) -> anyhow::Result<()> {
    // A tuple of references has the encoding of the struct.
    write_checked(path, MAGIC, VERSION, &(progress, learner, replay))
}

/// Writes a file of magic number, version, checksum and data.
///
/// # Errors
/// Returns the file system's error with the file's name.
pub(crate) fn write_checked<T: Serialize>(
    path: &Path,
    magic: [u8; 4],
    version: u16,
    data: &T,
) -> anyhow::Result<()> {
    let mut bytes = Vec::with_capacity(1 << 20);
    bytes.extend(magic);
    bytes.extend(version.to_le_bytes());
    bytes.extend([0; 4]);
    let mut bytes = postcard::to_extend(data, bytes)?;
    let checksum = CHECKSUM.checksum(&bytes[10..]);
    bytes[6..10].copy_from_slice(&checksum.to_le_bytes());
    output::write(path, &bytes).with_context(|| path.display().to_string())
}

impl<S: DeserializeOwned> Checkpoint<S> {
    /// Reads a checkpoint.
    ///
    /// # Errors
    /// Fails if the file is not a checkpoint, is damaged, or has another version or algorithm.
    pub fn read(path: &Path, algorithm: Algorithm) -> anyhow::Result<Self> {
        let bytes = read_checked(path, MAGIC, VERSION)?;
        let progress = peek(&bytes).with_context(|| path.display().to_string())?;
        let found = progress.settings.algorithm;
        ensure!(
            found == algorithm,
            "{}: algorithm is {}, but {} was asked for",
            path.display(),
            found.name(),
            algorithm.name()
        );
        let (saved, rest) = postcard::take_from_bytes(&bytes[10..])
            .with_context(|| format!("{}: damaged", path.display()))?;
        ensure!(
            rest.is_empty(),
            "{}: damaged: {} bytes too many",
            path.display(),
            rest.len()
        );
        Ok(saved)
    }
}

/// Reads the [`TrainingProgress`] of a checkpoint of any learner.
///
/// # Errors
/// Fails if the file is not a checkpoint, is damaged, or has another version.
pub fn read_progress(path: &Path) -> anyhow::Result<TrainingProgress> {
    let bytes = read_checked(path, MAGIC, VERSION)?;
    peek(&bytes).with_context(|| path.display().to_string())
}

/// Returns whether a file is a checkpoint of this version whose data are incomplete or changed, as
/// after a crash of the file system. A file of another kind or version is not damaged.
///
/// # Errors
/// Returns the file system's error.
pub fn is_damaged(path: &Path) -> io::Result<bool> {
    let bytes = fs::read(path)?;
    let Some((header, data)) = bytes.split_first_chunk::<10>() else {
        return Ok(true);
    };
    let is_own = header[..4] == MAGIC && header[4..6] == VERSION.to_le_bytes();
    let checksum = CHECKSUM.checksum(data).to_le_bytes();
    Ok(is_own && header[6..] != checksum)
}

/// Decodes the [`TrainingProgress`] at the start of the data.
fn peek(bytes: &[u8]) -> anyhow::Result<TrainingProgress> {
    let (progress, _) = postcard::take_from_bytes(&bytes[10..])?;
    Ok(progress)
}

/// Reads a file and checks its magic number, version and checksum. The data begin at byte 10.
///
/// # Errors
/// Fails if the file cannot be read, is no such file, has another version, or is damaged.
pub(crate) fn read_checked(path: &Path, magic: [u8; 4], version: u16) -> anyhow::Result<Vec<u8>> {
    let name = path.display();
    let bytes = fs::read(path).with_context(|| name.to_string())?;
    if bytes.len() < 10 || bytes[..4] != magic {
        let magic = String::from_utf8_lossy(&magic);
        bail!("{name}: not a checkpoint: it does not start with {magic}");
    }
    let found = u16::from_le_bytes([bytes[4], bytes[5]]);
    ensure!(
        found == version,
        "{name}: checkpoint version is {found}, but this build reads {version}"
    );
    let expected = u32::from_le_bytes([bytes[6], bytes[7], bytes[8], bytes[9]]);
    let got = CHECKSUM.checksum(&bytes[10..]);
    ensure!(
        got == expected,
        "{name}: checksum is {got:#010x}, but the file says {expected:#010x}: the file is damaged"
    );
    Ok(bytes)
}
