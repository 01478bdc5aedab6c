// SPDX-License-Identifier: MIT OR Apache-2.0
//! Encoder and decoder of frames.

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::Vec;
use serde::{Serialize, de::DeserializeOwned};

use super::{
    error::{FrameError, FrameTooLong},
    message::{FRAME_MAX, Message, PROTOCOL_VERSION, frame_max},
    status::LinkCounters,
};
use crate::{counter::count, scalar::Scalar};

pub(super) const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Writes a message as a frame into `frame` and returns the bytes to send.
///
/// Capacities `M` and `J` whose messages could outgrow [`FRAME_MAX`] do not compile.
///
/// # Errors
/// Returns an error if the frame does not fit; [`FRAME_MAX`] bytes always suffice.
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
    const {
        assert!(
            frame_max(M, J) <= FRAME_MAX,
            "a message can outgrow a frame"
        )
    };
    seal::<FRAME_MAX>(version, message, frame)
}

/// Encodes a message of any protocol as a frame of at most `N` bytes.
pub(crate) fn seal<'f, const N: usize>(
    version: u8,
    message: &impl Serialize,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    let capacity = frame.len();
    let too_long = FrameTooLong { capacity };
    let mut plain = [0; N];
    plain[0] = version;
    let body = postcard::to_slice(message, &mut plain[1..N - 4]).map_err(|_| too_long)?;
    let end = 1 + body.len();
    let checksum = CHECKSUM.checksum(&plain[..end]).to_le_bytes();
    plain[end..end + 4].copy_from_slice(&checksum);
    let plain = &plain[..end + 4];
    if 1 + cobs::max_encoding_length(plain.len()) + 1 > capacity {
        return Err(too_long);
    }
    frame[0] = 0;
    let encoded = cobs::encode(plain, &mut frame[1..]);
    frame[1 + encoded] = 0;
    Ok(&frame[..encoded + 2])
}

/// Finds messages in a stream of bytes. `N` is the length of the longest frame that it accepts.
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
    pub fn push<T: Scalar, const M: usize, const J: usize>(
        &mut self,
        byte: u8,
    ) -> Option<Result<Message<T, M, J>, FrameError>> {
        self.push_of(PROTOCOL_VERSION, byte)
    }

    /// Takes a byte of a protocol with messages of any type.
    pub(crate) fn push_of<D: DeserializeOwned>(
        &mut self,
        version: u8,
        byte: u8,
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
            decode(version, &mut self.buffer)
        };
        self.buffer.clear();
        self.overflowed = false;
        match &outcome {
            Ok(_) => count(&mut self.counters.messages),
            Err(error) => self.counters.note(*error),
        }
        Some(outcome)
    }
}

/// Decodes a message from the bytes between two delimiters.
fn decode<D: DeserializeOwned>(expected: u8, frame: &mut [u8]) -> Result<D, FrameError> {
    let length = cobs::decode_in_place(frame).map_err(|_| FrameError::Malformed)?;
    let (plain, checksum) = frame[..length]
        .split_last_chunk::<4>()
        .ok_or(FrameError::Malformed)?;
    let (&version, body) = plain.split_first().ok_or(FrameError::Malformed)?;
    if CHECKSUM.checksum(plain) != u32::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
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
            FrameError::TooLong => &mut self.too_long,
            FrameError::Malformed => &mut self.malformed,
            FrameError::Checksum => &mut self.checksum,
            FrameError::Version { .. } => &mut self.version,
            FrameError::Message => &mut self.message,
        });
    }
}
