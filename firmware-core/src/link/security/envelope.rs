// SPDX-License-Identifier: MIT OR Apache-2.0
//! The layout of an authenticated frame:
//! `version | kind | nonce | counter | message | tag`, and the CRC of every frame.

use serde::Serialize;

use super::key::{Kind, MacKey, Nonce};
use crate::link::{
    error::FrameTooLong,
    frame::write_frame,
    message::{NONCE, SECURE_VERSION, TAG},
};

/// The length of version, kind, nonce and counter.
const HEADER: usize = 1 + 1 + NONCE + 4;

/// What precedes the message in an authenticated frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) kind: Kind,
    /// The sender's nonce for the session.
    pub(super) nonce: Nonce,
    /// The number of the frame in its direction of the session.
    pub(super) counter: u32,
}

impl Header {
    fn to_bytes(self) -> [u8; HEADER] {
        let [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p] = self.nonce.to_bytes();
        let [q, r, s, t] = self.counter.to_le_bytes();
        let (version, kind) = (SECURE_VERSION, self.kind as u8);
        [
            version, kind, a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t,
        ]
    }

    fn from_bytes(bytes: &[u8; HEADER]) -> Option<Self> {
        let [_version, kind, nonce @ .., q, r, s, t] = bytes;
        Some(Self {
            kind: match kind {
                0 => Kind::Offer,
                1 => Kind::ToGround,
                2 => Kind::ToVehicle,
                _ => return None,
            },
            nonce: Nonce::from_bytes(nonce),
            counter: u32::from_le_bytes([*q, *r, *s, *t]),
        })
    }
}

/// An authenticated frame whose tag has not been verified yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Envelope<'a> {
    pub(super) header: Header,
    /// The message in postcard's encoding; empty in a frame of the handshake.
    pub(super) message: &'a [u8],
    signed: &'a [u8],
    tag: &'a [u8; TAG],
}

impl<'a> Envelope<'a> {
    /// Splits the bytes of a frame, from the version to the CRC excluded. Returns `None` if they are
    /// too short or of an unknown kind.
    pub(super) fn parse(plain: &'a [u8]) -> Option<Self> {
        let (signed, tag) = plain.split_last_chunk()?;
        let (header, message) = signed.split_first_chunk()?;
        Some(Self {
            header: Header::from_bytes(header)?,
            message,
            signed,
            tag,
        })
    }

    pub(super) fn is_valid(&self, key: &MacKey) -> bool {
        key.verifies(self.signed, self.tag)
    }
}

/// Writes a frame with this header and message, and a tag made with `key`.
///
/// # Errors
/// Returns an error if the frame does not fit.
pub(super) fn seal<'f, M: Serialize>(
    header: Header,
    message: Option<&M>,
    key: &MacKey,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    write_frame(frame, |plain| write(plain, header, message, key))
}

/// Writes everything but the CRC, and returns the length; `None` if it does not fit.
fn write<M: Serialize>(
    plain: &mut [u8],
    header: Header,
    message: Option<&M>,
    key: &MacKey,
) -> Option<usize> {
    let (first, rest) = plain.split_first_chunk_mut()?;
    *first = header.to_bytes();
    let length = match message {
        Some(message) => postcard::to_slice(message, rest).ok()?.len(),
        None => 0,
    };
    let end = HEADER + length;
    let tag = key.tag(plain.get(..end)?);
    *plain.get_mut(end..)?.first_chunk_mut()? = tag;
    Some(end + TAG)
}
