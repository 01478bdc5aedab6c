// SPDX-License-Identifier: MIT OR Apache-2.0
//! The shared key, the nonces of the ends, and the keys of a session and its kinds of frames.

use core::fmt;

use hmac::{Hmac, KeyInit, Mac};
use serde::{Deserialize, Serialize};
use sha2::Sha256;
use zeroize::Zeroize;

use crate::link::message::{NONCE, TAG};

/// Separates these keys from any other use of the same shared key.
const LABEL: &[u8] = b"aircomp ground link 1";

/// The kind of an authenticated frame. It is a part of the key's derivation and of what the tag
/// covers: a frame of one kind is never valid as one of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Kind {
    /// To the ground: the nonce of the vehicle's next session.
    Offer = 0,
    /// To the ground, within a session.
    ToGround = 1,
    /// To the vehicle, within a session. The first one, without a message, begins it.
    ToVehicle = 2,
}

/// The secret that both ends of the ground link share. `Debug` does not print it, and its bytes are
/// overwritten when it is dropped.
#[derive(Clone, Serialize, Deserialize)]
pub struct GroundKey([u8; 32]);

impl GroundKey {
    /// Creates a key from its bytes, which should be random.
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Returns the key of the vehicle's offers.
    pub(super) fn of_offers(&self) -> MacKey {
        self.derive(Kind::Offer, &[])
    }

    /// Returns the key of one direction of the session between these nonces.
    pub(super) fn of_session(&self, direction: Kind, vehicle: &Nonce, ground: &Nonce) -> MacKey {
        self.derive(direction, &[vehicle.to_bytes(), ground.to_bytes()])
    }

    fn derive(&self, kind: Kind, nonces: &[[u8; NONCE]]) -> MacKey {
        let mut mac = keyed(&self.0);
        mac.update(LABEL);
        mac.update(&[kind as u8]);
        for nonce in nonces {
            mac.update(nonce);
        }
        MacKey(mac.finalize().into_bytes().into())
    }
}

impl Drop for GroundKey {
    fn drop(&mut self) {
        self.0.zeroize();
    }
}

impl fmt::Debug for GroundKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("GroundKey(..)")
    }
}

/// Compares the whole keys, so that the duration does not reveal where they differ.
impl PartialEq for GroundKey {
    fn eq(&self, other: &Self) -> bool {
        let differences = self.0.iter().zip(&other.0).map(|(a, b)| a ^ b);
        differences.fold(0, |all, one| all | one) == 0
    }
}

impl Eq for GroundKey {}

/// HMAC with a key that is padded with zeros to a block, as HMAC does it itself: a whole block needs
/// no check of its length.
fn keyed(key: &[u8; 32]) -> Hmac<Sha256> {
    let mut block = [0; 64];
    for (place, byte) in block.iter_mut().zip(key) {
        *place = *byte;
    }
    let mac = Hmac::new(&block.into());
    block.zeroize();
    mac
}

/// What one end of the ground link needs to be authenticated.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Credentials {
    /// The key that both ends share.
    pub key: GroundKey,
    /// The first part of this end's nonces. **It must differ at each start of this end with the same
    /// key**, whatever happened to the end before: 12 random bytes, or a counter in memory that
    /// survives a loss of power and is raised before it is used. It need not be secret, and others
    /// may be able to predict it.
    pub start: [u8; 12],
}

/// The nonce of an end for one session: different at each start of the end, and for each of its
/// sessions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Nonce {
    start: [u8; 12],
    session: u32,
}

impl Nonce {
    /// Returns the nonce of an end's first session.
    pub(super) fn first(start: [u8; 12]) -> Self {
        Self { start, session: 0 }
    }

    /// Returns the nonce of the same end for its next session; `None` after 2^32 sessions.
    pub(super) fn next(self) -> Option<Self> {
        let session = self.session.checked_add(1)?;
        Some(Self { session, ..self })
    }

    pub(super) fn to_bytes(self) -> [u8; NONCE] {
        let [a, b, c, d, e, f, g, h, i, j, k, l] = self.start;
        let [m, n, o, p] = self.session.to_le_bytes();
        [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p]
    }

