//! The authenticated ground link. The first byte chooses:
//!
//! * 0, 1: bytes as they come, for a vehicle and a ground that are in a session;
//! * 2: bytes as the message of a frame with a valid tag, which no fuzzer guesses; it is made here
//!   from the description in docs/link-protocol.md;
//! * 3: bytes as the header and message of a frame with a valid CRC and no tag of anybody;
//! * others: a script of what happens on the way and to the ends.
//!
//! Nothing is taken that the other end did not say in the present session, nothing twice, and two
//! offers that arrive bring the ends together.
#![no_main]

use std::collections::BTreeSet;

use firmware_core::{
    controller::ChannelState,
    link::{Credentials, Endpoint, FRAME_MAX, GroundKey, Message, SECURE_VERSION, VehicleStatus},
};
use hmac::{Hmac, KeyInit, Mac};
use libfuzzer_sys::fuzz_target;
use sha2::Sha256;

type TestMessage = Message<f32, 2, 3>;

const KEY: [u8; 32] = [7; 32];

fuzz_target!(|data: &[u8]| {
    let Some((&first, rest)) = data.split_first() else {
        return;
    };
    let (mut vehicle, mut ground) = (end(true, 0), end(false, 0));
    connect(&mut vehicle, &mut ground);
    match first % 8 {
        0 => refuse(&mut vehicle, rest),
        1 => refuse(&mut ground, rest),
        2 => {
            let key = tag(
                &KEY,
                &[&b"aircomp ground link 1"[..], &[2], &nonce(1, 0), &nonce(2, 0)].concat(),
            );
            let mut plain = vec![SECURE_VERSION, 2];
            plain.extend(nonce(2, 0));
            plain.extend(1_u32.to_le_bytes());
            plain.extend(rest);
            let whole = tag(&key, &plain);
            plain.extend(&whole[..16]);
            hear(&mut vehicle, &framed(&plain));
            let security = vehicle.security().expect("authenticated");
            let longest = plain.len() > FRAME_MAX - 10;
            assert!(security.refused() == 0 || longest, "a valid tag is refused");
        }
        3 => {
            let plain = [&[SECURE_VERSION], rest].concat();
            for end in [&mut vehicle, &mut ground] {
                refuse(end, &framed(&plain));
            }
        }
        _ => script(vehicle, ground, rest),
    }
});

fn end(is_vehicle: bool, start: u8) -> Endpoint {
    let key = GroundKey::new(KEY);
    let mut bytes = [if is_vehicle { 1 } else { 2 }; 12];
    bytes[11] = start;
    let credentials = Credentials { key, start: bytes };
    if is_vehicle {
        Endpoint::vehicle(credentials)
    } else {
        Endpoint::ground(credentials)
    }
}

fn nonce(end: u8, session: u32) -> Vec<u8> {
    let mut nonce = vec![end; 11];
    nonce.push(0);
    nonce.extend(session.to_le_bytes());
    nonce
}

fn tag(key: &[u8; 32], bytes: &[u8]) -> [u8; 32] {
    let mut mac = Hmac::<Sha256>::new_from_slice(key).expect("any length");
    mac.update(bytes);
    mac.finalize().into_bytes().into()
}

fn framed(plain: &[u8]) -> Vec<u8> {
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(plain);
    let plain = [plain, &checksum.to_le_bytes()].concat();
    let mut frame = vec![0; 1 + cobs::max_encoding_length(plain.len()) + 1];
    let length = cobs::encode(&plain, &mut frame[1..]);
    frame.truncate(length + 2);
    frame
}

fn hear(end: &mut Endpoint, bytes: &[u8]) -> Vec<TestMessage> {
    let heard = bytes.iter().filter_map(|&byte| end.push(byte));
    heard.filter_map(Result::ok).collect()
}

fn handshake(end: &mut Endpoint) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    end.take_handshake(&mut buffer).unwrap_or_default().to_vec()
}

fn say(end: &mut Endpoint, message: &TestMessage) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    end.encode(message, &mut buffer)
        .map_or_else(|_| Vec::new(), <[u8]>::to_vec)
}

fn state(slot: u32) -> TestMessage {
    Message::ChannelState(ChannelState {
        slot,
        user_gains: Default::default(),
        sensor_gains: Default::default(),
    })
}

fn connect(vehicle: &mut Endpoint, ground: &mut Endpoint) {
    vehicle.offer();
    // What is due may be a confirmation, and then the offer.
    for _ in 0..2 {
        hear(ground, &handshake(vehicle));
        hear(vehicle, &handshake(ground));
        vehicle.offer();
    }
    hear(ground, &handshake(vehicle));
    hear(vehicle, &handshake(ground));
    hear(ground, &handshake(vehicle));
}

/// Demands that both ends understand each other.
fn works(vehicle: &mut Endpoint, ground: &mut Endpoint) {
    let up = say(ground, &state(u32::MAX));
    assert_eq!(hear(vehicle, &up), [state(u32::MAX)]);
    let status = Message::Status(VehicleStatus::default());
    let down = say(vehicle, &status);
    assert_eq!(hear(ground, &down), [status]);
}

fn refuse(end: &mut Endpoint, bytes: &[u8]) {
    let sessions = end.security().expect("authenticated").sessions;
    assert!(hear(end, bytes).is_empty(), "taken without a tag");
    assert_eq!(end.security().expect("authenticated").sessions, sessions);
}

/// What an attacker has recorded is at most so many frames.
const RECORDED: usize = 64;

fn script(mut vehicle: Endpoint, mut ground: Endpoint, steps: &[u8]) {
    let mut starts = 0;
    let mut said = 0;
    let mut taken = BTreeSet::new();
    let mut recorded: Vec<Vec<u8>> = Vec::new();
    for pair in steps.chunks_exact(2) {
        let at = usize::from(pair[1]);
        let frame = match pair[0] % 8 {
            0 => {
                vehicle.offer();
                handshake(&mut vehicle)
            }
            1 => handshake(&mut vehicle),
            2 => handshake(&mut ground),
            3 => {
                said += 1;
                say(&mut ground, &state(said))
            }
            4 => say(&mut vehicle, &Message::Status(VehicleStatus::default())),
            5 => {
                starts = u8::saturating_add(starts, 1);
                let is_vehicle = at % 2 == 0;
                let restarted = end(is_vehicle, starts);
                if is_vehicle {
                    vehicle = restarted;
                } else {
                    ground = restarted;
                }
                Vec::new()
            }
            kind => {
                // An earlier frame, as it was or damaged.
                let Some(frame) = recorded.get(at % recorded.len().max(1)) else {
                    continue;
                };
                let mut frame = frame.clone();
                if kind == 7 {
                    let middle = frame.len() / 2;
                    frame[middle] ^= 1;
                }
                frame
            }
        };
        if starts == u8::MAX || frame.is_empty() {
            continue;
        }
        // It may be lost; the attacker records it all the same, and may send it to either end.
        if at & 0x80 == 0 {
            for message in hear(&mut vehicle, &frame) {
                let Message::ChannelState(state) = message else {
                    panic!("the vehicle takes what only it says");
                };
                assert!(taken.insert(state.slot), "taken twice");
                assert!(state.slot <= said);
            }
            for message in hear(&mut ground, &frame) {
                assert!(matches!(message, Message::Status(_)));
            }
        }
        if recorded.len() == RECORDED {
            recorded.remove(0);
        }
        recorded.push(frame);
    }
    connect(&mut vehicle, &mut ground);
    works(&mut vehicle, &mut ground);
}
