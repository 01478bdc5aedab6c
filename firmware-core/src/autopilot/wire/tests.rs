//! Decoding of frames among noise, truncated and damaged frames, and other dialects.

use std::{vec, vec::Vec};

use mavlink::dialects::common::{
    EstimatorStatusFlags, HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavMessage,
    MavModeFlag, MavState, MavType,
};
use proptest::prelude::*;

use super::layout::{SIGNATURE, START};
use super::signing::{Signer, SigningKey, Verifier};
use super::*;
use crate::counter::MavlinkCounters;

const OWN: Address = Address {
    system: 7,
    component: 191,
};

fn position(x: f32) -> MavMessage {
    MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
        x,
        ..LOCAL_POSITION_NED_DATA::DEFAULT
    })
}

fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 4,
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

fn decode(decoder: &mut Decoder, mut bytes: &[u8]) -> Vec<MavMessage> {
    let mut found = Vec::new();
    while let Some(frame) = decoder.next_frame(&mut bytes) {
        found.push(frame.message().unwrap());
    }
    found
}

#[test]
fn a_heartbeat_has_the_bytes_of_the_standard() {
    let mut buffer = [0; MAX_FRAME];
    let mut encoder = Encoder::new(OWN);
    let frame = encoder.encode(&heartbeat(), &mut buffer).to_vec();
    // Payload in wire order: custom_mode, type 18, autopilot 8, base_mode 0, status 4, version 3.
    assert_eq!(frame[..10], [0xFD, 9, 0, 0, 0, 7, 191, 0, 0, 0]);
    assert_eq!(frame[10..19], [4, 0, 0, 0, 18, 8, 0, 4, 3]);
    assert_eq!(frame.len(), 21);
    assert_eq!(encoder.encode(&heartbeat(), &mut buffer)[4], 1, "sequence");
}

#[test]
fn ardupilots_estimate_is_read_as_the_common_one() {
    let mut buffer = [0; MAX_FRAME];
    let flags = EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_ABS
        | EstimatorStatusFlags::ESTIMATOR_PRED_POS_HORIZ_ABS;
    let mut encoder = Encoder::new(OWN);
    let bytes = encoder.encode_ekf_status_report(flags, &mut buffer);
    let found = decode(&mut Decoder::new(), bytes);
    let [MavMessage::ESTIMATOR_STATUS(status)] = &found[..] else {
        panic!("{found:?}")
    };
    assert_eq!(status.flags, flags);
}

#[test]
fn a_truncated_datagram_holds_nothing_back() {
    let mut buffer = [0; MAX_FRAME];
    let mut encoder = Encoder::new(OWN);
    let frame = encoder.encode(&position(1.0), &mut buffer).to_vec();
    let mut decoder = Decoder::new();
    assert!(decode(&mut decoder, &frame[..frame.len() - 5]).is_empty());
    assert!(decoder.end_of_datagram().is_none());
    assert_eq!(decode(&mut decoder, &frame).len(), 1);
}

#[test]
fn frames_of_other_dialects_are_stepped_over_and_counted() {
    let mut buffer = [0; MAX_FRAME];
    let mut encoder = Encoder::new(OWN);
    // AHRS2 (178) of ardupilotmega, with a start byte in its payload.
    let mut stream = std::vec![START, 3, 0, 0, 0, 1, 1, 178, 0, 0, START, 200, 0, 9, 9];
    stream.extend_from_slice(encoder.encode(&position(2.0), &mut buffer));
    let mut decoder = Decoder::new();
    assert_eq!(decode(&mut decoder, &stream).len(), 1);
    assert_eq!(decoder.counters().unknown_message, 1);
    assert_eq!(decoder.counters().bad_checksum, 0);
}