    pub(super) fn from_bytes(bytes: &[u8; NONCE]) -> Self {
        let [start @ .., m, n, o, p] = *bytes;
        Self {
            start,
            session: u32::from_le_bytes([m, n, o, p]),
        }
    }
}

/// A key that makes and verifies tags. Its bytes are overwritten when it is dropped.
#[derive(Clone)]
pub(super) struct MacKey([u8; 32]);

impl MacKey {
    /// Returns the tag of these bytes.
    pub(super) fn tag(&self, bytes: &[u8]) -> [u8; TAG] {
        let mut mac = keyed(&self.0);
        mac.update(bytes);
        let whole: [u8; 32] = mac.finalize().into_bytes().into();
        // The first half: the conversion cannot fail.
        whole.first_chunk().copied().unwrap_or_default()
    }

    /// Returns whether this is the tag of these bytes, in a time that does not depend on the tag.
    pub(super) fn verifies(&self, bytes: &[u8], tag: &[u8; TAG]) -> bool {
        let mut mac = keyed(&self.0);
        mac.update(bytes);
        mac.verify_truncated_left(tag).is_ok()
    }
}

impl Drop for MacKey {
    fn drop(&mut self) {
        self.0.zeroize();
    }
}

impl fmt::Debug for MacKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("MacKey(..)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;

    /// Test case 1 of RFC 4231: the key is 20 bytes of 0x0b, which HMAC pads with zeros.
    #[test]
    fn the_tag_is_hmac_sha_256() {
        let mut key = [0; 32];
        key[..20].fill(0x0b);
        let tag = MacKey(key).tag(b"Hi There");
        let expected = [
            0xb0, 0x34, 0x4c, 0x61, 0xd8, 0xdb, 0x38, 0x53, 0x5c, 0xa8, 0xaf, 0xce, 0xaf, 0x0b,
            0xf1, 0x2b,
        ];
        assert_eq!(tag, expected);
        assert!(MacKey(key).verifies(b"Hi There", &expected));
        for bit in 0..8 * TAG {
            let mut wrong = expected;
            wrong[bit / 8] ^= 1 << (bit % 8);
            assert!(!MacKey(key).verifies(b"Hi There", &wrong), "bit {bit}");
        }
    }

    #[test]
    fn each_key_and_each_direction_differs() {
        let (vehicle, ground) = (Nonce::first([1; 12]), Nonce::first([2; 12]));
        let next = |nonce: Nonce| nonce.next().expect("not the last");
        let keys = [GroundKey::new([7; 32]), GroundKey::new([8; 32])];
        let mut derived = std::vec::Vec::new();
        for key in &keys {
            derived.push(key.of_offers().0);
            for (v, g) in [
                (vehicle, ground),
                (ground, vehicle),
                (next(vehicle), ground),
                (vehicle, next(ground)),
            ] {
                derived.push(key.of_session(Kind::ToGround, &v, &g).0);
                derived.push(key.of_session(Kind::ToVehicle, &v, &g).0);
            }
        }
        for (i, a) in derived.iter().enumerate() {
            for b in &derived[i + 1..] {
                assert_ne!(a, b);
            }
        }
    }

    #[test]
    fn nonces_are_read_as_they_are_written() {
        let nonce = Nonce {
            start: core::array::from_fn(|i| i as u8),
            session: 0x0403_0201,
        };
        let bytes = nonce.to_bytes();
        assert_eq!(bytes[11..], [11, 1, 2, 3, 4]);
        assert_eq!(Nonce::from_bytes(&bytes), nonce);
        let last = Nonce {
            session: u32::MAX,
            ..nonce
        };
        assert_eq!(last.next(), None);
    }

    #[test]
    fn keys_are_not_shown() {
        let key = GroundKey::new([0x5a; 32]);
        assert_eq!(format!("{key:?}"), "GroundKey(..)");
        let credentials = Credentials {
            key: key.clone(),
            start: [0; 12],
        };
        assert!(!format!("{credentials:?}").contains("90"));
        assert_eq!(format!("{:?}", key.of_offers()), "MacKey(..)");
        assert!(key == GroundKey::new([0x5a; 32]) && key != GroundKey::new([0x5b; 32]));
    }
}
