// SPDX-License-Identifier: MIT OR Apache-2.0
//! The sessions of one end: which frames are taken, and which are refused.

use serde::{Serialize, de::DeserializeOwned};

use super::{
    envelope::{Envelope, Header, seal},
    key::{Credentials, GroundKey, Kind, MacKey, Nonce},
};
use crate::{
    counter::count,
    link::{
        error::{EncodeError, FrameError, Refusal},
        message::{PROTOCOL_VERSION, SECURE_VERSION},
        status::SecurityCounters,
    },
};

/// The end of the link that frames are taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::link) enum Side {
    Vehicle,
    Ground,
}

impl Side {
    /// The kind of the frames that this end sends in a session.
    fn sent(self) -> Kind {
        match self {
            Self::Vehicle => Kind::ToGround,
            Self::Ground => Kind::ToVehicle,
        }
    }

    /// The kind of the frames that this end receives in a session.
    fn received(self) -> Kind {
        match self {
            Self::Vehicle => Kind::ToVehicle,
            Self::Ground => Kind::ToGround,
        }
    }
}

/// A session between two nonces.
#[derive(Clone, Debug)]
struct Session {
    ours: Nonce,
    theirs: Nonce,
    send: MacKey,
    receive: MacKey,
    /// The counters of the last frames in both directions. A frame is received if its counter is
    /// larger: a stream of bytes keeps the order, and all that is lost is asked for again, so there
    /// is nothing to gain by a window of earlier ones.
    sent: u32,
    received: u32,
}

/// A frame of the handshake that is to be sent.
#[derive(Clone, Copy, Debug)]
enum Due {
    /// The vehicle's offer.
    Offer,
    /// The ground's answer to the offer of this nonce.
    Answer(Nonce),
    /// The vehicle's first frame in a session.
    Confirmation,
}

/// The authentication of one end.
#[derive(Clone, Debug)]
pub(in crate::link) struct Authenticator {
    key: GroundKey,
    side: Side,
    /// This end's nonce for the next session; `None` after its last.
    offered: Option<Nonce>,
    session: Option<Session>,
    due: Option<Due>,
    counters: SecurityCounters,
}

impl Authenticator {
    pub(in crate::link) fn new(side: Side, credentials: Credentials) -> Self {
        Self {
            key: credentials.key,
            side,
            offered: Some(Nonce::first(credentials.start)),
            session: None,
            due: None,
            counters: SecurityCounters::default(),
        }
    }

    pub(in crate::link) fn counters(&self) -> &SecurityCounters {
        &self.counters
    }

    pub(in crate::link) fn has_session(&self) -> bool {
        self.session.is_some()
    }

    /// Makes the vehicle's offer due.
    pub(in crate::link) fn offer(&mut self) {
        if self.side == Side::Vehicle {
            self.due.get_or_insert(Due::Offer);
        }
    }

    pub(in crate::link) fn is_handshake_due(&self) -> bool {
        self.due.is_some()
    }

    fn of_session(&self, direction: Kind, ours: &Nonce, theirs: &Nonce) -> MacKey {
        match self.side {
            Side::Vehicle => self.key.of_session(direction, ours, theirs),
            Side::Ground => self.key.of_session(direction, theirs, ours),
        }
    }

    /// Takes the bytes of a frame, from the version to the CRC excluded, and returns its message;
    /// `None` if it is a frame of the handshake.
    pub(in crate::link) fn open<D: DeserializeOwned>(
        &mut self,
        plain: &[u8],
    ) -> Result<Option<D>, FrameError> {
        let opened = self.verify(plain);
        if let Err(FrameError::Refused(refusal)) = opened {
            self.counters.note(refusal);
        }
        let message = opened?;
        if message.is_empty() {
            count(&mut self.counters.handshakes);
            return Ok(None);
        }
        decode(message).map(Some)
    }

