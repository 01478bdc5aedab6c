// SPDX-License-Identifier: MIT OR Apache-2.0
//! Which frames are accepted, by devices with and without a clock, before and after a restart.

use std::{vec, vec::Vec};

use proptest::prelude::*;

use super::super::{
    Address, Decoder, Encoder, MAX_FRAME,
    layout::{SIGNATURE, signature::TIME},
    tests::{OWN, decode, heartbeat, position},
};
use super::*;

/// 2026-01-01, microseconds since 1970.
const NOW_US: u64 = 1_767_225_600_000_000;
const MINUTE: u64 = 6_000_000;

fn at(unix_us: u64) -> SigningTime {
    SigningTime::from_unix_us(unix_us).unwrap()
}

fn units(units: u64) -> SigningTime {
    SigningTime::from_units(units).unwrap()
}

fn signing(key: u8, link: u8, state: SigningState) -> LinkSigning {
    LinkSigning {
        key: SigningKey::new([key; 32]),
        link,
        state,
    }
}

fn signed(key: u8, link: u8, unix_us: u64) -> Encoder {
    let mut encoder = Encoder::new(OWN);
    encoder.sign_with(Signer::new(SigningKey::new([key; 32]), link, at(unix_us)));
    encoder
}

/// A decoder that goes on from this state.
fn verifying(key: u8, state: &SigningState) -> Decoder {
    let mut decoder = Decoder::new();
    decoder.require_signatures(Verifier::new(SigningKey::new([key; 32]), state));
    decoder
}

fn next(encoder: &mut Encoder) -> Vec<u8> {
    encoder.encode(&position(1.0), &mut [0; MAX_FRAME]).to_vec()
}

fn is_accepted(decoder: &mut Decoder, frame: &[u8]) -> bool {
    !decode(decoder, frame).is_empty()
}

/// The time in a frame's signature.
fn time_of(frame: &[u8]) -> SigningTime {
    let tail = &frame[frame.len() - SIGNATURE..];
    let mut bytes = [0; 8];
    bytes[..TIME.len()].copy_from_slice(&tail[TIME]);
    units(u64::from_le_bytes(bytes))
}

/// Returns the bytes that are written to persistent memory.
fn saved(what: &impl serde::Serialize) -> Vec<u8> {
    postcard::to_slice(what, &mut [0; 512]).unwrap().to_vec()
}

/// One end of a link. It answers a frame that it accepts.
struct End {
    decoder: Decoder,
    encoder: Encoder,
}

impl End {
    fn new(own: Address, setup: LinkSigning) -> Self {
        let (mut decoder, mut encoder) = (Decoder::new(), Encoder::new(own));
        start(&mut decoder, &mut encoder, setup);
        Self { decoder, encoder }
    }

    fn takes(&mut self, frame: &[u8]) -> bool {
        let accepted = is_accepted(&mut self.decoder, frame);
        synchronize(&mut self.decoder, &mut self.encoder);
        accepted
    }

    fn state(&self) -> SigningState {
        state(&self.decoder, &self.encoder).unwrap()
    }
}

const PEER: Address = Address {
    system: 1,
    component: 1,
};

#[test]
fn only_rightly_signed_fresh_frames_pass() {
    let mut buffer = [0; MAX_FRAME];
    let mut decoder = verifying(1, &SigningState::at(at(NOW_US)));
    let mut encoder = signed(1, 0, NOW_US);
    let good = encoder.encode(&position(1.0), &mut buffer).to_vec();
    assert_eq!(good.len(), 10 + 24 + 2 + 13 - (24 - good[1] as usize));
    assert_eq!(decode(&mut decoder, &good).len(), 1);
    // The same again, unsigned, with another key, damaged in the signature, a minute too old.
    assert!(decode(&mut decoder, &good).is_empty());
    let unsigned = next(&mut Encoder::new(OWN));
    assert!(decode(&mut decoder, &unsigned).is_empty());
    let other = next(&mut signed(2, 0, NOW_US));
    assert!(decode(&mut decoder, &other).is_empty());
    let mut damaged = next(&mut encoder);
    *damaged.last_mut().unwrap() ^= 1;
    assert!(decode(&mut decoder, &damaged).is_empty());
    let old = next(&mut signed(1, 3, NOW_US - 61_000_000));
    assert!(decode(&mut decoder, &old).is_empty());
    let counters = decoder.counters();
    assert_eq!(
        (counters.replayed, counters.unsigned, counters.bad_signature),
        (2, 1, 2)
    );
    assert!(is_accepted(&mut decoder, &next(&mut encoder)));
    // A reader without a key takes signed frames as they are.
    assert_eq!(decode(&mut Decoder::new(), &good).len(), 1);
}

