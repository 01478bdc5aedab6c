// SPDX-License-Identifier: MIT OR Apache-2.0
//! Signatures of received frames.

use super::super::{
    frame::Frame,
    layout::{
        SIGNATURE,
        signature::{DIGEST, LINK, LINK_AND_TIME, TIME},
    },
};
use super::{
    key::{SigningKey, are_equal},
    state::{SigningState, StreamTime},
    time::SigningTime,
};

/// Verifies the signatures of received frames.
#[derive(Clone, Debug)]
pub struct Verifier {
    key: SigningKey,
    state: SigningState,
}

/// The result of verifying a frame's signature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Verdict {
    Valid,
    Unsigned,
    Wrong,
    Replayed,
}

impl Verifier {
    /// Creates a verifier that goes on from `state`.
    pub fn new(key: SigningKey, state: &SigningState) -> Self {
        let mut own = SigningState::default();
        own.merge(state);
        Self { key, state: own }
    }

    /// Sets the local time, which never goes back.
    pub fn advance_to(&mut self, time: SigningTime) {
        self.state.advance(time);
    }

    /// Returns the local time and the replay state, to save them.
    pub fn state(&self) -> &SigningState {
        &self.state
    }

    /// Replaces `older`. With the same key, its replay state is kept.
    pub(in super::super) fn continue_from(&mut self, older: &Self) {
        if self.key == older.key {
            self.state.merge(&older.state);
        }
    }

    /// Returns whether a frame is accepted. Only an accepted frame changes anything. Costs at most
    /// one SHA-256 over 32 bytes and the frame, and a search over the streams.
    pub(in super::super) fn verify(&mut self, frame: &Frame<'_>) -> Verdict {
        let Some((signed, tail)) = frame.bytes().split_last_chunk::<SIGNATURE>() else {
            return Verdict::Unsigned;
        };
        if !frame.is_signed() {
            return Verdict::Unsigned;
        }
        let expected = self.key.digest(signed, &tail[LINK_AND_TIME]);
        if !are_equal(&expected, &tail[DIGEST]) {
            return Verdict::Wrong;
        }
        let units = tail[TIME].iter().rev();
        let units = units.fold(0, |all, byte| all << 8 | u64::from(*byte));
        // It has 48 bits.
        let Ok(time) = SigningTime::from_units(units) else {
            return Verdict::Wrong;
        };
        match self.state.note(&StreamTime {
            link: tail[LINK],
            sender: frame.sender(),
            time,
        }) {
            Some(true) => Verdict::Valid,
            Some(false) => Verdict::Replayed,
            None => Verdict::Wrong,
        }
    }
}
