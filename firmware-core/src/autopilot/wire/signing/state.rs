// SPDX-License-Identifier: MIT OR Apache-2.0
//! What has to survive a restart.

use serde::{Deserialize, Serialize};

use super::super::frame::Address;
use super::time::SigningTime;

/// The number of streams whose times are tracked at once. A stream is forgotten as soon as it is
/// more than a minute behind the local time, because all its frames up to there are refused as too
/// old; a frame of a further stream is refused.
pub const STREAMS_MAX: usize = 16;

/// The last time of a stream: the frames of one sender over one link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamTime {
    /// The link id in the frames.
    pub link: u8,
    /// The sender of the frames.
    pub sender: Address,
    /// The time of the last accepted frame.
    pub time: SigningTime,
}

/// The local time of signatures and the replay state of each stream. With it, a restarted receiver
/// refuses every frame that it would have refused before.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SigningState {
    /// The latest time that was signed, accepted or set.
    pub time: SigningTime,
    /// The streams with frames that are not too old, in no particular order.
    pub streams: heapless::Vec<StreamTime, STREAMS_MAX>,
}

impl SigningState {
    /// Returns the state of a receiver that has accepted no frame yet and whose clock shows `time`.
    pub const fn at(time: SigningTime) -> Self {
        Self {
            time,
            streams: heapless::Vec::new(),
        }
    }

    /// Takes over a later time, and returns whether it was later.
    pub(super) fn advance(&mut self, time: SigningTime) -> bool {
        let is_later = time > self.time;
        self.time = self.time.max(time);
        is_later
    }

    /// Notes a frame, and returns whether it is neither too old nor replayed. `None`: there is no
    /// memory for its stream; nothing has changed.
    pub(super) fn note(&mut self, frame: &StreamTime) -> Option<bool> {
        if frame.time.is_stale(self.time) {
            return Some(false);
        }
        let is_same = |known: &StreamTime| (known.link, known.sender) == (frame.link, frame.sender);
        match self.streams.iter_mut().find(|known| is_same(known)) {
            Some(known) if frame.time <= known.time => return Some(false),
            Some(known) => known.time = frame.time,
            None => {
                if self.streams.is_full() {
                    let now = self.time;
                    self.streams.retain(|known| !known.time.is_stale(now));
                }
                self.streams.push(*frame).ok()?;
            }
        }
        self.advance(frame.time);
        Some(true)
    }

    /// Adds what another state has seen: no frame that either refuses is accepted afterwards. If
    /// there are more streams than [`STREAMS_MAX`], the time advances until the frames of the others
    /// are too old.
    pub(super) fn merge(&mut self, other: &Self) {
        self.advance(other.time);
        for stream in &other.streams {
            if self.note(stream).is_none() {
                self.advance(stream.time.stale_from());
            }
        }
    }
}
