// SPDX-License-Identifier: MIT OR Apache-2.0
//! One end of the ground link, with or without authentication.

use super::{
    error::{EncodeError, FrameError},
    frame::{Decoder, decode_message, encode},
    message::{FRAME_MAX, HANDSHAKE_FRAME_MAX, Message, PROTOCOL_VERSION, secure_frame_max},
    security::{Authenticator, Credentials, Side},
    status::{LinkCounters, SecurityCounters},
};
use crate::scalar::Scalar;

/// One end of the ground link: it finds messages in the bytes that are received, and makes frames of
/// the messages that are sent.
///
/// Without credentials every frame with a correct CRC is taken. With credentials both ends need the
/// same key, and a frame is taken only if the other end made it in the present session: see
/// `docs/link-protocol.md`. The caller sends what [`take_handshake`](Self::take_handshake) returns, and the
/// vehicle's caller asks for a session with [`offer`](Self::offer), in time intervals of its choice while
/// there is none, and once in a slot, so that a ground that was restarted can answer.
///
/// `N` is the length of the longest frame that it accepts. It must be at least [`secure_frame_max`] of
/// the messages, otherwise [`push`](Self::push) does not compile.
#[derive(Clone, Debug, Default)]
pub struct Endpoint<const N: usize = FRAME_MAX> {
    decoder: Decoder<N>,
    authenticator: Option<Authenticator>,
}

impl<const N: usize> Endpoint<N> {
    /// Creates an end without authentication that has received nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates the vehicle's end. It offers a session as soon as [`take_handshake`](Self::take_handshake)
    /// is called.
    pub fn vehicle(credentials: Credentials) -> Self {
        let mut end = Self::authenticated(Side::Vehicle, credentials);
        end.offer();
        end
    }

    /// Creates the ground's end.
    pub fn ground(credentials: Credentials) -> Self {
        Self::authenticated(Side::Ground, credentials)
    }

    fn authenticated(side: Side, credentials: Credentials) -> Self {
        Self {
            decoder: Decoder::new(),
            authenticator: Some(Authenticator::new(side, credentials)),
        }
    }

    /// Returns the counters of the frames that were received.
    pub fn counters(&self) -> &LinkCounters {
        self.decoder.counters()
    }

    /// Returns the counters of authentication; `None` without credentials.
    pub fn security(&self) -> Option<&SecurityCounters> {
        Some(self.authenticator.as_ref()?.counters())
    }

    /// Returns whether messages can be sent: always without credentials, and otherwise in a session.
    pub fn has_session(&self) -> bool {
        self.authenticator
            .as_ref()
            .is_none_or(Authenticator::has_session)
    }

    /// Makes the vehicle's end offer a session, to which a ground that is not in its present session
    /// answers. Another end ignores the call.
    pub fn offer(&mut self) {
        if let Some(authenticator) = &mut self.authenticator {
            authenticator.offer();
        }
    }

    /// Returns whether a frame of the handshake is to be sent.
    pub fn is_handshake_due(&self) -> bool {
        let authenticator = self.authenticator.as_ref();
        authenticator.is_some_and(Authenticator::is_handshake_due)
    }

    /// Returns the frame of the handshake that is to be sent, if there is one. Call after every byte
    /// or piece that was received.
    ///
    /// A buffer of less than [`HANDSHAKE_FRAME_MAX`] bytes does not compile.
    pub fn take_handshake<'f, const B: usize>(
        &mut self,
        frame: &'f mut [u8; B],
    ) -> Option<&'f [u8]> {
        const {
            assert!(
                HANDSHAKE_FRAME_MAX <= B,
                "the buffer is shorter than a frame of the handshake: it must have at least \
                 `link::HANDSHAKE_FRAME_MAX` bytes"
            )
        };
        self.authenticator.as_mut()?.take_handshake(frame)
    }

    /// Takes a byte. At the end of a frame with a message it returns the message, or the error if the
    /// frame is not taken.
    ///
    /// A capacity `N` that is too small for messages of these capacities does not compile:
    ///
    /// ```compile_fail,E0080
    /// use firmware_core::link::Endpoint;
    ///
    /// // 100 sensors, but frames for 64.
    /// let mut end: Endpoint = Endpoint::new();
    /// end.push::<f64, 16, 100>(0);
    /// ```
    pub fn push<T: Scalar, const M: usize, const J: usize>(
        &mut self,
        byte: u8,
    ) -> Option<Result<Message<T, M, J>, FrameError>> {
        const { check_length::<T, M, J, N>() };
        let authenticator = &mut self.authenticator;
        self.decoder.push_with(byte, |plain| match authenticator {
            Some(authenticator) => authenticator.open(plain),
            None => decode_message(PROTOCOL_VERSION, plain).map(Some),
        })
    }

    /// Takes a byte that a copy of this end has sent, for an observer that follows the link with such
    /// a copy. `decoder` holds the bytes of the frame so far.
    pub fn observe<T: Scalar, const M: usize, const J: usize>(
        &mut self,
        decoder: &mut Decoder<N>,
        byte: u8,
    ) -> Option<Result<Message<T, M, J>, FrameError>> {
        const { check_length::<T, M, J, N>() };
        let authenticator = &mut self.authenticator;
        decoder.push_with(byte, |plain| match authenticator {
            Some(authenticator) => authenticator.open_sent(plain),
            None => decode_message(PROTOCOL_VERSION, plain).map(Some),
        })
    }

    /// Writes a message as a frame into `frame` and returns the bytes to send.
    ///
    /// # Errors
    /// Returns an error if there is no session, or if the frame does not fit;
    /// [`secure_frame_max`] bytes always suffice.
    pub fn encode<'f, T: Scalar, const M: usize, const J: usize>(
        &mut self,
        message: &Message<T, M, J>,
        frame: &'f mut [u8],
    ) -> Result<&'f [u8], EncodeError> {
        match &mut self.authenticator {
            Some(authenticator) => authenticator.seal(Some(message), frame),
            None => Ok(encode(message, frame)?),
        }
    }
}

/// Checks, at compile time, that frames of `N` bytes hold every message.
const fn check_length<T: Scalar, const M: usize, const J: usize, const N: usize>() {
    assert!(
        secure_frame_max::<T>(M, J) <= N,
        "the frames of this `link::Endpoint<N>` are too short for M users and J sensors: N must be \
         at least `link::secure_frame_max::<T>(M, J)`"
    );
}
