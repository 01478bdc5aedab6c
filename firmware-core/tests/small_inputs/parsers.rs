// SPDX-License-Identifier: MIT OR Apache-2.0
//! The readers of untrusted bytes: ground link, MAVLink, policy files.

use firmware_core::{
    Position,
    autopilot::wire::{self, Address, Encoder, MAX_FRAME},
    controller::Plan,
    link::{self, Arrival, Decoder, FRAME_MAX, FrameError, Message, PROTOCOL_VERSION},
    mavlink::dialects::common::{HEARTBEAT_DATA, MavMessage},
    policy::{
        Provenance,
        mlp::{Header, Mlp, write},
    },
    shield::Intervention,
    time::Tick,
};
use heapless::{String, Vec as FixedVec};

use crate::choices::each;

type GroundMessage = Message<f32, 2, 3>;

fn arrival() -> GroundMessage {
    Message::Arrival(Arrival {
        plan: Plan {
            slot: 7,
            waypoint: Position::new(30.0, 40.0),
            served_user: 1,
            intervention: Intervention::default(),
        },
        position: Position::new(31.0, 40.5),
        tick: Tick::default(),
    })
}

fn ground_frame() -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    let frame = link::encode(&arrival(), &mut buffer).expect("fits");
    frame.to_vec()
}

fn receive(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Result<GroundMessage, FrameError>> {
    bytes
        .iter()
        .filter_map(|&byte| decoder.push(byte))
        .collect()
}

/// Whatever came before, a frame arrives; what came before is no message, and each part of it between
/// delimiters is counted.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(80))]
fn a_ground_frame_arrives_after_any_bytes() {
    let frame = ground_frame();
    each(|choices| {
        let noise = choices.list(5, &[0, 1, 2, 3, PROTOCOL_VERSION, 0xFF]);
        let mut decoder = Decoder::new();
        let mut outcomes = receive(&mut decoder, &noise);
        outcomes.extend(receive(&mut decoder, &frame));
        assert_eq!(outcomes.pop(), Some(Ok(arrival())), "{noise:?}");
        assert!(outcomes.iter().all(Result::is_err), "{noise:?}");
        let parts = noise
            .split(|&byte| byte == 0)
            .filter(|part| !part.is_empty());
        assert_eq!(outcomes.len(), parts.count(), "{noise:?}");
        let counters = decoder.counters();
        let errors = counters.malformed + counters.checksum + counters.version + counters.message;
        assert_eq!(counters.messages, 1);
        assert_eq!(errors as usize, outcomes.len());
    });
}

/// Each byte of a frame with each other value: no other message, and the next frame arrives.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(80))]
fn a_damaged_ground_frame_is_no_message() {
    let frame = ground_frame();
    each(|choices| {
        let index = choices.below(frame.len());
        let difference = 1 + choices.below(255) as u8;
        let mut damaged = frame.clone();
        damaged[index] ^= difference;
        let mut decoder = Decoder::new();
        let mut outcomes = receive(&mut decoder, &damaged);
        // A damaged delimiter joins the frame to what comes before or behind it.
        let is_delimiter = index == 0 || index + 1 == frame.len();
        assert!(is_delimiter || outcomes.iter().all(Result::is_err));
        outcomes = receive(&mut decoder, &frame);
        assert_eq!(outcomes.pop(), Some(Ok(arrival())), "{index} {difference}");
    });
}

fn heartbeat_frame() -> Vec<u8> {
    let mut encoder = Encoder::new(Address {
        system: 1,
        component: 1,
    });
    let message = MavMessage::HEARTBEAT(HEARTBEAT_DATA::default());
    encoder.encode(&message, &mut [0; MAX_FRAME]).to_vec()
}

/// Returns the number of heartbeats in one datagram; anything else is an error.
fn heartbeats(decoder: &mut wire::Decoder, mut bytes: &[u8]) -> usize {
    let mut count = 0;
    let mut take = |frame: wire::Frame<'_>| {
        assert!(matches!(
            frame.client_message(),
            Ok(Some(MavMessage::HEARTBEAT(_)))
        ));
        count += 1;
    };
    while let Some(frame) = decoder.next_frame(&mut bytes) {
        take(frame);
    }
    while let Some(frame) = decoder.end_of_datagram() {
        take(frame);
    }
    assert!(bytes.is_empty());
    count
}

/// Whatever comes before a frame in a datagram, also what looks like the start of another one: the
/// frame is found. Only what looks like a message of another dialect, whose checksum cannot be
/// verified, hides it; and then the frame in the next datagram is found.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(300))]
fn a_mavlink_frame_is_found_after_any_bytes() {
    let frame = heartbeat_frame();
    each(|choices| {
        let noise = choices.list(5, &[0xFD, 0, 1, 9, 0xFF]);
        let bytes = [noise.as_slice(), &frame].concat();
        let mut decoder = wire::Decoder::new();
        let found = heartbeats(&mut decoder, &bytes);
        let hidden = decoder.counters().unknown_message as usize;
        assert_eq!(found, 1 - hidden, "{noise:?}");
        assert_eq!(heartbeats(&mut decoder, &frame), 1, "{noise:?}");
    });
}

/// Each byte of a frame with each other value: it is no frame, and the next datagram is read.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(300))]
fn a_damaged_mavlink_frame_is_refused() {
    let frame = heartbeat_frame();
    each(|choices| {
        let index = choices.below(frame.len());
        let difference = 1 + choices.below(255) as u8;
        let mut damaged = frame.clone();
        damaged[index] ^= difference;
        let mut decoder = wire::Decoder::in_order();
        assert_eq!(
            heartbeats(&mut decoder, &damaged),
            0,
            "{index} {difference}"
        );
        assert_eq!(heartbeats(&mut decoder, &frame), 1);
    });
}

fn text<const N: usize>(text: &str) -> String<N> {
    String::try_from(text).expect("short")
}

/// Returns the file of a network with one user and all numbers 0.
fn policy_file() -> Vec<u8> {
    let header = Header {
        provenance: Provenance {
            users: 1,
            max_speed_mps: 30.0,
            slot_duration_s: 1.0,
            area_m: [1000.0, 1000.0],
            algorithm: text("sac"),
            scenario: text("x"),
            scenario_digest: text("0123456789abcdef"),
            episodes: 1,
            seed: 1,
        },
        functions: Default::default(),
        reach_m: 30.0,
        sizes: FixedVec::from_slice(&[5, 2, 3]).expect("short"),
    };
    let numbers = core::iter::repeat_n(0.0, header.number_count());
    let mut file = vec![0; 512];
    let length = write(&header, numbers, &mut file).expect("fits");
    file.truncate(length);
    assert!(Mlp::load(&*file).is_ok());
    file
}

/// Each byte of a policy file with each other value, and each beginning of the file, is refused.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(520))]
fn a_damaged_policy_file_is_refused() {
    let file = policy_file();
    each(|choices| {
        let index = choices.below(file.len());
        let difference = choices.below(256) as u8;
        let mut damaged = file.clone();
        if difference == 0 {
            damaged.truncate(index);
        } else {
            damaged[index] ^= difference;
        }
        assert!(Mlp::load(&*damaged).is_err(), "{index} {difference}");
    });
}
