// SPDX-License-Identifier: MIT OR Apache-2.0
//! Detection of duplicated and reordered frames.

use super::frame::Address;

/// The number of senders whose sequence numbers are tracked.
const SENDERS: usize = 8;
/// A sequence number that is behind the last one by no more than this is late. If it is further
/// behind, the sender has restarted or many frames were lost.
const LATE: u8 = 32;

/// Tracks the last sequence number of each sender. A heartbeat carries no time: one that was
/// overtaken on the way would report a mode that the vehicle has left.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SequenceTracker {
    last: [Option<(Address, u8)>; SENDERS],
    next: usize,
}

impl SequenceTracker {
    /// Creates a tracker that knows no sender.
    pub(super) const fn new() -> Self {
        Self {
            last: [None; SENDERS],
            next: 0,
        }
    }

    /// Records a frame. Returns true if the frame is a duplicate or was overtaken.
    pub(super) fn is_late(&mut self, sender: Address, sequence: u8) -> bool {
        for (known, last) in self.last.iter_mut().flatten() {
            if *known == sender {
                let late = last.wrapping_sub(sequence) <= LATE;
                if !late {
                    *last = sequence;
                }
                return late;
            }
        }
        self.last[self.next % SENDERS] = Some((sender, sequence));
        self.next = (self.next + 1) % SENDERS;
        false
    }
}
