// SPDX-License-Identifier: MIT OR Apache-2.0
//! Signatures of sent frames.

use super::super::layout::{
    SIGNATURE,
    signature::{DIGEST, LINK, LINK_AND_TIME, TIME},
};
use super::{key::SigningKey, time::SigningTime};

/// Signs the frames that are sent over one link.
#[derive(Clone, Debug)]
pub struct Signer {
    key: SigningKey,
    link: u8,
    /// The time of the last signature, or a later one that was set.
    time: SigningTime,
}

impl Signer {
    /// Creates a signer for the link `link`, whose signatures have later times than `time`.
    pub const fn new(key: SigningKey, link: u8, time: SigningTime) -> Self {
        Self { key, link, time }
    }

    /// Makes all further signatures later than `time`. The clock never goes back.
    pub fn advance_to(&mut self, time: SigningTime) {
        self.time = self.time.max(time);
    }

    /// Returns the time of the last signature, or the time that was set, whichever is later.
    pub fn time(&self) -> SigningTime {
        self.time
    }

    /// Replaces `older`. With the same key, the times go on from there.
    pub(in super::super) fn continue_from(&mut self, older: &Self) {
        if self.key == older.key {
            self.advance_to(older.time);
        }
    }

    /// Returns the 13 bytes that follow a frame's checksum. Each signature has a later time than
    /// the one before, up to [`SigningTime::LAST`].
    pub(in super::super) fn sign(&mut self, frame: &[u8]) -> [u8; SIGNATURE] {
        self.time = self.time.next();
        let mut tail = [0; SIGNATURE];
        tail[LINK] = self.link;
        let time = self.time.units().to_le_bytes();
        copy(&mut tail[TIME], &time);
        let digest = self.key.digest(frame, &tail[LINK_AND_TIME]);
        copy(&mut tail[DIGEST], &digest);
        tail
    }
}

/// Copies the first bytes, as many as both have.
fn copy(to: &mut [u8], from: &[u8]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
