// SPDX-License-Identifier: MIT OR Apache-2.0
//! Encoder and decoder of frames.

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::Vec;
use serde::{Serialize, de::DeserializeOwned};

use super::{
    byte_stuffing::{most_encodable, stuff, unstuff},
    error::{FrameError, FrameTooLong},
    message::{FRAME_MAX, Message, PROTOCOL_VERSION, frame_max},
    status::LinkCounters,
};
use crate::{counter::count, scalar::Scalar};

pub(super) const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
const CRC_LENGTH: usize = 4;

/// Writes a message as a frame into `frame` and returns the bytes to send.
///
/// # Errors
/// Returns an error if the frame does not fit; [`frame_max`] bytes always suffice.
pub fn encode<'f, T: Scalar, const M: usize, const J: usize>(
    message: &Message<T, M, J>,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    encode_as(PROTOCOL_VERSION, message, frame)
}

/// As [`encode`], with another protocol version in the frame, for tests of a receiver.
///
/// # Errors
/// As [`encode`].
pub fn encode_as<'f, T: Scalar, const M: usize, const J: usize>(
    version: u8,
    message: &Message<T, M, J>,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    seal(version, message, frame)
}

/// Encodes a message of any protocol as a frame.
pub(crate) fn seal<'f>(
    version: u8,
    message: &impl Serialize,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    write_frame(frame, |plain| {
        let (first, rest) = plain.split_first_mut()?;
        *first = version;
        Some(1 + postcard::to_slice(message, rest).ok()?.len())
    })
}

/// Writes a frame. `write` puts what the CRC covers at the beginning of the bytes that it is given,
/// and returns the length; `None` if it does not fit.
pub(super) fn write_frame(
    frame: &mut [u8],
    write: impl FnOnce(&mut [u8]) -> Option<usize>,
) -> Result<&[u8], FrameTooLong> {
    let capacity = frame.len();
    let length = frame_in_place(frame, write).ok_or(FrameTooLong { capacity })?;
    frame.get(..length).ok_or(FrameTooLong { capacity })
}

/// As [`write_frame`]; returns the length of the frame. The bytes are written behind as many as COBS
/// may add to them, and encoded in place, so that no second buffer is needed.
fn frame_in_place(
    frame: &mut [u8],
    write: impl FnOnce(&mut [u8]) -> Option<usize>,
) -> Option<usize> {
    let (start, rest) = frame.split_first_mut()?;
    *start = 0;
    let encodable = rest.len().checked_sub(1)?;
    let most = most_encodable(encodable);
    let begin = encodable - most;
    let plain = rest.get_mut(begin..encodable)?;
    let covered = write(plain.get_mut(..most.checked_sub(CRC_LENGTH)?)?)?;
    let (checked, behind) = plain.split_at_mut_checked(covered)?;
    *behind.first_chunk_mut::<CRC_LENGTH>()? = CHECKSUM.checksum(checked).to_le_bytes();
    let length = covered + CRC_LENGTH;
    let encoded = stuff(rest, begin + length, length)?;
    *rest.get_mut(encoded)? = 0;
    Some(1 + encoded + 1)
}

/// Finds messages in a stream of bytes. `N` is the length of the longest frame that it accepts, at
/// least [`frame_max`] of the messages that it decodes.
#[derive(Clone, Debug, Default)]
pub struct Decoder<const N: usize = FRAME_MAX> {
    buffer: Vec<u8, N>,
    overflowed: bool,
    counters: LinkCounters,
}

impl<const N: usize> Decoder<N> {
    /// Creates a decoder that has received nothing.
    pub fn new() -> Self {
        Self {
            buffer: Vec::new(),
            overflowed: false,
            counters: LinkCounters::default(),
        }
    }

    /// Returns the counters of what was received so far.
    pub fn counters(&self) -> &LinkCounters {
        &self.counters
    }

