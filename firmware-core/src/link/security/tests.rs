// SPDX-License-Identifier: MIT OR Apache-2.0
//! The protocol of sessions, and attacks on it: what somebody on the radio can do who reads, holds
//! back, repeats and invents frames, and does not have the key.

use std::{vec, vec::Vec};

use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::{
    PowerGain,
    controller::ChannelState,
    link::{
        Decoder, Endpoint, FRAME_MAX, FrameError, Message, PROTOCOL_VERSION, Refusal,
        SECURE_VERSION, SecurityCounters, VehicleStatus, encode, encode_as, frame::CHECKSUM,
    },
};

type TestMessage = Message<f32, 2, 3>;

const KEY: [u8; 32] = [0x3c; 32];

/// Returns the credentials of the start number `start` of an end.
fn credentials(end: u8, start: u8) -> Credentials {
    let mut bytes = [end; 12];
    bytes[11] = start;
    Credentials {
        key: GroundKey::new(KEY),
        start: bytes,
    }
}

fn vehicle(start: u8) -> Endpoint {
    Endpoint::vehicle(credentials(1, start))
}

fn ground(start: u8) -> Endpoint {
    Endpoint::ground(credentials(2, start))
}

fn state(slot: u32) -> TestMessage {
    Message::ChannelState(ChannelState {
        slot,
        user_gains: [PowerGain(1e-11), PowerGain(2e-11)].into_iter().collect(),
        sensor_gains: [PowerGain(3e-12); 3].into_iter().collect(),
    })
}

fn status(slots_done: u32) -> TestMessage {
    Message::Status(VehicleStatus {
        slots_done,
        ..VehicleStatus::default()
    })
}

fn handshake(end: &mut Endpoint) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    end.take_handshake(&mut buffer).unwrap_or_default().to_vec()
}

fn say(end: &mut Endpoint, message: &TestMessage) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    end.encode(message, &mut buffer)
        .expect("a session")
        .to_vec()
}

fn hear(end: &mut Endpoint, bytes: &[u8]) -> Vec<Result<TestMessage, FrameError>> {
    bytes.iter().filter_map(|&byte| end.push(byte)).collect()
}

/// Returns a frame around what its CRC covers.
fn framed(plain: &[u8]) -> Vec<u8> {
    let plain = [plain, &CHECKSUM.checksum(plain).to_le_bytes()].concat();
    let mut frame = vec![0; cobs::max_encoding_length(plain.len()) + 2];
    let length = cobs::encode(&plain, &mut frame[1..]);
    frame.truncate(length + 2);
    frame
}

/// Returns what the CRC of a frame covers.
fn plain(frame: &[u8]) -> Vec<u8> {
    let mut bytes = frame[1..frame.len() - 1].to_vec();
    let length = cobs::decode_in_place(&mut bytes).expect("a frame");
    bytes.truncate(length - 4);
    bytes
}

/// The offer, its answer and the confirmation, and the ends in their session.
fn connect(vehicle: &mut Endpoint, ground: &mut Endpoint) -> [Vec<u8>; 3] {
    vehicle.offer();
    let offer = handshake(vehicle);
    assert!(hear(ground, &offer).is_empty());
    let answer = handshake(ground);
    assert!(hear(vehicle, &answer).is_empty());
    let confirmation = handshake(vehicle);
    assert!(hear(ground, &confirmation).is_empty());
    assert!(vehicle.has_session() && ground.has_session());
    [offer, answer, confirmation]
}

fn connected() -> (Endpoint, Endpoint) {
    let (mut vehicle, mut ground) = (vehicle(0), ground(0));
    connect(&mut vehicle, &mut ground);
    (vehicle, ground)
}

fn security(end: &Endpoint) -> SecurityCounters {
    *end.security().expect("authenticated")
}

/// Demands that messages still go both ways.
fn works(vehicle: &mut Endpoint, ground: &mut Endpoint) {
    let up = say(ground, &state(77));
    assert_eq!(hear(vehicle, &up), [Ok(state(77))]);
    let down = say(vehicle, &status(78));
    assert_eq!(hear(ground, &down), [Ok(status(78))]);
}

