//! The ground link: channel state in, slot commands out, over any stream of bytes.
//!
//! A frame is `COBS( version | postcard(message) | CRC-32 ) 0x00`:
//!
//! | part | bytes | |
//! |---|---|---|
//! | version | 1 | [`PROTOCOL_VERSION`]; a frame of another version is counted and dropped |
//! | message | varies | a [`Message`] in postcard's encoding |
//! | CRC | 4, little endian | CRC-32/ISO-HDLC over version and message |
//! | delimiter | 1 | `0x00`, which COBS keeps out of everything before it |
//!
//! A receiver that lost or misread bytes is in step again at the next delimiter: whatever
//! happens to a frame, the one after it arrives. [`Decoder`] never panics and never allocates;
//! it counts what it dropped and why.
//!
//! Worst case: one pass over a frame of at most [`FRAME_MAX`] bytes.

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{
    controller::{ChannelState, Plan, SlotCommand},
    scalar::{Position, Scalar},
};

/// The version that this crate speaks. Any change of a message is a new one.
pub const PROTOCOL_VERSION: u8 = 1;

/// The longest frame at the default capacities in double precision, delimiter included: 80
/// gains of 8 bytes, what goes with them, the CRC, and one byte in 254 for COBS.
pub const FRAME_MAX: usize = 768;

const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// What the ground and the vehicle say to one another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
#[allow(clippy::large_enum_variant)] // no allocator: every message takes the room of the largest
pub enum Message<T: Scalar, const M: usize, const J: usize> {
    /// To the vehicle: the channels of a slot, at the position that it reported.
    ChannelState(ChannelState<T, M, J>),
    /// To the ground: a slot is flown, measure its channels.
    Arrival(Arrival<T>),
    /// To the ground: what users and sensors do in a slot.
    Command(SlotCommand<T, J>),
}

/// The vehicle is at the end of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct Arrival<T: Scalar> {
    /// What was planned: slot, waypoint, user.
    pub plan: Plan<T>,
    /// Where the vehicle measured itself to be, metres.
    pub position: Position<T>,
}

/// The buffer for a frame is too small.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a frame does not fit into {capacity} bytes")]
pub struct FrameTooLong {
    /// What there was.
    pub capacity: usize,
}

/// Writes a message as a frame into `frame` and returns the bytes to send.
///
/// # Errors
/// The frame does not fit; [`FRAME_MAX`] bytes always suffice at the default capacities.
pub fn encode<'f, T: Scalar, const M: usize, const J: usize>(
    message: &Message<T, M, J>,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    let capacity = frame.len();
    let too_long = FrameTooLong { capacity };
    let mut plain = [0; FRAME_MAX];
    plain[0] = PROTOCOL_VERSION;
    let body = postcard::to_slice(message, &mut plain[1..FRAME_MAX - 4]).map_err(|_| too_long)?;
    let end = 1 + body.len();
    let checksum = CHECKSUM.checksum(&plain[..end]).to_le_bytes();
    plain[end..end + 4].copy_from_slice(&checksum);
    let plain = &plain[..end + 4];
    if cobs::max_encoding_length(plain.len()) + 1 > capacity {
        return Err(too_long);
    }
    let encoded = cobs::encode(plain, frame);
    frame[encoded] = 0;
    Ok(&frame[..=encoded])
}

/// Why bytes between two delimiters were no message.
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
    /// Another version.
    #[error("protocol version {got}, but this is {PROTOCOL_VERSION}")]
    Version {
        /// Which.
        got: u8,
    },
    /// A sound frame whose message cannot be read: too many gains, say.
    #[error("not a message of this protocol")]
    Message,
}

/// What a decoder has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs)] // one counter per outcome
pub struct LinkCounters {
    pub messages: u32,
    pub too_long: u32,
    pub malformed: u32,
    pub checksum: u32,
    pub version: u32,
    pub message: u32,
}