#[test]
fn duplicates_and_late_frames_are_dropped_where_order_counts() {
    let mut encoder = Encoder::new(OWN);
    let frames: Vec<Vec<u8>> = (0..300)
        .map(|n| {
            encoder
                .encode(&position(n as f32), &mut [0; MAX_FRAME])
                .to_vec()
        })
        .collect();
    let order = [0, 1, 1, 3, 2, 4, 299, 298, 0, 1];
    let mut decoder = Decoder::in_order();
    let mut got = Vec::new();
    for n in order {
        for message in decode(&mut decoder, &frames[n]) {
            if let MavMessage::LOCAL_POSITION_NED(p) = message {
                got.push(p.x as usize);
            }
        }
    }
    // 299 has the sequence number 43; 0 after it is a sender that has restarted.
    assert_eq!(got, [0, 1, 3, 4, 299, 0, 1]);
    assert_eq!(decoder.counters().out_of_order, 3);
}

/// 2026-01-01, microseconds since 1970.
const NOW_US: u64 = 1_767_225_600_000_000;

fn signed(key: u8, link: u8, unix_us: u64) -> Encoder {
    let mut encoder = Encoder::new(OWN);
    encoder.sign_with(Signer::new(SigningKey::new([key; 32]), link, unix_us));
    encoder
}

fn verifying(key: u8) -> Decoder {
    let mut decoder = Decoder::new();
    decoder.require_signatures(Verifier::new(SigningKey::new([key; 32]), NOW_US));
    decoder
}

#[test]
fn only_rightly_signed_fresh_frames_pass() {
    let mut buffer = [0; MAX_FRAME];
    let mut decoder = verifying(1);
    let mut encoder = signed(1, 0, NOW_US);
    let good = encoder.encode(&position(1.0), &mut buffer).to_vec();
    assert_eq!(good.len(), 10 + 24 + 2 + 13 - (24 - good[1] as usize));
    assert_eq!(decode(&mut decoder, &good).len(), 1);
    // The same again, unsigned, with another key, damaged in the signature, a minute too old.
    assert!(decode(&mut decoder, &good).is_empty());
    let unsigned = Encoder::new(OWN)
        .encode(&position(2.0), &mut buffer)
        .to_vec();
    assert!(decode(&mut decoder, &unsigned).is_empty());
    let other = signed(2, 0, NOW_US)
        .encode(&position(2.0), &mut buffer)
        .to_vec();
    assert!(decode(&mut decoder, &other).is_empty());
    let mut damaged = encoder.encode(&position(2.0), &mut buffer).to_vec();
    *damaged.last_mut().unwrap() ^= 1;
    assert!(decode(&mut decoder, &damaged).is_empty());
    let old = signed(1, 3, NOW_US - 61_000_000)
        .encode(&position(2.0), &mut buffer)
        .to_vec();
    assert!(decode(&mut decoder, &old).is_empty());
    let counters = decoder.counters();
    assert_eq!(
        (counters.replayed, counters.unsigned, counters.bad_signature),
        (2, 1, 2)
    );
    assert_eq!(
        decode(&mut decoder, encoder.encode(&position(3.0), &mut buffer)).len(),
        1
    );
    // A reader without a key takes signed frames as they are.
    assert_eq!(decode(&mut Decoder::new(), &good).len(), 1);
}

#[test]
fn a_signature_has_the_bytes_of_the_standard() {
    // Computed apart from this crate (hashlib): key 0..31, link 7, time 1234567.
    let mut buffer = [0; MAX_FRAME];
    let mut key = [0; 32];
    key.iter_mut().zip(0..).for_each(|(byte, n)| *byte = n);
    let unix_us = 1_420_070_400_000_000 + 10 * (1_234_567 - 1);
    let mut encoder = Encoder::new(OWN);
    encoder.sign_with(Signer::new(SigningKey::new(key), 7, unix_us));
    let frame = encoder.encode(&heartbeat(), &mut buffer);
    let (_, tail) = frame.split_at(frame.len() - SIGNATURE);
    assert_eq!(tail[..7], [7, 0x87, 0xD6, 0x12, 0, 0, 0]);
    assert_eq!(tail[7..], [139, 119, 113, 148, 14, 54]);
}