#[test]
fn a_session_carries_messages_both_ways() {
    let (mut vehicle, mut ground) = (vehicle(0), ground(0));
    assert!(!vehicle.has_session() && !ground.has_session());
    let mut buffer = [0; FRAME_MAX];
    assert!(vehicle.encode(&status(1), &mut buffer).is_err());
    connect(&mut vehicle, &mut ground);
    for _ in 0..3 {
        works(&mut vehicle, &mut ground);
    }
    let once = SecurityCounters {
        sessions: 1,
        handshakes: 1,
        ..SecurityCounters::default()
    };
    assert_eq!(security(&vehicle), once);
    assert_eq!(
        security(&ground),
        SecurityCounters {
            handshakes: 2,
            ..once
        }
    );
    // The routine offer of a vehicle in session is not answered.
    vehicle.offer();
    let offer = handshake(&mut vehicle);
    hear(&mut ground, &offer);
    assert!(!ground.is_handshake_due());
}

/// The bytes of the frames are a format. These were made with Python's `hmac`, `struct` and
/// `binascii`, from the description in `docs/link-protocol.md`.
#[test]
fn the_format_is_stable() {
    let (mut vehicle, mut ground) = (vehicle(0), ground(0));
    let [offer, answer, confirmation] = connect(&mut vehicle, &mut ground);
    let mut first = say(&mut ground, &state(300));
    first = plain(&first);
    let hex = |bytes: &[u8]| {
        bytes
            .iter()
            .map(|b| std::format!("{b:02x}"))
            .collect::<std::string::String>()
    };
    let seen = [
        &plain(&offer),
        &plain(&answer),
        &plain(&confirmation),
        &first,
    ]
    .map(|bytes| hex(bytes));
    assert_eq!(seen, GOLDEN);
}

const GOLDEN: [&str; 4] = [
    "44000101010101010101010101000000000000000000eba65d978acd8b869b9ff25fd795458f",
    "44020202020202020202020202000000000000000000d7e76fb07a1167b1b2912f29f48faf20",
    "440101010101010101010101010000000000010000008ab958978dad02f99db2d9237abfe0fa",
    "4402020202020202020202020200000000000100000000ac0202ffeb2f2dffebaf2d03321b532c321b532c321b532c22abc0a49e50af7d4a5a6250b6fc52fa",
];

/// Another key, another version and frames without authentication are refused by both ends, and
/// counted as what they are.
#[test]
fn downgraded_frames_are_refused() {
    let (mut vehicle, mut ground) = connected();
    let mut buffer = [0; FRAME_MAX];
    for version in 0..=u8::MAX {
        let frame = encode_as(version, &state(1), &mut buffer)
            .expect("fits")
            .to_vec();
        for end in [&mut vehicle, &mut ground] {
            let heard = hear(end, &frame);
            let expected = match version {
                PROTOCOL_VERSION => FrameError::Refused(Refusal::Unauthenticated),
                SECURE_VERSION => FrameError::Malformed,
                got => FrameError::Version { got },
            };
            // Read as an authenticated frame it may name any kind and tag.
            let refused = heard.first().is_some_and(Result::is_err);
            assert!(
                refused && (version == SECURE_VERSION || heard == [Err(expected)]),
                "{version}: {heard:?}"
            );
        }
    }
    assert_eq!(security(&vehicle).unauthenticated, 1);
    works(&mut vehicle, &mut ground);
    // An end without a key does not take authenticated frames for its own.
    let up = say(&mut ground, &state(1));
    let mut open = Endpoint::new();
    assert_eq!(
        hear(&mut open, &up),
        [Err(FrameError::Version {
            got: SECURE_VERSION
        })]
    );
    let plain = encode(&state(1), &mut buffer).expect("fits").to_vec();
    assert_eq!(hear(&mut open, &plain), [Ok(state(1))]);
}

