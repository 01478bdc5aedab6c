//! What the vehicle tells of itself once a slot: counters of everything that came, was dropped or
//! was done without.
//!
//! Counters start at 0 with the vehicle, only rise, and stay at their largest value. They add up:
//!
//! * every delimited piece of the ground link is one of [`LinkCounters`];
//! * every good message is used, or is one of `states_out_of_turn`, `states_of_wrong_size` and
//!   `echoes`: `messages = measured + states_out_of_turn + states_of_wrong_size + echoes`, and
//!   one more while a state waits to be used;
//! * every slot is one of `measured` and `stale`: together they are the slots done.

use serde::{Deserialize, Serialize};

use super::FrameError;
use crate::autopilot::wire;
use crate::counter::count;

/// What a decoder of the ground link has seen: one counter per outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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
    /// Frames that were dropped, for whatever reason.
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

    pub(super) fn note(&mut self, error: FrameError) {
        count(match error {
            FrameError::TooLong => &mut self.too_long,
            FrameError::Malformed => &mut self.malformed,
            FrameError::Checksum => &mut self.checksum,
            FrameError::Version { .. } => &mut self.version,
            FrameError::Message => &mut self.message,
        });
    }
}

/// What became of slots and of what the ground sent for them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SlotCounters {
    /// Slots allocated from channel state of that slot.
    pub measured: u32,
    /// Slots allocated from aged state, because none came in time.
    pub stale: u32,
    /// Slots in which `Gamma` could not be promised, and users were silent.
    pub infeasible: u32,
    /// Slots in which another user was served than planned: the planned one was not heard.
    pub user_replaced: u32,
    /// Slots in which nobody was served: no user was heard.
    pub nobody_served: u32,
    /// Sensors that were not heard, summed over the slots.
    pub unheard_sensors: u32,
    /// Gains that were NaN, infinite, negative or above 1, summed over the slots.
    pub rejected_gains: u32,
    /// Channel states that were about another slot, came twice or came too late.
    pub states_out_of_turn: u32,
    /// Channel states with a wrong number of gains.
    pub states_of_wrong_size: u32,
    /// Messages that only the vehicle sends.
    pub echoes: u32,
    /// Arrivals that were sent again because no channel state had come.
    pub arrivals_repeated: u32,
    /// Messages that gave way to newer ones before they were fetched.
    pub unsent: u32,
}

/// The vehicle's counters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VehicleStatus {
    /// Slots done.
    pub slots_done: u32,
    /// Slots and channel states.
    pub slots: SlotCounters,
    /// The ground link, as the vehicle received it.
    pub link: LinkCounters,
    /// MAVLink, as the vehicle received it.
    pub mavlink: wire::Counters,
    /// Sound MAVLink frames whose message could not be read.
    pub mavlink_unreadable: u32,
}

impl VehicleStatus {
    /// How many counters there are.
    pub(super) const COUNTERS: usize = 1 + 12 + 6 + 9 + 1;
}
