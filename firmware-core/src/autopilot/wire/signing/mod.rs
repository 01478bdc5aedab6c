// SPDX-License-Identifier: MIT OR Apache-2.0
//! MAVLink 2 message signing: only a sender that knows the key is accepted.
//!
//! A signed frame ends with a link id, a time and the first 48 bits of SHA-256 over the key, the
//! frame and those two. The rules are those of
//! <https://mavlink.io/en/guide/message_signing.html>:
//!
//! * The times of each stream (sender and link id) increase. A frame whose time is not later than
//!   the last one of its stream is refused, and so is a frame that is more than a minute behind the
//!   local time.
//! * The local time is the latest of the clock that the caller sets, of the times of accepted
//!   frames, and of our own signatures. It never decreases. A vehicle without a clock therefore
//!   starts at [`SigningTime::UNKNOWN`] and has the time of its peers after the first accepted
//!   frame.
//! * Local time and streams survive a restart if the caller saves [`state`] and starts from it
//!   again. The specification asks for at least once a minute. Frames that were accepted after the
//!   last save can be replayed once after a restart.
//!
//! A link that signs has a [`Verifier`] in its [`Decoder`](super::Decoder) and a [`Signer`] in its
//! [`Encoder`](super::Encoder).
//! [`start`] sets both up from a [`LinkSigning`]; [`synchronize`] gives both the same time, after
//! each received frame.
//!
//! # Limits
//!
//! * Time ends in 2104, at 48 bits. It does not wrap: a signer that has reached [`SigningTime::LAST`]
//!   stays there, and its frames are refused as replayed. A peer that signs with such a time moves
//!   every other peer there, and then a new key is needed. No date can do this:
//!   [`SigningTime::from_unix_us`].
//! * A vehicle without a clock and without saved state accepts recorded frames of the same key until
//!   it has accepted a newer one.
//! * Signatures have 48 bits, and frames are not encrypted.

mod key;
mod pair;
mod signer;
mod state;
mod time;
mod verifier;

pub use key::SigningKey;
pub use pair::{LinkSigning, set_time, start, state, synchronize};
pub use signer::Signer;
pub use state::{STREAMS_MAX, SigningState, StreamTime};
pub use time::{SigningTime, TimeError};
pub use verifier::Verifier;

pub(super) use verifier::Verdict;

#[cfg(test)]
mod tests;