/// Each bit of each kind of frame is covered by the tag, and no shorter or longer frame is taken.
#[test]
fn forged_and_truncated_frames_are_refused() {
    for kind in 0..4 {
        let pair = || -> (Endpoint, Endpoint, Vec<u8>) {
            let (mut vehicle, mut ground) = (vehicle(0), ground(0));
            let offer = handshake(&mut vehicle);
            if kind == 0 {
                return (ground, vehicle, offer);
            }
            hear(&mut ground, &offer);
            let answer = handshake(&mut ground);
            if kind == 1 {
                return (vehicle, ground, answer);
            }
            hear(&mut vehicle, &answer);
            let confirmation = handshake(&mut vehicle);
            hear(&mut ground, &confirmation);
            if kind == 2 {
                let frame = say(&mut vehicle, &status(5));
                return (ground, vehicle, frame);
            }
            let frame = say(&mut ground, &state(5));
            (vehicle, ground, frame)
        };
        let (mut end, _, frame) = pair();
        let whole = plain(&frame);
        let before = end.clone();
        let refuse = |end: &mut Endpoint, bytes: &[u8], what: &str| {
            let heard = hear(end, &framed(bytes));
            assert!(
                heard.len() == 1 && heard[0].is_err(),
                "{kind} {what}: {heard:?}"
            );
            assert!(!end.is_handshake_due(), "{kind} {what}");
        };
        for bit in 0..8 * whole.len() {
            let mut wrong = whole.clone();
            wrong[bit / 8] ^= 1 << (bit % 8);
            refuse(&mut end, &wrong, "flipped");
        }
        for length in 1..whole.len() {
            refuse(&mut end, &whole[..length], "truncated");
            refuse(&mut end, &whole[length..], "truncated before");
        }
        for byte in [0, 1, 255] {
            refuse(&mut end, &[&whole[..], &[byte]].concat(), "longer");
        }
        // None of them has changed anything: the genuine frame is still taken.
        let sessions = |end: &Endpoint| security(end).sessions;
        assert_eq!(sessions(&end), sessions(&before));
        let heard = hear(&mut end, &frame);
        assert!(heard.iter().all(Result::is_ok), "{heard:?}");
        assert!(security(&end).refused() > 0);
    }
}

/// A frame of another key, made from nonces that can be read on the radio.
#[test]
fn a_forger_without_the_key_is_refused() {
    let wrong = |end| Credentials {
        key: GroundKey::new([0x3d; 32]),
        ..credentials(end, 0)
    };
    let (mut forged_vehicle, mut forged_ground) =
        (Endpoint::vehicle(wrong(1)), Endpoint::ground(wrong(2)));
    let [offer, answer, confirmation] = connect(&mut forged_vehicle, &mut forged_ground);
    let (up, down) = (
        say(&mut forged_ground, &state(1)),
        say(&mut forged_vehicle, &status(1)),
    );
    let (mut vehicle, mut ground) = connected();
    for (end, frames) in [
        (&mut vehicle, [&answer, &up]),
        (&mut ground, [&confirmation, &down]),
    ] {
        for frame in frames {
            assert_eq!(
                hear(end, frame),
                [Err(FrameError::Refused(Refusal::Forged))]
            );
        }
    }
    assert_eq!(
        hear(&mut ground, &offer),
        [Err(FrameError::Refused(Refusal::Forged))]
    );
    assert!(!ground.is_handshake_due());
    works(&mut vehicle, &mut ground);
}

#[test]
fn replayed_and_reordered_frames_are_refused() {
    let (mut vehicle, mut ground) = (vehicle(0), ground(0));
    let mut handshakes = connect(&mut vehicle, &mut ground).to_vec();
    let offer = handshakes.remove(0);
    let ups: Vec<_> = (1..=5).map(|slot| say(&mut ground, &state(slot))).collect();
    let downs: Vec<_> = (1..=5)
        .map(|slot| say(&mut vehicle, &status(slot)))
        .collect();
    let replayed = [Err(FrameError::Refused(Refusal::Replayed))];
    // 1 is late, 4 is lost.
    for (at, taken) in [
        (1, true),
        (0, false),
        (2, true),
        (2, false),
        (4, true),
        (1, false),
        (3, false),
    ] {
        for (end, frames) in [(&mut vehicle, &ups), (&mut ground, &downs)] {
            let heard = hear(end, &frames[at]);
            assert_eq!(heard[0].is_ok(), taken, "{at}");
            assert!(taken || heard == replayed);
        }
    }
    assert_eq!(hear(&mut vehicle, &handshakes[0]), replayed);
    assert_eq!(hear(&mut ground, &handshakes[1]), replayed);
    // An old offer costs the ground an answer, and the vehicle refuses it.
    assert!(hear(&mut ground, &offer).is_empty());
    let answer = handshake(&mut ground);
    assert_eq!(
        hear(&mut vehicle, &answer),
        [Err(FrameError::Refused(Refusal::OtherSession))]
    );
    works(&mut vehicle, &mut ground);
    assert_eq!(
        (security(&vehicle).sessions, security(&ground).sessions),
        (1, 1)
    );
}

