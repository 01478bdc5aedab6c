//! MAVLink 2 message signing: who knows the key may speak.
//!
//! A signed frame ends with a link id, a time (48 bits, units of 10 us since 2015-01-01) and the
//! first 48 bits of SHA-256 over the key, the frame and those two. Times only rise per link and
//! sender, so a recording is refused. Neither side has a clock of its own: the caller sets it.

use core::fmt;

use sha2::{Digest, Sha256};

use super::{Address, Frame, SIGNATURE};

/// The secret that both ends share. Never shown, not even by `Debug`.
#[derive(Clone)]
pub struct SigningKey([u8; 32]);

impl SigningKey {
    /// A key of these bytes.
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    fn signature(&self, frame: &[u8], link_and_time: &[u8]) -> [u8; 6] {
        let mut hash = Sha256::new();
        hash.update(self.0);
        hash.update(frame);
        hash.update(link_and_time);
        let mut first = [0; 6];
        first.copy_from_slice(&hash.finalize()[..6]);
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
/// A sender that is new may be behind our clock by this: one minute.
const NEW_SENDER: u64 = 6_000_000;
const TIME_MASK: u64 = (1 << 48) - 1;

/// The time of signatures for a time since 1970 in microseconds.
fn ticks(unix_us: u64) -> u64 {
    (unix_us.saturating_sub(EPOCH_US) / 10) & TIME_MASK
}

/// Signs what is sent over one link.
#[derive(Clone, Debug)]
pub struct Signer {
    key: SigningKey,
    link: u8,
    /// The time of the last signature.
    time: u64,
}

impl Signer {
    /// Signs as link `link`, at the time `unix_us` (microseconds since 1970).
    pub fn new(key: SigningKey, link: u8, unix_us: u64) -> Self {
        Self {
            key,
            link,
            time: ticks(unix_us),
        }
    }

    /// Sets the clock; it never goes back.
    pub fn set_time(&mut self, unix_us: u64) {
        self.time = self.time.max(ticks(unix_us));
    }

    /// The 13 bytes behind a frame's checksum; each signature has a later time than the last.
    pub(super) fn sign(&mut self, frame: &[u8]) -> [u8; SIGNATURE] {
        self.time = (self.time + 1) & TIME_MASK;
        let mut tail = [0; SIGNATURE];
        tail[0] = self.link;
        tail[1..7].copy_from_slice(&self.time.to_le_bytes()[..6]);
        let signature = self.key.signature(frame, &tail[..7]);
        tail[7..].copy_from_slice(&signature);
        tail
    }
}

/// Senders (per link) whose times are followed. A further one is refused: forgetting one would
/// let its recordings in.
const STREAMS: usize = 16;

/// Checks what is received.
#[derive(Clone, Debug)]
pub struct Verifier {
    key: SigningKey,
    time: u64,
    streams: heapless::Vec<(u8, Address, u64), STREAMS>,
}

/// What a frame's signature is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Good,
    Unsigned,
    Wrong,
    Replayed,
}

impl Verifier {
    /// Checks with this key, at the time `unix_us` (microseconds since 1970).
    pub fn new(key: SigningKey, unix_us: u64) -> Self {
        Self {
            key,
            time: ticks(unix_us),
            streams: heapless::Vec::new(),
        }
    }

    /// Sets the clock; it never goes back.
    pub fn set_time(&mut self, unix_us: u64) {
        self.time = self.time.max(ticks(unix_us));
    }

    pub(super) fn judge(&mut self, frame: &Frame<'_>) -> Verdict {
        if !frame.is_signed() {
            return Verdict::Unsigned;
        }
        let (signed, tail) = frame.bytes().split_at(frame.bytes().len() - SIGNATURE);
        let expected = self.key.signature(signed, &tail[..7]);
        // Compared as a whole, so that the time taken does not tell how much was right.
        let difference = expected
            .iter()
            .zip(&tail[7..])
            .fold(0, |d, (a, b)| d | (a ^ b));
        if difference != 0 {
            return Verdict::Wrong;
        }
        let mut bytes = [0; 8];
        bytes[..6].copy_from_slice(&tail[1..7]);
        let time = u64::from_le_bytes(bytes);
        let (link, sender) = (tail[0], frame.sender());
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
        Verdict::Good
    }
}
