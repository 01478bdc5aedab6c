// SPDX-License-Identifier: MIT OR Apache-2.0
//! MAVLink 2 on the wire: bytes to messages and back, without allocation.
//!
//! [`Decoder`] takes bytes in pieces of any size and returns complete frames with a correct
//! checksum. Everything else that arrives (noise, incomplete frames, MAVLink 1, unknown dialects)
//! is skipped and counted in [`MavlinkCounters`](crate::counter::MavlinkCounters); it never ends the stream. On a datagram link the caller
//! marks the end of each datagram with [`Decoder::end_of_datagram`], so that a truncated datagram
//! does not hold back the frames after it. [`Encoder`] is the counterpart.
//!
//! Messages are those of MAVLink's `common` dialect plus one: ArduPilot reports its position
//! estimate in EKF_STATUS_REPORT (193), which `common` does not have. Its flags have the same bits
//! as those of ESTIMATOR_STATUS (230), so it is returned as that message and the client handles
//! one form only.

mod client;
mod decoder;
mod encoder;
mod frame;
mod layout;
mod sequence_tracker;
pub mod signing;

pub use decoder::Decoder;
pub use encoder::{Encoder, FrameBuffer};
pub use frame::{Address, Frame, status_text};
pub use layout::{MAX_FRAME, ekf_status_report};

#[cfg(test)]
mod tests;