#[test]
fn reflected_frames_are_refused() {
    let (mut vehicle, mut ground) = (vehicle(0), ground(0));
    let [offer, answer, confirmation] = connect(&mut vehicle, &mut ground);
    let (up, down) = (say(&mut ground, &state(1)), say(&mut vehicle, &status(1)));
    let reflected = [Err(FrameError::Refused(Refusal::Reflected))];
    for frame in [&offer, &confirmation, &down] {
        assert_eq!(hear(&mut vehicle, frame), reflected);
        // A forger may write the other direction into it.
        let mut turned = plain(frame);
        turned[1] = 2;
        assert!(hear(&mut vehicle, &framed(&turned))[0].is_err());
    }
    for frame in [&answer, &up] {
        assert_eq!(hear(&mut ground, frame), reflected);
        let mut turned = plain(frame);
        turned[1] = 1;
        assert!(hear(&mut ground, &framed(&turned))[0].is_err());
    }
    assert_eq!(
        (security(&vehicle).reflected, security(&ground).reflected),
        (3, 2)
    );
    works(&mut vehicle, &mut ground);
}

/// Everything that both ends said in a session, sent again to ends of which one or both were
/// restarted, before, during and after their new handshake.
#[test]
fn an_earlier_session_is_refused_after_a_restart() {
    for (new_vehicle, new_ground) in [(1, 0), (0, 1), (1, 1)] {
        let (mut vehicle, mut ground) = (vehicle(0), ground(0));
        let [offer, answer, confirmation] = connect(&mut vehicle, &mut ground);
        let mut ups = vec![answer];
        let mut downs = vec![offer, confirmation];
        for slot in 1..=20 {
            ups.push(say(&mut ground, &state(slot)));
            downs.push(say(&mut vehicle, &status(slot)));
            hear(&mut vehicle, &ups[ups.len() - 1]);
            hear(&mut ground, &downs[downs.len() - 1]);
        }
        if new_vehicle > 0 {
            vehicle = super::tests::vehicle(new_vehicle);
        }
        if new_ground > 0 {
            ground = super::tests::ground(new_ground);
        }
        let before = (security(&vehicle).sessions, security(&ground).sessions);
        let attack = |vehicle: &mut Endpoint, ground: &mut Endpoint| {
            for up in &ups {
                assert!(hear(vehicle, up).iter().all(Result::is_err));
            }
            for down in &downs {
                assert!(hear(ground, down).iter().all(Result::is_err));
                // An old offer is answered, with an answer that suits nobody.
                let answer = handshake(ground);
                assert!(hear(vehicle, &answer).iter().all(Result::is_err));
            }
        };
        attack(&mut vehicle, &mut ground);
        assert_eq!(
            (security(&vehicle).sessions, security(&ground).sessions),
            before
        );
        connect(&mut vehicle, &mut ground);
        attack(&mut vehicle, &mut ground);
        works(&mut vehicle, &mut ground);
        attack(&mut vehicle, &mut ground);
        let sessions = (security(&vehicle).sessions, security(&ground).sessions);
        assert_eq!(sessions, (before.0 + 1, before.1 + 1));
    }
}

/// Why each start needs a nonce of its own: with the nonces of both ends as they were, an earlier
/// session is taken again.
#[test]
fn equal_starts_let_an_earlier_session_in() {
    let (mut vehicle, mut ground) = (vehicle(0), ground(0));
    let [_, answer, _] = connect(&mut vehicle, &mut ground);
    let up = say(&mut ground, &state(1));
    let mut restarted = super::tests::vehicle(0);
    hear(&mut restarted, &answer);
    assert_eq!(hear(&mut restarted, &up), [Ok(state(1))]);
    // With one of its own it is not.
    let mut restarted = super::tests::vehicle(1);
    hear(&mut restarted, &answer);
    assert!(hear(&mut restarted, &up)[0].is_err());
}

