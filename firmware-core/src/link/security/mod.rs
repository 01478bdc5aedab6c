// SPDX-License-Identifier: MIT OR Apache-2.0
//! Authentication of the ground link with a shared key: see `docs/link-protocol.md` for the
//! protocol and `docs/security.md` for what it protects.
//!
//! A session is between a nonce of the vehicle and one of the ground, and has a key per direction
//! that is derived from them and from the shared key. Frames of a direction carry a counter that only
//! increases.
//!
//! ```text
//!   vehicle                                             ground
//!   Offer { V }                      ----------------->  answers with its present nonce G
//!   takes the session (V, G)         <-----------------  ToVehicle { G, counter 0 }, no message
//!   ToGround { V, counter 1 }        ----------------->  takes the session (V, G)
//! ```
//!
//! One rule serves both ends: a frame names its sender's nonce; if the tag matches the session of
//! that nonce and the *nonce that this end offers*, the sender has seen the offer, and a new session
//! begins. Each end offers a nonce until a session with it begins, and then the next one, so that no
//! frame of an earlier session, of an earlier start, or of this end itself ever matches. An
//! unanswered handshake leaves no state behind, so that a flood of them has nothing to fill.
//!
//! Worst case of a received frame: HMAC-SHA-256 over it twice, and three short ones for its keys.

mod envelope;
mod key;
mod session;

pub use key::{Credentials, GroundKey};
pub(in crate::link) use session::{Authenticator, Side};

#[cfg(test)]
mod tests;
