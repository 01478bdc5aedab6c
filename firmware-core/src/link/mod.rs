//! The ground link: channel state in, slot commands out, over any stream of bytes.
//!
//! A frame is `0x00 COBS( version | postcard(message) | CRC-32 ) 0x00`:
//!
//! | part | bytes | |
//! |---|---|---|
//! | delimiter | 1 | `0x00`: a frame whose end was lost does not take the next one with it |
//! | version | 1 | [`PROTOCOL_VERSION`]; a frame of another version is counted and dropped |
//! | message | varies | a [`Message`] in postcard's encoding |
//! | CRC | 4, little endian | CRC-32/ISO-HDLC over version and message |
//! | delimiter | 1 | `0x00`, which COBS keeps out of everything before it |
//!
//! A receiver that lost or misread bytes is synchronized again at the next delimiter: damage
//! affects only the frames that it touches. [`Decoder`] never panics and never allocates; it counts
//! what it dropped and why ([`status`]).
//!
//! Worst case: one pass over a frame of at most [`FRAME_MAX`] bytes.

pub mod status;

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::Vec;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    SENSORS_MAX, USERS_MAX,
    autopilot::Tick,
    controller::{ChannelState, Plan, SlotCommand},
    scalar::{Position, Scalar},
};
pub use status::{LinkCounters, SlotCounters, VehicleStatus};

/// The protocol version of this crate. Any change of a message needs a new version.
pub const PROTOCOL_VERSION: u8 = 3;

/// The longest frame at the default capacities, in double precision.
pub const FRAME_MAX: usize = frame_max(USERS_MAX, SENSORS_MAX);

/// Returns the length of the longest frame for up to so many users and sensors, in double
/// precision, delimiters included. Whether every message fits is checked at compile time: see
/// [`encode`].
pub const fn frame_max(users: usize, sensors: usize) -> usize {
    // postcard: integers in groups of 7 bits, enumerations and lengths as integers.
    const REAL: usize = 8;
    const U8: usize = 1;
    const U16: usize = 3;
    const U32: usize = 5;
    const U64: usize = 10;
    const INDEX: usize = 10;
    const LENGTH: usize = 3;
    const fn larger(a: usize, b: usize) -> usize {
        if a > b { a } else { b }
    }
    let state = U32 + LENGTH + users * REAL + LENGTH + sensors * REAL;
    let tick = 2 * U64 + U8 + REAL / 2;
    let arrival = (U32 + 2 * REAL + INDEX + 4 * U8) + 2 * REAL + tick;
    let reals = LENGTH + sensors * REAL + 4 * REAL;
    let command = U32 + (U8 + INDEX) + reals + (U8 + REAL) + U8 + U32 + 2 * U16;
    let status = VehicleStatus::COUNTERS * U32;
    let message = U8 + larger(larger(state, arrival), larger(command, status));
    let plain = 1 + message + 4;
    1 + cobs::max_encoding_length(plain) + 1
}

const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// A message between the ground and the vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
#[allow(clippy::large_enum_variant)] // no allocator: every message takes the room of the largest
pub enum Message<T: Scalar, const M: usize, const J: usize> {
    /// To the vehicle: the channels of a slot, measured at the reported position.
    ChannelState(ChannelState<T, M, J>),
    /// To the ground: a slot has been flown; its channels are to be measured.
    Arrival(Arrival<T>),
    /// To the ground: the transmissions of users and sensors in a slot.
    Command(SlotCommand<T, J>),
    /// To the ground, after every slot: the state of the vehicle.
    Status(VehicleStatus),
}

/// Reports that the vehicle is at the end of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct Arrival<T: Scalar> {
    /// The plan of the slot: number, waypoint, user.
    pub plan: Plan<T>,
    /// The measured position of the vehicle at the tick, metres.
    pub position: Position<T>,
    /// The time at which the slot ended, on the vehicle's clock, and how it was determined.
    pub tick: Tick,
}

/// Error returned when the buffer for a frame is too small.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a frame does not fit into {capacity} bytes")]
pub struct FrameTooLong {
    /// The size of the buffer, bytes.
    pub capacity: usize,
}

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

/// Error returned when the bytes between two delimiters are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
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
            Ok(_) => crate::counter::count(&mut self.counters.messages),
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

#[cfg(test)]
mod tests;
