// SPDX-License-Identifier: MIT OR Apache-2.0
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
//! An [`Endpoint`] with [`Credentials`] authenticates the link: each frame then carries a nonce, a
//! counter and a tag (`docs/link-protocol.md`), and all others are counted and dropped.
//!
//! Worst case without authentication: one pass over a frame of at most [`FRAME_MAX`] bytes.
//!
//! ```
//! use firmware_core::{
//!     PowerGain,
//!     controller::ChannelState,
//!     link::{Decoder, FRAME_MAX, Message, encode},
//! };
//!
//! let state = Message::<f32, 16, 64>::ChannelState(ChannelState {
//!     slot: 7,
//!     user_gains: [PowerGain(2e-12)].into_iter().collect(),
//!     sensor_gains: [PowerGain(4e-12), PowerGain(3e-12)].into_iter().collect(),
//! });
//! let mut frame = [0; FRAME_MAX];
//! let frame = encode(&state, &mut frame)?;
//! // Noise before the frame, and a byte of it lost in a first attempt.
//! let stream = [&[1, 2, 3], &frame[..5], &frame[6..], frame].concat();
//! let mut decoder = Decoder::<FRAME_MAX>::new();
//! let received = stream.iter().filter_map(|&byte| decoder.push::<f32, 16, 64>(byte)?.ok());
//! assert_eq!(received.collect::<Vec<_>>(), [state]);
//! # Ok::<(), firmware_core::link::FrameTooLong>(())
//! ```

mod byte_stuffing;
mod endpoint;
mod error;
mod frame;
pub(crate) mod length;
mod message;
mod security;
pub mod status;

pub use endpoint::Endpoint;
pub use error::{EncodeError, FrameError, FrameTooLong, Refusal};
#[cfg(all(feature = "autopilot", feature = "planner"))]
pub(crate) use frame::seal;
pub use frame::{Decoder, encode, encode_as};
pub use message::{
    Arrival, FRAME_MAX, HANDSHAKE_FRAME_MAX, Message, NumberedChange, PROTOCOL_VERSION,
    SECURE_VERSION, frame_max, secure_frame_max,
};
pub use security::{Credentials, GroundKey};
pub use status::{LinkCounters, SecurityCounters, SlotCounters, VehicleStatus};

#[cfg(test)]
mod tests;
