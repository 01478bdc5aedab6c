//! Checkpoints: everything that a run's future depends on, in one file that is either whole or
//! not there.
//!
//! `UAVC`, version (u16), CRC-32 of the rest (u32), postcard. Taken between episodes, so that
//! the environments need not be in it.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, bail, ensure};
use crc::{CRC_32_ISO_HDLC, Crc};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    actor::Actor,
    evaluate::Flight,
    metrics::Row,
    replay::Replay,
    settings::{Algorithm, Settings},
};

const MAGIC: [u8; 4] = *b"UAVC";
const VERSION: u16 = 3;
const CHECKSUM: Crc<u32, crc::Table<16>> = Crc::<u32, crc::Table<16>>::new(&CRC_32_ISO_HDLC);

/// A policy that was evaluated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluated {
    /// After how many episodes.
    pub episode: u32,
    /// The policy.
    pub actor: Actor,
    /// What it came to.
    pub flight: Flight,
}

/// What a checkpoint says about itself before the learner's own state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Of the run.
    pub settings: Settings,
    /// The prices of fairness, bit/s/Hz; empty where the settings ask for none.
    pub prices: Vec<f64>,
    /// The scenario's name.
    pub scenario: String,
    /// The digest of its mission.
    pub scenario_digest: String,
    /// Episodes done.
    pub episode: u32,
    /// Slots done.
    pub global_step: u64,
    /// The latest policy.
    pub latest: Actor,
    /// The best so far.
    pub best: Option<Evaluated>,
    /// All that was logged.
    pub rows: Vec<Row>,
    /// Where random numbers go on.
    pub rng: Pcg64Mcg,
}

/// A run between two episodes.
#[derive(Clone, Debug, Deserialize)]
pub struct Checkpoint<S> {
    /// What can be read without knowing the learner.
    pub progress: Progress,
    /// The learner.
    pub learner: S,
    /// The memory.
    pub replay: Replay,
}

/// Writes a file so that a reader, or a crash, sees the old one or the new one.
///
/// # Errors
/// Of the file system.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".partial");
    let partial: PathBuf = path.with_file_name(name);
    let mut file = File::create(&partial)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&partial, path)?;
    if let Some(directory) = path.parent().filter(|d| !d.as_os_str().is_empty()) {
        // The rename itself has to reach the disk; not every file system lets one ask.
        let _ = File::open(directory).and_then(|directory| directory.sync_all());
    }
    Ok(())
}

/// Writes a checkpoint in place of the previous one.
///
/// # Errors
/// Of the file system.
pub fn write<S: Serialize>(
    path: &Path,
    progress: &Progress,
    learner: &S,
    replay: &Replay,
) -> anyhow::Result<()> {
    let mut bytes = Vec::with_capacity(1 << 20);
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend([0; 4]);
    // A tuple of references has the encoding of the struct.
    let mut bytes = postcard::to_extend(&(progress, learner, replay), bytes)?;
    let checksum = CHECKSUM.checksum(&bytes[10..]);
    bytes[6..10].copy_from_slice(&checksum.to_le_bytes());
    write_atomically(path, &bytes).with_context(|| path.display().to_string())
}

impl<S: DeserializeOwned> Checkpoint<S> {
    /// Reads one.
    ///
    /// # Errors
    /// A file that is none, is damaged, or is of another version or algorithm.
    pub fn read(path: &Path, algorithm: Algorithm) -> anyhow::Result<Self> {
        let bytes = read_checked(path)?;
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

/// Reads a checkpoint's [`Progress`] whatever the learner.
///
/// # Errors
/// As [`Checkpoint::read`].
pub fn read_progress(path: &Path) -> anyhow::Result<Progress> {
    let bytes = read_checked(path)?;
    peek(&bytes).with_context(|| path.display().to_string())
}

fn peek(bytes: &[u8]) -> anyhow::Result<Progress> {
    let (progress, _) = postcard::take_from_bytes(&bytes[10..])?;
    Ok(progress)
}

fn read_checked(path: &Path) -> anyhow::Result<Vec<u8>> {
    let name = path.display();
    let bytes = fs::read(path).with_context(|| name.to_string())?;
    if bytes.len() < 10 || bytes[..4] != MAGIC {
        bail!("{name}: not a checkpoint: it does not start with UAVC");
    }
    let version = u16::from_le_bytes([bytes[4], bytes[5]]);
    ensure!(
        version == VERSION,
        "{name}: checkpoint version is {version}, but this build reads {VERSION}"
    );
    let expected = u32::from_le_bytes([bytes[6], bytes[7], bytes[8], bytes[9]]);
    let got = CHECKSUM.checksum(&bytes[10..]);
    ensure!(
        got == expected,
        "{name}: checksum is {got:#010x}, but the file says {expected:#010x}: it is damaged"
    );
    Ok(bytes)
}