    /// Verifies a frame and returns its message, which is empty in a frame of the handshake.
    fn verify<'a>(&mut self, plain: &'a [u8]) -> Result<&'a [u8], FrameError> {
        let envelope = envelope(plain)?;
        let kind = envelope.header.kind;
        if kind == self.side.received() {
            self.verify_in_session(&envelope)?;
        } else if kind == Kind::Offer && self.side == Side::Ground {
            self.verify_offer(&envelope)?;
        } else {
            return Err(FrameError::Refused(Refusal::Reflected));
        }
        Ok(envelope.message)
    }

    /// The ground answers each offer but those of a vehicle that is in the same session: that one
    /// offers the nonce after that of the session.
    fn verify_offer(&mut self, envelope: &Envelope<'_>) -> Result<(), FrameError> {
        if !envelope.message.is_empty() || !envelope.is_valid(&self.key.of_offers()) {
            return Err(FrameError::Refused(Refusal::Forged));
        }
        let offer = envelope.header.nonce;
        let in_session = |session: &Session| session.theirs.next() == Some(offer);
        if !self.session.as_ref().is_some_and(in_session) {
            self.due = Some(Due::Answer(offer));
        }
        Ok(())
    }

    fn verify_in_session(&mut self, envelope: &Envelope<'_>) -> Result<(), FrameError> {
        let Header { nonce, counter, .. } = envelope.header;
        let named = self.session.as_mut().filter(|s| s.theirs == nonce);
        let is_named = named.is_some();
        if let Some(session) = named.filter(|session| envelope.is_valid(&session.receive)) {
            if counter <= session.received {
                return Err(FrameError::Refused(Refusal::Replayed));
            }
            session.received = counter;
            return Ok(());
        }
        let begun = self.offered.filter(|offered| {
            let receive = self.of_session(self.side.received(), offered, &nonce);
            envelope.is_valid(&receive)
        });
        let Some(ours) = begun else {
            return Err(FrameError::Refused(if is_named {
                Refusal::Forged
            } else {
                Refusal::OtherSession
            }));
        };
        self.session = Some(Session {
            ours,
            theirs: nonce,
            send: self.of_session(self.side.sent(), &ours, &nonce),
            receive: self.of_session(self.side.received(), &ours, &nonce),
            sent: 0,
            received: counter,
        });
        self.offered = ours.next();
        self.due = (self.side == Side::Vehicle).then_some(Due::Confirmation);
        count(&mut self.counters.sessions);
        Ok(())
    }

    /// Writes a message as a frame of the session.
    pub(in crate::link) fn seal<'f>(
        &mut self,
        message: Option<&impl Serialize>,
        frame: &'f mut [u8],
    ) -> Result<&'f [u8], EncodeError> {
        let session = self.session.as_mut().ok_or(EncodeError::NoSession)?;
        let Some(counter) = session.sent.checked_add(1) else {
            // The counter must not begin again. The other end learns of it by the next offer, which
            // is not the one after this session's.
            self.session = None;
            self.offered = self.offered.and_then(Nonce::next);
            return Err(EncodeError::NoSession);
        };
        session.sent = counter;
        let header = Header {
            kind: self.side.sent(),
            nonce: session.ours,
            counter,
        };
        Ok(seal(header, message, &session.send, frame)?)
    }

    /// Writes the frame of the handshake that is due, if there is one.
    pub(in crate::link) fn take_handshake<'f>(&mut self, frame: &'f mut [u8]) -> Option<&'f [u8]> {
        let none: Option<&()> = None;
        match self.due.take()? {
            Due::Confirmation => self.seal(none, frame).ok(),
            Due::Offer => {
                let header = Header {
                    kind: Kind::Offer,
                    nonce: self.offered?,
                    counter: 0,
                };
                seal(header, none, &self.key.of_offers(), frame).ok()
            }
            Due::Answer(theirs) => {
                let nonce = self.offered?;
                let kind = self.side.sent();
                let header = Header {
                    kind,
                    nonce,
                    counter: 0,
                };
                let key = self.of_session(kind, &nonce, &theirs);
                seal(header, none, &key, frame).ok()
            }
        }
    }

    /// Takes the bytes of a frame that a copy of this end has sent, and returns its message; `None`
    /// if it is a frame of the handshake. Its counter must be the next one.
    pub(in crate::link) fn open_sent<D: DeserializeOwned>(
        &mut self,
        plain: &[u8],
    ) -> Result<Option<D>, FrameError> {
        let envelope = envelope(plain)?;
        let Header {
            kind,
            nonce,
            counter,
        } = envelope.header;
        let forged = FrameError::Refused(Refusal::Forged);
        if kind == Kind::Offer {
            let is_ours = self.side == Side::Vehicle && self.offered == Some(nonce);
            let is_valid = is_ours && envelope.is_valid(&self.key.of_offers());
            return if is_valid { Ok(None) } else { Err(forged) };
        }
        let session = self.session.as_mut().ok_or(forged)?;
        if kind != self.side.sent() || nonce != session.ours || !envelope.is_valid(&session.send) {
            return Err(forged);
        }
        if session.sent.checked_add(1) != Some(counter) {
            return Err(FrameError::Refused(Refusal::Replayed));
        }
        session.sent = counter;
        if envelope.message.is_empty() {
            return Ok(None);
        }
        decode(envelope.message).map(Some)
    }
}

