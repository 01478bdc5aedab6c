// SPDX-License-Identifier: MIT OR Apache-2.0
//! Decoding of frames among noise, truncated and damaged frames, and other dialects.

use std::{vec, vec::Vec};

use mavlink::dialects::common::{
    EstimatorStatusFlags, HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavMessage,
    MavModeFlag, MavState, MavType,
};
use proptest::prelude::*;

use super::layout::START;
use super::*;
use crate::counter::MavlinkCounters;

pub(super) const OWN: Address = Address {
    system: 7,
    component: 191,
};

pub(super) fn position(x: f32) -> MavMessage {
    MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
        x,
        ..LOCAL_POSITION_NED_DATA::DEFAULT
    })
}

pub(super) fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 4,
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

pub(super) fn decode(decoder: &mut Decoder, mut bytes: &[u8]) -> Vec<MavMessage> {
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