    /// Takes a byte. At the end of a frame it returns the message, or the error if there is none.
    ///
    /// A capacity `N` that is too small for messages of these capacities does not compile:
    ///
    /// ```compile_fail,E0080
    /// use firmware_core::link::Decoder;
    ///
    /// // 100 sensors, but frames for 64.
    /// let mut decoder: Decoder = Decoder::new();
    /// decoder.push::<f64, 16, 100>(0);
    /// ```
    pub fn push<T: Scalar, const M: usize, const J: usize>(
        &mut self,
        byte: u8,
    ) -> Option<Result<Message<T, M, J>, FrameError>> {
        const {
            assert!(
                frame_max::<T>(M, J) <= N,
                "the frames of this `link::Decoder<N>` are too short for M users and J sensors: N \
                 must be at least `link::frame_max::<T>(M, J)`, and where the link is authenticated \
                 `link::secure_frame_max::<T>(M, J)`"
            )
        };
        self.push_of(PROTOCOL_VERSION, byte)
    }

    /// Takes a byte of a protocol with messages of any type.
    pub(crate) fn push_of<D: DeserializeOwned>(
        &mut self,
        version: u8,
        byte: u8,
    ) -> Option<Result<D, FrameError>> {
        self.push_with(byte, |plain| decode_message(version, plain).map(Some))
    }

    /// Overwrites the bytes of the last frame.
    #[cfg(all(feature = "autopilot", feature = "planner"))]
    pub(crate) fn erase(&mut self) {
        // Within the capacity: no error.
        let _ = self.buffer.resize(N, 0);
        zeroize::Zeroize::zeroize(self.buffer.as_mut_slice());
        self.buffer.clear();
    }

    /// Takes a byte. At the end of a frame `read` takes what the CRC covers, version first; a frame
    /// for which it returns no message is not counted here.
    pub(super) fn push_with<D>(
        &mut self,
        byte: u8,
        read: impl FnOnce(&[u8]) -> Result<Option<D>, FrameError>,
    ) -> Option<Result<D, FrameError>> {
        if byte != 0 {
            self.overflowed |= self.buffer.push(byte).is_err();
            return None;
        }
        let outcome = if self.overflowed {
            Err(FrameError::TooLong)
        } else if self.buffer.is_empty() {
            // Two delimiters in a row: an idle line, or a sender that starts with one.
            return None;
        } else {
            unwrap(&mut self.buffer).and_then(read)
        };
        self.buffer.clear();
        self.overflowed = false;
        match &outcome {
            Ok(Some(_)) => count(&mut self.counters.messages),
            Ok(None) => {}
            Err(error) => self.counters.note(*error),
        }
        outcome.transpose()
    }
}

/// Returns what the CRC covers of the bytes between two delimiters.
fn unwrap(frame: &mut [u8]) -> Result<&[u8], FrameError> {
    let (plain, checksum) = unstuff(frame)
        .and_then(|plain| plain.split_last_chunk::<4>())
        .ok_or(FrameError::Malformed)?;
    if plain.is_empty() {
        return Err(FrameError::Malformed);
    }
    if CHECKSUM.checksum(plain) != u32::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
    Ok(plain)
}

/// Decodes a message without authentication.
pub(super) fn decode_message<D: DeserializeOwned>(
    expected: u8,
    plain: &[u8],
) -> Result<D, FrameError> {
    let (&version, body) = plain.split_first().ok_or(FrameError::Malformed)?;
    if version != expected {
        return Err(FrameError::Version { got: version });
    }
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError::Message),
    }
}

impl LinkCounters {
    /// Counts a frame that was dropped.
    fn note(&mut self, error: FrameError) {
        count(match error {
            // Counted by the authentication.
            FrameError::Refused(_) => return,
            FrameError::TooLong => &mut self.too_long,
            FrameError::Malformed => &mut self.malformed,
            FrameError::Checksum => &mut self.checksum,
            FrameError::Version { .. } => &mut self.version,
            FrameError::Message => &mut self.message,
        });
    }
}