/// Splits a frame of the authenticated version.
fn envelope(plain: &[u8]) -> Result<Envelope<'_>, FrameError> {
    match plain.first() {
        Some(&SECURE_VERSION) => Envelope::parse(plain).ok_or(FrameError::Malformed),
        Some(&PROTOCOL_VERSION) => Err(FrameError::Refused(Refusal::Unauthenticated)),
        Some(&got) => Err(FrameError::Version { got }),
        None => Err(FrameError::Malformed),
    }
}

fn decode<D: DeserializeOwned>(message: &[u8]) -> Result<D, FrameError> {
    match postcard::take_from_bytes(message) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError::Message),
    }
}

impl SecurityCounters {
    /// Counts a frame that was refused.
    fn note(&mut self, refusal: Refusal) {
        count(match refusal {
            Refusal::Unauthenticated => &mut self.unauthenticated,
            Refusal::Forged => &mut self.forged,
            Refusal::OtherSession => &mut self.other_session,
            Refusal::Replayed => &mut self.replayed,
            Refusal::Reflected => &mut self.reflected,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::message::FRAME_MAX;

    fn pair() -> [Authenticator; 2] {
        [Side::Vehicle, Side::Ground].map(|side| {
            let key = GroundKey::new([1; 32]);
            let start = [side as u8; 12];
            Authenticator::new(side, Credentials { key, start })
        })
    }

    /// Carries the frame of the handshake that an end has to send to the other one.
    fn carry(from: &mut Authenticator, to: &mut Authenticator) -> bool {
        let mut frame = [0; FRAME_MAX];
        let Some(frame) = from.take_handshake(&mut frame) else {
            return false;
        };
        give(frame, to).is_ok()
    }

    fn give(frame: &[u8], to: &mut Authenticator) -> Result<Option<u32>, FrameError> {
        let mut bytes = frame[1..frame.len() - 1].to_vec();
        let length = cobs::decode_in_place(&mut bytes).expect("a frame");
        to.open(&bytes[..length - 4])
    }

    fn connect(vehicle: &mut Authenticator, ground: &mut Authenticator) {
        vehicle.offer();
        assert!(carry(vehicle, ground) && carry(ground, vehicle) && carry(vehicle, ground));
    }

    /// The last counter is used, and then there is a new session with new keys.
    #[test]
    fn a_session_ends_with_its_last_counter() {
        let [mut vehicle, mut ground] = pair();
        let sessions = |end: &Authenticator| end.counters.sessions;
        for ends in 1..=3 {
            connect(&mut vehicle, &mut ground);
            assert_eq!((sessions(&vehicle), sessions(&ground)), (ends, ends));
            let ending = if ends % 2 == 0 {
                &mut vehicle
            } else {
                &mut ground
            };
            let session = ending.session.as_mut().expect("a session");
            session.sent = u32::MAX - 1;
            let mut frame = [0; FRAME_MAX];
            assert!(ending.seal(Some(&7_u32), &mut frame).is_ok());
            let last = ending.seal(Some(&7_u32), &mut frame);
            assert_eq!(last, Err(EncodeError::NoSession));
            assert!(!ending.has_session());
        }
    }

    /// After the last nonce no session begins, and the present one goes on.
    #[test]
    fn the_last_nonce_is_not_used_twice() {
        let [mut vehicle, mut ground] = pair();
        let start = [9; 12];
        let mut last = Nonce::first(start).to_bytes();
        last[12..].fill(0xff);
        vehicle.offered = Some(Nonce::from_bytes(&last));
        connect(&mut vehicle, &mut ground);
        vehicle.offer();
        assert!(!carry(&mut vehicle, &mut ground));
        let mut frame = [0; FRAME_MAX];
        let frame = ground.seal(Some(&7_u32), &mut frame).expect("a session");
        assert_eq!(give(frame, &mut vehicle), Ok(Some(7)));
    }
}