#[test]
fn a_signature_has_the_bytes_of_the_standard() {
    // Computed apart from this crate (hashlib): key 0..31, link 7, time 1234567.
    let mut buffer = [0; MAX_FRAME];
    let mut key = [0; 32];
    key.iter_mut().zip(0..).for_each(|(byte, n)| *byte = n);
    let mut encoder = Encoder::new(OWN);
    encoder.sign_with(Signer::new(SigningKey::new(key), 7, units(1_234_566)));
    let frame = encoder.encode(&heartbeat(), &mut buffer);
    let (_, tail) = frame.split_at(frame.len() - SIGNATURE);
    assert_eq!(tail[..7], [7, 0x87, 0xD6, 0x12, 0, 0, 0]);
    assert_eq!(tail[7..], [139, 119, 113, 148, 14, 54]);
}

/// A device without a clock has the time of its peer after one frame, and signs with it. Before
/// that its frames are refused: they are ten years old.
#[test]
fn a_device_without_a_clock_takes_over_the_time_of_its_peer() {
    let mut device = End::new(OWN, signing(1, 1, SigningState::default()));
    let mut peer = End::new(PEER, signing(1, 0, SigningState::at(at(NOW_US))));
    assert!(!peer.takes(&next(&mut device.encoder)));
    let greeting = next(&mut peer.encoder);
    assert!(device.takes(&greeting));
    assert_eq!(device.state().time, time_of(&greeting));
    let answer = next(&mut device.encoder);
    assert!(time_of(&answer) > time_of(&greeting));
    assert!(peer.takes(&answer));
    // Both go on from the latest time of either.
    set_time(
        &mut device.decoder,
        &mut device.encoder,
        NOW_US + 3_600_000_000,
    );
    assert!(peer.takes(&next(&mut device.encoder)));
    assert!(device.takes(&next(&mut peer.encoder)));
}

/// Nothing that is refused changes the time: a forger who could advance it would silence the peers.
#[test]
fn refused_frames_leave_the_time_alone() {
    let before = SigningState::at(at(NOW_US));
    let mut device = End::new(OWN, signing(1, 1, before.clone()));
    let late = NOW_US + 1_000_000_000;
    let mut damaged = next(&mut signed(1, 0, late));
    *damaged.last_mut().unwrap() ^= 1;
    let mut moved = next(&mut signed(1, 0, NOW_US));
    let at_time = moved.len() - SIGNATURE + TIME.end - 1;
    moved[at_time] ^= 0x40;
    for frame in [
        damaged,
        moved,
        next(&mut signed(2, 0, late)),
        next(&mut Encoder::new(PEER)),
    ] {
        assert!(!device.takes(&frame));
        assert_eq!(device.state(), before);
    }
}

/// As the specification says, also for a stream that is known: what was held back for more than a
/// minute is refused.
#[test]
fn a_known_stream_must_not_be_a_minute_behind() {
    let mut encoder = signed(1, 0, NOW_US);
    let mut device = End::new(OWN, signing(1, 1, SigningState::at(at(NOW_US))));
    assert!(device.takes(&next(&mut encoder)));
    for (behind_us, is_fresh) in [(60_000_000 - 100, true), (60_000_000 + 100, false)] {
        let mut device = End::new(OWN, signing(1, 1, device.state()));
        let held_back = next(&mut encoder.clone());
        let now_us = NOW_US + behind_us;
        set_time(&mut device.decoder, &mut device.encoder, now_us);
        assert_eq!(device.takes(&held_back), is_fresh, "{behind_us} us");
    }
}