/// Recorded offers, answers and confirmations do not end a session, and leave nothing behind that
/// delays the next one.
#[test]
fn a_flood_of_handshakes_does_not_end_a_session() {
    let mut recorded = Vec::new();
    for start in 100..150 {
        let (mut vehicle, mut ground) = (vehicle(start), ground(start));
        recorded.extend(connect(&mut vehicle, &mut ground));
    }
    let (mut vehicle, mut ground) = connected();
    let flood = |vehicle: &mut Endpoint, ground: &mut Endpoint| {
        for frame in &recorded {
            hear(vehicle, frame);
            hear(ground, frame);
            let answer = handshake(ground);
            hear(vehicle, &answer);
        }
    };
    for _ in 0..4 {
        flood(&mut vehicle, &mut ground);
        works(&mut vehicle, &mut ground);
    }
    assert_eq!(
        (security(&vehicle).sessions, security(&ground).sessions),
        (1, 1)
    );
    // In the middle of a handshake: between the offer and its answer, and before the confirmation.
    let mut vehicle = super::tests::vehicle(1);
    let offer = handshake(&mut vehicle);
    flood(&mut vehicle, &mut ground);
    hear(&mut ground, &offer);
    let answer = handshake(&mut ground);
    flood(&mut vehicle, &mut ground);
    hear(&mut vehicle, &answer);
    let confirmation = handshake(&mut vehicle);
    flood(&mut vehicle, &mut ground);
    hear(&mut ground, &confirmation);
    works(&mut vehicle, &mut ground);
}

/// An answer that was held back ends a session once, and the next offer begins another.
#[test]
fn an_answer_that_was_held_back_costs_one_offer() {
    let (mut vehicle, mut ground) = (vehicle(0), ground(0));
    connect_with_a_lost_confirmation(&mut vehicle, &mut ground);
    // The vehicle's next offer is answered, because the ground is not sure of the session yet.
    vehicle.offer();
    let offer = handshake(&mut vehicle);
    hear(&mut ground, &offer);
    let held_back = handshake(&mut ground);
    works_down(&mut vehicle, &mut ground);
    works(&mut vehicle, &mut ground);
    assert!(hear(&mut vehicle, &held_back).is_empty());
    assert_eq!(security(&vehicle).sessions, 2);
    handshake(&mut vehicle);
    let down = say(&mut vehicle, &status(1));
    assert!(hear(&mut ground, &down)[0].is_err());
    // Once a slot the vehicle offers a session.
    connect(&mut vehicle, &mut ground);
    works(&mut vehicle, &mut ground);
    assert!(hear(&mut vehicle, &held_back)[0].is_err());
    works(&mut vehicle, &mut ground);
}

fn connect_with_a_lost_confirmation(vehicle: &mut Endpoint, ground: &mut Endpoint) {
    let offer = handshake(vehicle);
    hear(ground, &offer);
    let answer = handshake(ground);
    hear(vehicle, &answer);
    handshake(vehicle);
}

fn works_down(vehicle: &mut Endpoint, ground: &mut Endpoint) {
    let down = say(vehicle, &status(1));
    assert_eq!(hear(ground, &down), [Ok(status(1))]);
}

/// A million frames with a correct CRC: noise, and genuine headers and messages with tags that are
/// guessed. None is taken, and none disturbs the session.
#[test]
fn a_million_random_frames_are_refused() {
    let mut random = Pcg64Mcg::seed_from_u64(17);
    let (mut vehicle, mut ground) = connected();
    let genuine = plain(&say(&mut ground, &state(9)));
    let kinds = [
        plain(&{
            vehicle.offer();
            handshake(&mut vehicle)
        }),
        plain(&say(&mut vehicle, &status(9))),
        genuine,
    ];
    let mut decoder_input = Vec::new();
    let mut refused = 0;
    for round in 0..1_000_000_u32 {
        let mut bytes = kinds[random.random_range(0..3)].clone();
        let from = match round % 4 {
            // Noise; then a random nonce, counter or tag, and what follows it.
            0 => 1,
            1 => 2,
            2 => 18,
            _ => bytes.len() - 16,
        };
        random.fill_bytes(&mut bytes[from..]);
        if round % 4 == 2 {
            // A counter that would be in order.
            bytes[20..22].fill(0);
        }
        decoder_input.clear();
        decoder_input.extend(framed(&bytes));
        let end = if round % 2 == random.random_range(0..2) {
            &mut vehicle
        } else {
            &mut ground
        };
        for &byte in &decoder_input {
            if let Some(heard) = end.push::<f32, 2, 3>(byte) {
                assert!(heard.is_err(), "{round}");
                refused += 1;
            }
        }
    }
    assert_eq!(refused, 1_000_000);
    for end in [&vehicle, &ground] {
        assert_eq!((security(end).sessions, end.counters().messages), (1, 0));
        assert!(!end.is_handshake_due());
    }
    let (forged, other) = (security(&vehicle).forged, security(&vehicle).other_session);
    assert!(forged > 10_000 && other > 10_000, "{forged} {other}");
    works(&mut vehicle, &mut ground);
}

