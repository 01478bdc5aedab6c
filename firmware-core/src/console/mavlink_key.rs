// SPDX-License-Identifier: MIT OR Apache-2.0
//! The part of an order that makes a board sign its MAVLink frames.

use serde::{Deserialize, Serialize};

use crate::autopilot::wire::signing::{LinkSigning, SigningKey, SigningState};

/// The key of MAVLink signing, and where the signatures go on. A board has no clock of its own that
/// shows a date: it starts at the time of the state, and takes over the times of accepted frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MavlinkKey {
    /// The key. It crosses the console in plain text.
    #[serde(with = "key")]
    pub key: SigningKey,
    /// The link id of the frames that the board sends.
    pub link: u8,
    /// The state that the board reported after its last flight, or the time of the bench's clock.
    pub state: SigningState,
}

impl From<LinkSigning> for MavlinkKey {
    fn from(signing: LinkSigning) -> Self {
        let LinkSigning { key, link, state } = signing;
        Self { key, link, state }
    }
}

impl From<MavlinkKey> for LinkSigning {
    fn from(ordered: MavlinkKey) -> Self {
        let MavlinkKey { key, link, state } = ordered;
        Self { key, link, state }
    }
}

/// The bytes of a key, only here: no other message contains one.
mod key {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::SigningKey;

    pub(super) fn serialize<S: Serializer>(key: &SigningKey, to: S) -> Result<S::Ok, S::Error> {
        key.bytes().serialize(to)
    }

    pub(super) fn deserialize<'d, D: Deserializer<'d>>(from: D) -> Result<SigningKey, D::Error> {
        <[u8; 32]>::deserialize(from).map(SigningKey::new)
    }
}
