// SPDX-License-Identifier: MIT OR Apache-2.0
//! The layout of a MAVLink 2 frame: named offsets and ranges, and the checksum seeds.
//!
//! ```text
//! | header, 10 bytes | payload, 0 to 255 bytes | checksum, 2 bytes | signature, 0 or 13 bytes |
//! ```

use core::ops::Range;

use mavlink::dialects::common::{self, MavMessage};
use mavlink::{Message, MessageData};

/// The first byte of a MAVLink 2 frame.
pub(super) const START: u8 = 0xFD;
/// The number of bytes before the payload, the start byte included.
pub(super) const HEADER: usize = 10;
/// The number of bytes of the checksum, which follows the payload.
pub(super) const CHECKSUM: usize = 2;
/// The number of bytes of the signature, which follows the checksum of a signed frame.
pub(super) const SIGNATURE: usize = 13;
/// The largest payload, bytes.
pub(super) const MAX_PAYLOAD: usize = 255;
/// The longest frame, bytes: header, payload of 255 bytes, checksum and signature.
pub const MAX_FRAME: usize = HEADER + MAX_PAYLOAD + CHECKSUM + SIGNATURE;

/// The incompatibility flag of a signed frame. A receiver must drop frames with any other flag.
pub(super) const SIGNED: u8 = 0x01;

/// Offsets and ranges of the fields of a frame.
pub(super) mod field {
    use super::{HEADER, MAX_PAYLOAD, Range};

    pub(in super::super) const START: usize = 0;
    pub(in super::super) const LENGTH: usize = 1;
    pub(in super::super) const INCOMPATIBILITY_FLAGS: usize = 2;
    pub(in super::super) const COMPATIBILITY_FLAGS: usize = 3;
    pub(in super::super) const SEQUENCE: usize = 4;
    pub(in super::super) const SYSTEM: usize = 5;
    pub(in super::super) const COMPONENT: usize = 6;
    pub(in super::super) const MESSAGE_ID: Range<usize> = 7..HEADER;
    /// The payload where it has its largest length.
    pub(in super::super) const LARGEST_PAYLOAD: Range<usize> = HEADER..HEADER + MAX_PAYLOAD;

    /// Returns the payload of `length` bytes.
    pub(in super::super) const fn payload(length: usize) -> Range<usize> {
        HEADER..HEADER + length
    }

    /// Returns what the checksum covers of a frame with a payload of `length` bytes: everything
    /// behind the start byte.
    pub(in super::super) const fn checked(length: usize) -> Range<usize> {
        LENGTH..HEADER + length
    }

    /// Returns the checksum of a frame with a payload of `length` bytes.
    pub(in super::super) const fn checksum(length: usize) -> Range<usize> {
        HEADER + length..HEADER + length + super::CHECKSUM
    }
}

/// Offsets and ranges of the fields of a signature.
pub(super) mod signature {
    use super::{Range, SIGNATURE};

    pub(in super::super) const LINK: usize = 0;
    pub(in super::super) const TIME: Range<usize> = 1..7;
    /// Link and time, which the digest covers.
    pub(in super::super) const LINK_AND_TIME: Range<usize> = LINK..TIME.end;
    pub(in super::super) const DIGEST: Range<usize> = 7..SIGNATURE;
}

/// ArduPilot's message EKF_STATUS_REPORT, which MAVLink's `common` dialect does not have.
pub mod ekf_status_report {
    use super::Range;

    /// The id of the message.
    pub const ID: u32 = 193;
    /// The name of the message.
    pub const NAME: &str = "EKF_STATUS_REPORT";
    /// The seed of its checksum.
    pub(in super::super) const CHECKSUM_SEED: u8 = 71;
    /// The place of its flags, a `u16`, in the payload.
    pub(in super::super) const FLAGS: Range<usize> = 20..22;
}

/// The only message whose checksum seed is 0 (a test verifies this).
#[allow(deprecated)] // still sent by autopilots
pub(super) const SEED_ZERO: u32 = common::COMPONENT_INFORMATION_DATA::ID;

/// Returns the message id in a header.
pub(super) fn message_id(header: &[u8; HEADER]) -> u32 {
    let mut id = [0; 4];
    id[..field::MESSAGE_ID.len()].copy_from_slice(&header[field::MESSAGE_ID]);
    u32::from_le_bytes(id)
}

/// Returns the checksum seed of a message, or `None` if the message is not known.
pub(super) fn checksum_seed(id: u32) -> Option<u8> {
    if id == ekf_status_report::ID {
        return Some(ekf_status_report::CHECKSUM_SEED);
    }
    // The crate answers 0 for unknown ids, too. Asking it for the message itself would take every
    // message's defaults into a target's flash.
    let seed = MavMessage::extra_crc(id);
    (seed != 0 || id == SEED_ZERO).then_some(seed)
}