impl LinkCounters {
    /// Frames that were dropped, for whatever reason.
    pub fn dropped(&self) -> u32 {
        self.too_long + self.malformed + self.checksum + self.version + self.message
    }

    fn count(&mut self, error: FrameError) {
        let counter = match error {
            FrameError::TooLong => &mut self.too_long,
            FrameError::Malformed => &mut self.malformed,
            FrameError::Checksum => &mut self.checksum,
            FrameError::Version { .. } => &mut self.version,
            FrameError::Message => &mut self.message,
        };
        *counter = counter.saturating_add(1);
    }
}

/// Finds messages in a stream of bytes. `N` is the longest frame that it takes.
#[derive(Clone, Debug, Default)]
pub struct Decoder<const N: usize = FRAME_MAX> {
    buffer: Vec<u8, N>,
    overflowed: bool,
    counters: LinkCounters,
}

impl<const N: usize> Decoder<N> {
    /// Nothing received yet.
    pub fn new() -> Self {
        Self {
            buffer: Vec::new(),
            overflowed: false,
            counters: LinkCounters::default(),
        }
    }

    /// What was seen so far.
    pub fn counters(&self) -> &LinkCounters {
        &self.counters
    }

    /// Takes a byte. At the end of a frame: its message, or why it has none.
    pub fn push<T: Scalar, const M: usize, const J: usize>(
        &mut self,
        byte: u8,
    ) -> Option<Result<Message<T, M, J>, FrameError>> {
        if byte != 0 {
            self.overflowed |= self.buffer.push(byte).is_err();
            return None;
        }
        let outcome = if self.overflowed {
            Err(FrameError::TooLong)
        } else if self.buffer.is_empty() {
            // Two delimiters in a row: idle line, or a sender that starts with one.
            return None;
        } else {
            decode(&mut self.buffer)
        };
        self.buffer.clear();
        self.overflowed = false;
        match &outcome {
            Ok(_) => self.counters.messages = self.counters.messages.saturating_add(1),
            Err(error) => self.counters.count(*error),
        }
        Some(outcome)
    }
}

