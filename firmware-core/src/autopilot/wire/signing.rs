//! MAVLink 2 message signing: only a sender that knows the key is accepted.
//!
//! A signed frame ends with a link id, a time (48 bits, units of 10 us since 2015-01-01) and the
//! first 48 bits of SHA-256 over the key, the frame and those two. The times of each
//! link and sender only increase, so a replayed frame is refused. Signer and verifier have no clock of their own: the caller
//! sets it.

use core::fmt;

use sha2::{Digest, Sha256};

use super::frame::{Address, Frame};
use super::layout::{
    SIGNATURE,
    signature::{DIGEST, LINK, LINK_AND_TIME, TIME},
};

/// The secret that both ends share. It is never printed, not even by `Debug`.
#[derive(Clone)]
pub struct SigningKey([u8; 32]);

impl SigningKey {
    /// Creates a key from its bytes.
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    fn signature(&self, frame: &[u8], link_and_time: &[u8]) -> [u8; DIGEST.end - DIGEST.start] {
        let mut hash = Sha256::new();
        hash.update(self.0);
        hash.update(frame);
        hash.update(link_and_time);
        let mut first = [0; DIGEST.end - DIGEST.start];
        first.copy_from_slice(&hash.finalize()[..DIGEST.len()]);
        first
    }
}

impl fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningKey(..)")
    }
}

/// 2015-01-01 00:00 UTC, microseconds since 1970.
const EPOCH_US: u64 = 1_420_070_400_000_000;
/// A new sender may be behind our clock by this, in units of 10 us: one minute.
const NEW_SENDER: u64 = 6_000_000;
const TIME_MASK: u64 = (1 << 48) - 1;

/// Returns the time of signatures for a time since 1970 in microseconds.
fn ticks(unix_us: u64) -> u64 {
    (unix_us.saturating_sub(EPOCH_US) / 10) & TIME_MASK
}

/// Signs the frames that are sent over one link.
#[derive(Clone, Debug)]
pub struct Signer {
    key: SigningKey,
    link: u8,
    /// The time of the last signature.
    time: u64,
}

impl Signer {
    /// Creates a signer for the link `link`, at the time `unix_us` (microseconds since 1970).
    pub fn new(key: SigningKey, link: u8, unix_us: u64) -> Self {
        Self {
            key,
            link,
            time: ticks(unix_us),
        }
    }

    /// Sets the clock, which never goes back.
    pub fn set_time(&mut self, unix_us: u64) {
        self.time = self.time.max(ticks(unix_us));
    }

    /// Returns the 13 bytes that follow a frame's checksum. Each signature has a later time than
    /// the one before.
    pub(super) fn sign(&mut self, frame: &[u8]) -> [u8; SIGNATURE] {
        self.time = (self.time + 1) & TIME_MASK;
        let mut tail = [0; SIGNATURE];
        tail[LINK] = self.link;
        tail[TIME].copy_from_slice(&self.time.to_le_bytes()[..TIME.len()]);
        let digest = self.key.signature(frame, &tail[LINK_AND_TIME]);
        tail[DIGEST].copy_from_slice(&digest);
        tail
    }
}

/// The number of senders (per link) whose times are tracked. A further sender is refused:
/// if one were forgotten, replayed frames of it would be accepted.
const STREAMS: usize = 16;

/// Verifies the signatures of received frames.
#[derive(Clone, Debug)]
pub struct Verifier {
    key: SigningKey,
    time: u64,
    streams: heapless::Vec<(u8, Address, u64), STREAMS>,
}

/// The result of verifying a frame's signature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Valid,
    Unsigned,
    Wrong,
    Replayed,
}

impl Verifier {
    /// Creates a verifier with this key, at the time `unix_us` (microseconds since 1970).
    pub fn new(key: SigningKey, unix_us: u64) -> Self {
        Self {
            key,
            time: ticks(unix_us),
            streams: heapless::Vec::new(),
        }
    }

    /// Sets the clock, which never goes back.
    pub fn set_time(&mut self, unix_us: u64) {
        self.time = self.time.max(ticks(unix_us));
    }

    pub(super) fn verify(&mut self, frame: &Frame<'_>) -> Verdict {
        let Some((signed, tail)) = frame.bytes().split_last_chunk::<SIGNATURE>() else {
            return Verdict::Unsigned;
        };
        if !frame.is_signed() {
            return Verdict::Unsigned;
        }
        let expected = self.key.signature(signed, &tail[LINK_AND_TIME]);
        // Compared as a whole, so that the duration does not reveal how many bytes are right.
        let difference = expected
            .iter()
            .zip(&tail[DIGEST])
            .fold(0, |d, (a, b)| d | (a ^ b));
        if difference != 0 {
            return Verdict::Wrong;
        }
        let mut bytes = [0; 8];
        bytes[..TIME.len()].copy_from_slice(&tail[TIME]);
        let time = u64::from_le_bytes(bytes);
        let (link, sender) = (tail[LINK], frame.sender());
        let known = self
            .streams
            .iter_mut()
            .find(|(l, s, _)| (*l, *s) == (link, sender));
        match known {
            Some((_, _, last)) if time <= *last => return Verdict::Replayed,
            Some((_, _, last)) => *last = time,
            None if time + NEW_SENDER < self.time => return Verdict::Replayed,
            None => {
                if self.streams.push((link, sender, time)).is_err() {
                    return Verdict::Wrong;
                }
            }
        }
        self.time = self.time.max(time);
        Verdict::Valid
    }
}