/// MavlinkCounters stay at their largest value, as those of the ground link do: 0 always means none.
#[test]
fn counters_do_not_wrap() {
    let mut decoder = Decoder::in_order();
    let largest = MavlinkCounters {
        frames: u32::MAX,
        bad_checksum: u32::MAX,
        unknown_message: u32::MAX,
        unknown_flags: u32::MAX,
        skipped_bytes: u32::MAX - 1,
        out_of_order: u32::MAX,
        unsigned: u32::MAX,
        bad_signature: u32::MAX,
        replayed: u32::MAX,
    };
    decoder.counters = largest;
    let mut buffer = [0; MAX_FRAME];
    let frame = Encoder::new(OWN).encode(&heartbeat(), &mut buffer).to_vec();
    let mut damaged = frame.clone();
    damaged[12] ^= 1;
    let mut foreign = frame.clone();
    foreign[7..10].fill(0xEE);
    let mut flagged = frame.clone();
    flagged[2] = 0x80;
    for bytes in [&frame, &frame, &damaged, &foreign, &flagged, &vec![7; 9]] {
        decode(&mut decoder, bytes);
        while decoder.end_of_datagram().is_some() {}
    }
    let expected = MavlinkCounters {
        skipped_bytes: u32::MAX,
        ..largest
    };
    assert_eq!(decoder.counters(), expected);
    assert_eq!(expected.refused(), u32::MAX);
}

proptest! {
    #![proptest_config(ProptestConfig {
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        ..ProptestConfig::with_cases(300)
    })]

    /// Frames in noise without start bytes, cut at any place, all come out, in order.
    #[test]
    fn frames_survive_noise_and_any_cutting(
        xs in proptest::collection::vec(-1e6f32..1e6, 1..20),
        noise in proptest::collection::vec(0u8..0xFD, 0..40),
        piece in 1usize..300,
    ) {
        let mut buffer = [0; MAX_FRAME];
        let mut encoder = Encoder::new(OWN);
        let mut stream = Vec::new();
        for &x in &xs {
            stream.extend_from_slice(&noise);
            stream.extend_from_slice(encoder.encode(&position(x), &mut buffer));
        }
        let mut decoder = Decoder::new();
        let mut got = Vec::new();
        for piece in stream.chunks(piece) {
            for message in decode(&mut decoder, piece) {
                if let MavMessage::LOCAL_POSITION_NED(p) = message { got.push(p.x) }
            }
        }
        prop_assert_eq!(got, xs.clone());
        prop_assert_eq!(decoder.counters().skipped_bytes as usize, noise.len() * xs.len());
    }

    /// No bytes cause a panic, and a good frame after them is found at the latest when the datagram
    /// ends.
    #[test]
    fn any_bytes_are_survived(junk in proptest::collection::vec(any::<u8>(), 0..2000)) {
        let mut buffer = [0; MAX_FRAME];
        let frame = Encoder::new(OWN).encode(&position(3.0), &mut buffer).to_vec();
        let mut decoder = Decoder::new();
        let mut input = &junk[..];
        while let Some(frame) = decoder.next_frame(&mut input) { let _ = frame.message(); }
        while let Some(frame) = decoder.end_of_datagram() { let _ = frame.message(); }
        prop_assert_eq!(decode(&mut decoder, &frame).len(), 1);
    }

    /// A frame with one wrong bit is never accepted.
    #[test]
    fn a_wrong_bit_is_noticed(x in -1e6f32..1e6, byte in 1usize..40, bit in 0u32..8) {
        let mut buffer = [0; MAX_FRAME];
        let mut frame = Encoder::new(OWN).encode(&position(x), &mut buffer).to_vec();
        let at = byte % frame.len();
        frame[at] ^= 1 << bit;
        let mut decoder = Decoder::new();
        let mut input = &frame[..];
        prop_assert!(decoder.next_frame(&mut input).is_none());
        prop_assert!(decoder.end_of_datagram().is_none());
    }
}