/// With the saved state a restarted device refuses all frames from before, of every stream, also if
/// it has no clock. Without the state it would accept them: the check is not empty.
#[test]
fn recorded_frames_are_refused_after_a_restart_with_the_saved_state() {
    let mut device = End::new(OWN, signing(1, 1, SigningState::default()));
    let mut recorded = Vec::new();
    let mut encoders: Vec<Encoder> = (0..4).map(|link| signed(1, link, NOW_US)).collect();
    for _ in 0..5 {
        for encoder in &mut encoders {
            let frame = next(encoder);
            assert!(device.takes(&frame));
            recorded.push(frame);
        }
    }
    let ours = next(&mut device.encoder);
    // The state is saved as bytes, and read by the restarted device.
    let bytes = saved(&device.state());
    let state: SigningState = postcard::from_bytes(&bytes).unwrap();
    assert_eq!(state, device.state());
    let mut restarted = End::new(OWN, signing(1, 1, state));
    for frame in &recorded {
        assert!(!restarted.takes(frame));
    }
    let count = restarted.decoder.counters().replayed;
    assert_eq!(count as usize, recorded.len());
    // Its own signatures are later than all before.
    assert!(time_of(&next(&mut restarted.encoder)) > time_of(&ours));
    for encoder in &mut encoders {
        assert!(restarted.takes(&next(encoder)));
    }
    let mut forgetful = End::new(OWN, signing(1, 1, SigningState::default()));
    assert!(forgetful.takes(&recorded[0]));
}

#[test]
fn the_same_key_keeps_the_replay_state_and_another_does_not() {
    let mut device = End::new(OWN, signing(1, 1, SigningState::default()));
    let frame = next(&mut signed(1, 0, NOW_US));
    assert!(device.takes(&frame));
    let again = signing(1, 2, SigningState::default());
    start(&mut device.decoder, &mut device.encoder, again);
    assert!(!device.takes(&frame));
    let sent = next(&mut device.encoder);
    assert!(time_of(&sent) > time_of(&frame));
    assert_eq!(sent[sent.len() - SIGNATURE], 2, "link id");
    // Also an encoder whose decoder requires no signatures.
    let time = time_of(&sent);
    let mut encoder = device.encoder.clone();
    encoder.sign_with(Signer::new(
        SigningKey::new([1; 32]),
        2,
        SigningTime::UNKNOWN,
    ));
    assert!(time_of(&next(&mut encoder)) > time);
    let other = signing(2, 1, SigningState::default());
    start(&mut device.decoder, &mut device.encoder, other);
    assert_eq!(device.state(), SigningState::default());
    assert!(device.takes(&next(&mut signed(2, 0, NOW_US))));
}

/// At the end of its 48 bits the time stays: the frames are refused, and nothing wraps.
#[test]
fn the_time_ends_and_does_not_wrap() {
    let last = SigningTime::LAST;
    let mut encoder = Encoder::new(PEER);
    let before = units(last.units() - 2);
    encoder.sign_with(Signer::new(SigningKey::new([1; 32]), 0, before));
    let mut device = End::new(OWN, signing(1, 1, SigningState::default()));
    let frames: Vec<Vec<u8>> = (0..4).map(|_| next(&mut encoder)).collect();
    let times: Vec<_> = frames.iter().map(|frame| time_of(frame)).collect();
    assert_eq!(times, [units(last.units() - 1), last, last, last]);
    let taken: Vec<_> = frames.iter().map(|frame| device.takes(frame)).collect();
    assert_eq!(taken, [true, true, false, false]);
    assert_eq!(time_of(&next(&mut device.encoder)), last);
    assert!(!device.takes(&next(&mut signed(1, 9, NOW_US))));
}

#[test]
fn times_are_those_of_dates_from_2015_to_2099() {
    const DAY_US: u64 = 86_400_000_000;
    let begin = 16_436 * DAY_US;
    let end = 47_482 * DAY_US;
    assert_eq!(SigningTime::from_unix_us(begin), Some(SigningTime::UNKNOWN));
    assert_eq!(at(begin + 10), units(1));
    assert!(at(end - 1) < SigningTime::LAST);
    // A clock that begins in 1970, as that of a vehicle without GPS, and dates that are wrong.
    for date in [0, 60_000_000, begin - 1, end, u64::MAX] {
        assert_eq!(SigningTime::from_unix_us(date), None, "{date}");
        let mut device = End::new(OWN, signing(1, 1, SigningState::default()));
        set_time(&mut device.decoder, &mut device.encoder, date);
        assert_eq!(device.state(), SigningState::default());
    }
    let too_large = 1 << 48;
    assert_eq!(
        SigningTime::from_units(too_large),
        Err(TimeError(too_large))
    );
    let bytes = saved(&too_large);
    assert!(postcard::from_bytes::<SigningTime>(&bytes).is_err());
}

