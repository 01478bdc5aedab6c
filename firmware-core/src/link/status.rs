// SPDX-License-Identifier: MIT OR Apache-2.0
//! The vehicle's report about itself, sent once a slot: counters of everything that was received,
//! dropped or missing.
//!
//! Counters start at 0 when the vehicle starts, never decrease, and stay at their largest value.
//! They are consistent:
//!
//! * every delimited piece of the ground link is one of [`LinkCounters`] or, where the link is
//!   authenticated, of [`SecurityCounters`];
//! * every good message is used, or is one of `states_out_of_turn`, `states_of_wrong_size`,
//!   `changes_out_of_turn` and `echoes`: `messages = measured + states_out_of_turn +
//!   states_of_wrong_size + changes + changes_out_of_turn + echoes`, one more for each quality of
//!   channel estimates that was taken, and one more while a state waits to be used;
//! * every slot is one of `measured` and `stale`: together they are the slots done.

use serde::{Deserialize, Serialize};

use crate::{counter::MavlinkCounters, policy::PlanQuality};

/// Counters of what a decoder of the ground link has received, one per outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct LinkCounters {
    /// Good frames.
    pub messages: u32,
    /// Longer than any frame.
    pub too_long: u32,
    /// Not COBS, or too short.
    pub malformed: u32,
    /// The CRC did not match.
    pub checksum: u32,
    /// Good, but of another protocol version.
    pub version: u32,
    /// Good, but no message of this protocol.
    pub message: u32,
}

impl LinkCounters {
    /// Returns the number of frames that were dropped for any reason.
    pub fn dropped(&self) -> u32 {
        [
            self.too_long,
            self.malformed,
            self.checksum,
            self.version,
            self.message,
        ]
        .into_iter()
        .fold(0, u32::saturating_add)
    }
}

/// Counters of what the authentication of the ground link has taken and refused. They are those of
/// one end, from its start on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SecurityCounters {
    /// Sessions that have begun. It is not a count of frames: the frame that begins a session is one
    /// of the handshake or a message.
    pub sessions: u32,
    /// Frames of the handshake that were taken.
    pub handshakes: u32,
    /// Frames without authentication.
    pub unauthenticated: u32,
    /// Frames whose tag does not match.
    pub forged: u32,
    /// Frames of another session, such as an earlier one, or made up.
    pub other_session: u32,
    /// Frames that came again, or after a later one.
    pub replayed: u32,
    /// Frames of a kind that only this end sends.
    pub reflected: u32,
}

impl SecurityCounters {
    /// Returns the number of frames that were refused for any reason.
    pub fn refused(&self) -> u32 {
        [
            self.unauthenticated,
            self.forged,
            self.other_session,
            self.replayed,
            self.reflected,
        ]
        .into_iter()
        .fold(0, u32::saturating_add)
    }
}

/// Counters of slots and of what the ground sent for them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct SlotCounters {
    /// Slots allocated from the channel state of that slot.
    pub measured: u32,
    /// Slots allocated from aged state, because none was received in time.
    pub stale: u32,
    /// Slots in which `Gamma` could not be guaranteed, and users were silent.
    pub infeasible: u32,
    /// Slots in which another user than planned was served, because the planned one was not heard.
    pub user_replaced: u32,
    /// Slots in which no user was served, because none was heard.
    pub nobody_served: u32,
    /// Sensors that were not heard, summed over the slots.
    pub unheard_sensors: u32,
    /// Gains that were NaN, infinite, negative or above 1, summed over the slots.
    pub rejected_gains: u32,
    /// Channel states that belonged to another slot, came twice or came too late, and qualities of
    /// channel estimates that were older than the last one or of a slot to come.
    pub states_out_of_turn: u32,
    /// Channel states, and qualities of channel estimates, with a wrong number of entries.
    pub states_of_wrong_size: u32,
    /// Changes of the mission that were taken, which is the number of the last one.
    pub changes: u32,
    /// Changes of these that were refused when they would have come into effect: the mission would
    /// have been invalid.
    pub changes_refused: u32,
    /// Changes that came again, before their turn, or while too many waited for their slot.
    pub changes_out_of_turn: u32,
    /// Messages that only the vehicle sends.
    pub echoes: u32,
    /// Arrivals that were sent again because no channel state was received.
    pub arrivals_repeated: u32,
    /// Messages that were replaced by newer ones before they were sent.
    pub unsent: u32,
}

/// The vehicle's counters, and the quality of its plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VehicleStatus {
    /// Slots done.
    pub slots_done: u32,
    /// Slots and channel states.
    pub slots: SlotCounters,
    /// The ground link, as received by the vehicle.
    pub link: LinkCounters,
    /// MAVLink, as received by the vehicle.
    pub mavlink: MavlinkCounters,
    /// MAVLink frames with a correct checksum whose message could not be decoded.
    pub mavlink_unreadable: u32,
    /// The quality of the plan for the slots that are left, if the policy has a plan.
    pub plan: Option<PlanQuality>,
}

impl VehicleStatus {
    /// The number of counters.
    pub(super) const COUNTERS: usize = 1 + 15 + 6 + 9 + 1;
}
