// SPDX-License-Identifier: MIT OR Apache-2.0
//! The errors of the ground link.

use super::message::PROTOCOL_VERSION;

/// Error returned when the buffer for a frame is too small.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a frame does not fit into {capacity} bytes")]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FrameTooLong {
    /// The size of the buffer, bytes.
    pub capacity: usize,
}

/// Error returned when a message cannot be made a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EncodeError {
    /// The frame does not fit.
    #[error(transparent)]
    TooLong(#[from] FrameTooLong),
    /// The link is authenticated, and there is no session yet.
    #[error("no session with the other end")]
    NoSession,
}

/// The reason why a frame of an authenticated link was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// It has no tag.
    #[error("not authenticated")]
    Unauthenticated,
    /// It names the present session, or is an offer, and its tag does not match.
    #[error("its tag does not match")]
    Forged,
    /// It names another session than the present one, and does not begin one.
    #[error("of another session")]
    OtherSession,
    /// Its tag matches, but its counter is not above that of the last frame.
    #[error("received before")]
    Replayed,
    /// It is of a kind that this end itself sends.
    #[error("sent by this end")]
    Reflected,
}

/// Error returned when the bytes between two delimiters are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FrameError {
    /// Longer than any frame.
    #[error("longer than any frame")]
    TooLong,
    /// Not COBS, or too short to hold a version and a CRC.
    #[error("not a frame")]
    Malformed,
    /// The CRC does not match.
    #[error("checksum does not match")]
    Checksum,
    /// The frame has another protocol version.
    #[error("protocol version {got}, but this is {PROTOCOL_VERSION}")]
    Version {
        /// The version of the frame.
        got: u8,
    },
    /// The frame is correct, but its message cannot be decoded, for example because it has too many
    /// gains.
    #[error("not a message of this protocol")]
    Message,
    /// The link is authenticated, and the frame is not of the other end or not of this session.
    #[error("refused: {0}")]
    Refused(Refusal),
}
