// SPDX-License-Identifier: MIT OR Apache-2.0
//! The key, and what is computed with it.

use core::fmt;

use sha2::{Digest, Sha256};
use zeroize::{Zeroize, ZeroizeOnDrop};

use super::super::layout::signature::DIGEST;

/// The number of bytes of a digest in a frame.
const DIGEST_LENGTH: usize = DIGEST.end - DIGEST.start;

/// The secret that both ends share. It is never printed, not even by `Debug`, and its memory is
/// overwritten when it is dropped. Moving a value may leave a copy behind that is not overwritten,
/// and neither is the state of SHA-256 on the stack: this shortens the time that a key can be found
/// in memory, and is no guarantee.
#[derive(Clone)]
pub struct SigningKey([u8; 32]);

impl SigningKey {
    /// Creates a key from its bytes. The caller's copy of them is the caller's to overwrite.
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Returns the bytes, for the order of a board.
    #[cfg(all(feature = "link", feature = "planner"))]
    pub(crate) fn bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Returns the digest of a frame with its link id and time.
    pub(super) fn digest(&self, frame: &[u8], link_and_time: &[u8]) -> [u8; DIGEST_LENGTH] {
        let mut hash = Sha256::new();
        hash.update(self.0);
        hash.update(frame);
        hash.update(link_and_time);
        let mut first = [0; DIGEST_LENGTH];
        for (byte, of_hash) in first.iter_mut().zip(hash.finalize()) {
            *byte = of_hash;
        }
        first
    }
}

/// Compares secrets as a whole, so that the duration does not reveal how many bytes are equal.
pub(super) fn are_equal(a: &[u8], b: &[u8]) -> bool {
    let difference = a.iter().zip(b).fold(0, |all, (a, b)| all | (a ^ b));
    a.len() == b.len() && difference == 0
}

impl PartialEq for SigningKey {
    fn eq(&self, other: &Self) -> bool {
        are_equal(&self.0, &other.0)
    }
}

impl Eq for SigningKey {}

impl Zeroize for SigningKey {
    fn zeroize(&mut self) {
        self.0.zeroize();
    }
}

impl Drop for SigningKey {
    fn drop(&mut self) {
        self.zeroize();
    }
}

impl ZeroizeOnDrop for SigningKey {}

impl fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningKey(..)")
    }
}