/// Something that happens on the way or to an end.
#[derive(Clone, Copy, Debug)]
enum Step {
    Offer,
    Deliver,
    Lose,
    Repeat,
    VehicleRestarts,
    GroundRestarts,
    Talk,
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    /// Whatever is lost, repeated and restarted: afterwards two offers that arrive bring the ends
    /// together, and each message was taken at most once.
    #[test]
    fn the_ends_come_together(steps in proptest::collection::vec(prop_oneof![
        4 => Just(Step::Offer),
        6 => Just(Step::Deliver),
        3 => Just(Step::Lose),
        2 => Just(Step::Repeat),
        1 => Just(Step::VehicleRestarts),
        1 => Just(Step::GroundRestarts),
        4 => Just(Step::Talk),
    ], 0..60)) {
        let (mut vehicle, mut ground) = (vehicle(0), ground(0));
        let (mut up, mut down): (Vec<Vec<u8>>, Vec<Vec<u8>>) = Default::default();
        let mut starts = 0;
        let mut said = 0;
        let mut taken = std::collections::BTreeSet::new();
        for step in steps {
            match step {
                Step::Offer => vehicle.offer(),
                Step::Deliver | Step::Repeat => {
                    for frame in down.drain(..) {
                        let again = matches!(step, Step::Repeat);
                        for _ in 0..if again { 2 } else { 1 } {
                            hear(&mut ground, &frame);
                            up.push(handshake(&mut ground));
                        }
                    }
                    for frame in up.drain(..) {
                        for heard in hear(&mut vehicle, &frame).into_iter().flatten() {
                            let Message::ChannelState(state) = heard else { panic!() };
                            prop_assert!(taken.insert(state.slot));
                        }
                        if matches!(step, Step::Repeat) {
                            let twice = hear(&mut vehicle, &frame);
                            prop_assert!(twice.iter().all(Result::is_err));
                        }
                    }
                }
                Step::Lose => {
                    up.clear();
                    down.clear();
                }
                Step::VehicleRestarts => {
                    starts += 1;
                    vehicle = super::tests::vehicle(starts);
                }
                Step::GroundRestarts => {
                    starts += 1;
                    ground = super::tests::ground(starts);
                }
                Step::Talk => {
                    said += 1;
                    let mut buffer = [0; FRAME_MAX];
                    up.extend(ground.encode(&state(said), &mut buffer).map(<[u8]>::to_vec));
                    down.extend(vehicle.encode(&status(said), &mut buffer).map(<[u8]>::to_vec));
                }
            }
            down.push(handshake(&mut vehicle));
        }
        for _ in 0..2 {
            vehicle.offer();
            for frame in [handshake(&mut vehicle), handshake(&mut vehicle)] {
                hear(&mut ground, &frame);
            }
            let answer = handshake(&mut ground);
            hear(&mut vehicle, &answer);
            let confirmation = handshake(&mut vehicle);
            hear(&mut ground, &confirmation);
        }
        works(&mut vehicle, &mut ground);
    }

    /// No byte stream makes an end panic or lets a message in.
    #[test]
    fn noise_is_refused(bytes in proptest::collection::vec(any::<u8>(), 0..3000)) {
        let (mut vehicle, mut ground) = connected();
        for end in [&mut vehicle, &mut ground] {
            prop_assert!(hear(end, &bytes).iter().all(Result::is_err));
        }
        let mut own = Decoder::new();
        for &byte in &bytes {
            let _ = vehicle.observe::<f32, 2, 3>(&mut own, byte);
        }
    }
}