/// More streams than there is memory for: those that went silent are forgotten, and their frames
/// stay refused.
#[test]
fn silent_streams_are_forgotten_and_stay_refused() {
    let mut device = End::new(OWN, signing(1, 1, SigningState::at(at(NOW_US))));
    let old: Vec<Vec<u8>> = (0..STREAMS_MAX as u8)
        .map(|link| next(&mut signed(1, link, NOW_US)))
        .collect();
    assert!(old.iter().all(|frame| device.takes(frame)));
    let further = next(&mut signed(1, 100, NOW_US));
    assert!(!device.takes(&further), "no memory for it");
    let later = next(&mut signed(1, 100, NOW_US + 60_000_100));
    // The time advances only with an accepted frame or with a clock.
    set_time(
        &mut device.decoder,
        &mut device.encoder,
        NOW_US + 60_000_100,
    );
    assert!(device.takes(&later));
    assert_eq!(device.state().streams.len(), 1);
    assert!(old.iter().all(|frame| !device.takes(frame)));
}

#[test]
fn a_key_is_erased_and_compared_as_a_whole() {
    use zeroize::Zeroize;
    assert!(core::mem::needs_drop::<SigningKey>());
    let mut key = SigningKey::new([7; 32]);
    assert_ne!(key, SigningKey::new([0; 32]));
    key.zeroize();
    assert_eq!(key, SigningKey::new([0; 32]));
    for at in [0, 15, 31] {
        let mut bytes = [0; 32];
        bytes[at] = 1;
        assert_ne!(key, SigningKey::new(bytes));
    }
    assert_eq!(std::format!("{key:?}"), "SigningKey(..)");
}

/// What can happen to a receiver.
#[derive(Clone, Debug)]
enum Step {
    /// A frame of a stream, this long after (or before) the base.
    Frame(u8, u64),
    Clock(u64),
    /// Restarted with the saved state.
    Restart,
    /// The same key set again.
    SameKey,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        20 => (0u8..24, 0u64..4 * MINUTE).prop_map(|(stream, time)| Step::Frame(stream, time)),
        // Few values, so that frames are repeated.
        20 => (0u8..24, 0u64..8).prop_map(|(stream, time)| Step::Frame(stream, time * MINUTE / 2)),
        1 => (0u64..4 * MINUTE).prop_map(Step::Clock),
        1 => Just(Step::Restart),
        1 => Just(Step::SameKey),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig {
        rng_seed: proptest::test_runner::RngSeed::Fixed(2),
        ..ProptestConfig::with_cases(300)
    })]

    /// Whatever happens, the accepted frames of each stream have increasing times, none is more than
    /// a minute behind the time at which it is accepted, and the time never decreases.
    #[test]
    fn no_frame_is_accepted_twice(steps in proptest::collection::vec(step(), 1..200)) {
        let mut state = SigningState::default();
        let mut last = vec![None; 24];
        let mut accepted = 0;
        for step in core::iter::once(Step::Frame(0, 0)).chain(steps) {
            let before = state.time;
            match step {
                Step::Frame(stream, time) => {
                    let time = units(time);
                    let frame = StreamTime { link: stream, sender: PEER, time };
                    if state.note(&frame) == Some(true) {
                        prop_assert!(Some(time) > last[usize::from(stream)]);
                        prop_assert!(time.units() + MINUTE >= before.units());
                        last[usize::from(stream)] = Some(time);
                        accepted += 1;
                    }
                }
                Step::Clock(time) => { state.advance(units(time)); }
                Step::Restart => {
                    let bytes = saved(&state);
                    let mut restarted = SigningState::default();
                    restarted.merge(&postcard::from_bytes(&bytes).unwrap());
                    state = restarted;
                }
                Step::SameKey => {
                    let mut other = SigningState::default();
                    for stream in 30..40 {
                        other.note(&StreamTime { link: stream, sender: OWN, time: before });
                    }
                    other.merge(&state);
                    state = other;
                }
            }
            prop_assert!(state.time >= before);
        }
        prop_assert!(accepted > 0);
    }
}
