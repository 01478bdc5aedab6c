// SPDX-License-Identifier: MIT OR Apache-2.0
//! Counters that saturate.

use serde::{Deserialize, Serialize};

/// Adds one to a counter, which stays at its largest value.
#[cfg(any(feature = "autopilot", feature = "policy"))]
pub(crate) fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

/// Counters of what a decoder of MAVLink has received. Each counter stays at its largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct MavlinkCounters {
    /// Frames with a correct checksum.
    pub frames: u32,
    /// Candidates with a wrong checksum.
    pub bad_checksum: u32,
    /// Frames of a message that is not in the dialect; their checksum cannot be verified.
    pub unknown_message: u32,
    /// Frames with an unknown incompatibility flag.
    pub unknown_flags: u32,
    /// Bytes that belonged to no frame.
    pub skipped_bytes: u32,
    /// Good frames that were dropped because they came twice or after a later one of the same
    /// sender (the decoder's `in_order`).
    pub out_of_order: u32,
    /// Good frames without a signature where one is required.
    pub unsigned: u32,
    /// Good frames with a wrong signature.
    pub bad_signature: u32,
    /// Frames with a valid signature that are too old, such as replayed ones.
    pub replayed: u32,
}

impl MavlinkCounters {
    /// Returns the number of good frames that were refused because of their signature, or because
    /// they had none.
    pub fn refused(&self) -> u32 {
        [self.unsigned, self.bad_signature, self.replayed]
            .into_iter()
            .fold(0, u32::saturating_add)
    }
}
