// SPDX-License-Identifier: MIT OR Apache-2.0
//! One link: the decoder and the encoder share key and time.

use super::super::{decoder::Decoder, encoder::Encoder};
use super::{Signer, SigningKey, SigningState, SigningTime, Verifier};

/// What a link needs to sign: the key, its id, and where it goes on.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkSigning {
    /// The key.
    pub key: SigningKey,
    /// The link id of the frames that are sent. Two links of one sender need different ids if their
    /// frames can reach the same receiver.
    pub link: u8,
    /// The state of an earlier run, or [`SigningState::at`] the time of a clock, or the default
    /// where neither is known.
    pub state: SigningState,
}

/// Signs every frame from now on, and accepts only frames with a valid signature. If both already
/// work with the same key, their times and replay state are kept.
pub fn start(decoder: &mut Decoder, encoder: &mut Encoder, signing: LinkSigning) {
    let LinkSigning { key, link, state } = signing;
    encoder.sign_with(Signer::new(key.clone(), link, state.time));
    decoder.require_signatures(Verifier::new(key, &state));
    synchronize(decoder, encoder);
}

/// Gives both the later of their times. This is called after each received frame and before an
/// answer is sent, so that a device without a clock signs with the time of its peers.
pub fn synchronize(decoder: &mut Decoder, encoder: &mut Encoder) {
    if let (Some(verifier), Some(signer)) = (decoder.verifier_mut(), encoder.signer_mut()) {
        verifier.advance_to(signer.time());
        signer.advance_to(verifier.state().time);
    }
}

/// Sets the clock of both, microseconds since 1970. It never goes back; a date that
/// [`SigningTime::from_unix_us`] does not take changes nothing.
pub fn set_time(decoder: &mut Decoder, encoder: &mut Encoder, unix_us: u64) {
    let Some(time) = SigningTime::from_unix_us(unix_us) else {
        return;
    };
    if let Some(verifier) = decoder.verifier_mut() {
        verifier.advance_to(time);
    }
    if let Some(signer) = encoder.signer_mut() {
        signer.advance_to(time);
    }
}

/// Returns the state to save, or `None` if signatures are not required. Its time is not before that
/// of any signature.
pub fn state(decoder: &Decoder, encoder: &Encoder) -> Option<SigningState> {
    let mut state = decoder.verifier()?.state().clone();
    if let Some(signer) = encoder.signer() {
        state.advance(signer.time());
    }
    Some(state)
}