/// A message from the bytes between two delimiters.
fn decode<T: Scalar, const M: usize, const J: usize>(
    frame: &mut [u8],
) -> Result<Message<T, M, J>, FrameError> {
    let length = cobs::decode_in_place(frame).map_err(|_| FrameError::Malformed)?;
    let (plain, checksum) = frame[..length]
        .split_last_chunk::<4>()
        .ok_or(FrameError::Malformed)?;
    let (&version, body) = plain.split_first().ok_or(FrameError::Malformed)?;
    if CHECKSUM.checksum(plain) != u32::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
    if version != PROTOCOL_VERSION {
        return Err(FrameError::Version { got: version });
    }
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError::Message),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Watt, controller::ChannelSource, inner::*, shield::Intervention, test_missions::table_one,
        units::PowerGain,
    };
    use proptest::prelude::*;
    use std::vec::Vec as StdVec;

    type HostMessage = Message<f64, 16, 64>;

    fn channel_state(slot: u32) -> HostMessage {
        let mission = table_one::<f64>();
        Message::ChannelState(ChannelState::predicted(
            &mission,
            slot,
            &Position::new(400.0, 300.0),
        ))
    }

    fn largest_command() -> HostMessage {
        Message::Command(SlotCommand {
            slot: u32::MAX,
            served_user: 15,
            user_power: Watt(0.2),
            sensor_coefficients: (0..64).map(|_| 0.123_456_789).collect(),
            normalizing_factor: 1e6,
            rate: 1.0,
            mse: 0.015,
            status: Status::Infeasible { least_mse: 0.016 },
            source: ChannelSource::Measured,
            rejected_gains: 64,
        })
    }

    fn largest_state() -> HostMessage {
        Message::ChannelState(ChannelState {
            slot: u32::MAX,
            user_gains: (0..16).map(|_| PowerGain(1e-12)).collect(),
            sensor_gains: (0..64).map(|_| PowerGain(1.1e-11)).collect(),
        })
    }

    fn frame(message: &HostMessage) -> StdVec<u8> {
        let mut buffer = [0; FRAME_MAX];
        encode(message, &mut buffer).unwrap().to_vec()
    }

    fn receive(bytes: &[u8]) -> (StdVec<Result<HostMessage, FrameError>>, LinkCounters) {
        let mut decoder = Decoder::<FRAME_MAX>::new();
        let seen = bytes
            .iter()
            .filter_map(|&byte| decoder.push(byte))
            .collect();
        (seen, *decoder.counters())
    }

    #[test]
    fn messages_survive_and_fit() {
        for message in [channel_state(7), largest_command(), largest_state()] {
            let bytes = frame(&message);
            assert!(bytes.len() <= FRAME_MAX);
            assert_eq!(receive(&bytes).0, [Ok(message)]);
        }
    }

    /// The bytes of a frame are a format: a change of them is a new version.
    #[test]
    fn the_format_is_stable() {
        let message: HostMessage = Message::Arrival(Arrival {
            plan: Plan {
                slot: 300,
                waypoint: Position::new(1.0, -2.0),
                served_user: 3,
                intervention: Intervention {
                    user: true,
                    ..Intervention::default()
                },
            },
            position: Position::new(1.0, -2.5),
        });
        assert_eq!(
            frame(&message),
            [
                5, 1, 1, 172, 2, 1, 1, 1, 1, 1, 3, 240, 63, 1, 1, 1, 1, 1, 1, 3, 192, 3, 2, 1, 1,
                1, 1, 1, 1, 1, 1, 3, 240, 63, 1, 1, 1, 1, 1, 7, 4, 192, 239, 239, 176, 227, 0
            ]
        );
    }

    #[test]
    fn too_small_a_buffer_is_an_error() {
        assert_eq!(
            encode(&channel_state(1), &mut [0; 64]),
            Err(FrameTooLong { capacity: 64 })
        );
    }

    #[test]
    fn another_version_is_named() {
        let mut plain = [2u8, 9, 9, 0, 0, 0, 0];
        let checksum = CHECKSUM.checksum(&plain[..3]).to_le_bytes();
        plain[3..].copy_from_slice(&checksum);
        let mut bytes = [0; 16];
        let length = cobs::encode(&plain, &mut bytes);
        assert_eq!(
            receive(&bytes[..=length]).0,
            [Err(FrameError::Version { got: 2 })]
        );
    }

    #[test]
    fn a_flood_is_dropped_and_the_next_frame_arrives() {
        let mut bytes = std::vec![7u8; 10 * FRAME_MAX];
        bytes.push(0);
        bytes.extend(frame(&channel_state(1)));
        let (seen, counters) = receive(&bytes);
        assert_eq!(seen, [Err(FrameError::TooLong), Ok(channel_state(1))]);
        assert_eq!((counters.messages, counters.dropped()), (1, 1));
    }

    proptest! {
        /// Damage costs the frames it touches and no other.
        #[test]
        fn damage_is_contained(
            cut in 0usize..400,
            inserted in proptest::collection::vec(any::<u8>(), 0..40),
            flips in proptest::collection::vec((0usize..400, 0u8..8), 0..4),
        ) {
            let mut bytes = frame(&channel_state(1));
            for (index, bit) in flips {
                let index = index % bytes.len();
                bytes[index] ^= 1 << bit;
            }
            let cut = cut % bytes.len();
            bytes.splice(cut..cut, inserted);
            bytes.push(0);
            bytes.extend(frame(&channel_state(2)));
            let (seen, _) = receive(&bytes);
            prop_assert_eq!(seen.last(), Some(&Ok(channel_state(2))));
            for outcome in &seen[..seen.len() - 1] {
                prop_assert!(outcome.is_err() || *outcome == Ok(channel_state(1)));
            }
        }

        #[test]
        fn noise_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..3000)) {
            let (_, counters) = receive(&bytes);
            prop_assert_eq!(counters.messages, 0);
        }
    }
}
