//! What a received byte costs at most, in instructions, whatever a sender on the two radio links
//! makes up.
//!
//! A stream is as long as the queue of a serial line. Each part is a kind of streams, 200 of them;
//! what is printed is the cost of the dearest stream, and the mean, each divided by its bytes.
//! `cargo xtask firmware bench` runs this under `-icount shift=6`, where an instruction takes 64 ns
//! of the timer's time.
#![no_std]
#![no_main]

use cortex_m_semihosting::hprintln;
use firmware::board::{
    Board,
    mps2::{self, Mps2},
};
use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    autopilot::wire::{
        self, Address, Encoder, MAX_FRAME,
        signing::{self, LinkSigning, SigningKey, SigningState},
    },
    link::{self, Credentials, Endpoint, FRAME_MAX, GroundKey},
};
use mavlink::dialects::common::{LOCAL_POSITION_NED_DATA, MavMessage};

/// Nanoseconds of an instruction at `-icount shift=6`.
const NANOS_PER_INSTRUCTION: u64 = 64;
/// The bytes of a stream: a queue of the board.
const STREAM: usize = 1024;
const STREAMS: u32 = 200;
const FORGER: Address = Address {
    system: 1,
    component: 1,
};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(board) = Mps2::take() else {
        unreachable!("the board is taken once");
    };
    mavlink_unsigned(&board);
    mavlink_signed(&board);
    ground_open(&board);
    ground_authenticated(&board);
    mps2::succeed()
}

/// xorshift, for noise.
struct Noise(u32);

impl Noise {
    fn byte(&mut self) -> u8 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        (self.0 >> 16) as u8
    }

    fn stream(&mut self) -> [u8; STREAM] {
        core::array::from_fn(|_| self.byte())
    }
}

/// Repeats these bytes from the `offset`-th on.
fn repeated(bytes: &[u8], offset: u32) -> [u8; STREAM] {
    let mut all = bytes.iter().cycle().skip(offset as usize % bytes.len());
    core::array::from_fn(|_| *all.next().expect("not empty"))
}

/// Measures what `receive` spends on each stream of one kind.
fn measure(
    board: &Mps2,
    name: &str,
    mut stream: impl FnMut(u32) -> [u8; STREAM],
    mut receive: impl FnMut(&[u8]),
) {
    let (mut worst, mut sum) = (0_u32, 0_u64);
    for index in 0..STREAMS {
        let bytes = stream(index);
        let begun = board.cycles();
        receive(&bytes);
        let cycles = board.cycles().wrapping_sub(begun);
        worst = worst.max(cycles);
        sum += u64::from(cycles);
    }
    let per_byte = |cycles: u64, bytes: u64| {
        (cycles * u64::from(Mps2::NANOS_PER_CYCLE)).div_ceil(NANOS_PER_INSTRUCTION * bytes)
    };
    hprintln!(
        "{{\"part\":\"{}\",\"worst\":{},\"mean\":{},\"count\":{}}}",
        name,
        per_byte(worst.into(), STREAM as u64),
        per_byte(sum, STREAM as u64 * u64::from(STREAMS)),
        STREAM as u64 * u64::from(STREAMS)
    );
}

/// As `Onboard::receive_mavlink` reads a serial line.
fn read(decoder: &mut wire::Decoder, mut bytes: &[u8]) -> u32 {
    let mut messages = 0;
    while let Some(frame) = decoder.next_frame(&mut bytes) {
        messages += u32::from(matches!(frame.client_message(), Ok(Some(_))));
    }
    messages
}

fn mavlink_unsigned(board: &Mps2) {
    let mut decoder = wire::Decoder::in_order();
    let mut noise = Noise(1);
    let receive = |bytes: &[u8]| {
        read(&mut decoder, bytes);
    };
    measure(board, "MAVLink: noise", |_| noise.stream(), receive);

    // Start bytes as close together as headers of a known message with a long payload allow: each
    // makes the decoder compute a checksum over 265 bytes, and then begin at the next one. The
    // message is DEBUG (254), and the other fields overlap.
    let header = |length, id| [0xFD, length, 0, 0, 0, 0, 0, id, 0, 0];
    let overlapping = [
        0xFD, 254, 0, 0xFD, 254, 0, 0xFD, 254, 0, 0, 254, 0, 0, 254, 0, 0,
    ];
    let mut decoder = wire::Decoder::in_order();
    measure(
        board,
        "MAVLink: crafted",
        |index| match index % 2 {
            0 => repeated(&overlapping, index / 2),
            _ => repeated(&header(255, 254), index / 2),
        },
        |bytes| {
            read(&mut decoder, bytes);
        },
    );
    assert!(decoder.counters().bad_checksum > STREAM as u32 * STREAMS / 10);

    // Telemetry as it comes, the cheapest honest stream: what the other figures are compared with.
    let mut frame = [0; MAX_FRAME];
    let mut encoder = Encoder::new(FORGER);
    let mut decoder = wire::Decoder::new();
    let mut messages = 0;
    let telemetry = encoder.encode(&position(), &mut frame);
    measure(
        board,
        "MAVLink: telemetry",
        |index| repeated(telemetry, index),
        |bytes| messages += read(&mut decoder, bytes),
    );
    assert!(messages > 0);
}

fn position() -> MavMessage {
    MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
        x: 1.0,
        y: 2.0,
        z: -100.0,
        vx: 20.0,
        vy: 21.0,
        vz: 0.1,
        ..LOCAL_POSITION_NED_DATA::default()
    })
}

fn with_key(key: u8) -> LinkSigning {
    LinkSigning {
        key: SigningKey::new([key; 32]),
        link: 0,
        state: SigningState::default(),
    }
}

/// Frames with a good checksum and a wrong signature: each costs a SHA-256.
fn mavlink_signed(board: &Mps2) {
    let mut encoder = Encoder::new(FORGER);
    signing::start(&mut wire::Decoder::new(), &mut encoder, with_key(2));
    // All zeros, which MAVLink 2 cuts off: the shortest frame.
    let shortest = MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA::default());
    let mut frame = [0; MAX_FRAME];
    let forged = encoder.encode(&shortest, &mut frame);
    let mut decoder = wire::Decoder::in_order();
    signing::start(&mut decoder, &mut Encoder::new(FORGER), with_key(1));
    measure(
        board,
        "MAVLink: signatures",
        |index| repeated(forged, index),
        |bytes| {
            read(&mut decoder, bytes);
        },
    );
    let counters = decoder.counters();
    assert!(counters.frames == 0 && counters.bad_signature > STREAMS * 30);
}

fn push(end: &mut Endpoint, bytes: &[u8]) -> u32 {
    let mut messages = 0;
    for &byte in bytes {
        let message = end.push::<f32, USERS_MAX, SENSORS_MAX>(byte);
        messages += u32::from(matches!(message, Some(Ok(_))));
    }
    messages
}

fn ground_open(board: &Mps2) {
    let mut noise = Noise(2);
    let mut end = Endpoint::new();
    measure(
        board,
        "ground link: noise",
        |_| noise.stream(),
        |bytes| {
            push(&mut end, bytes);
        },
    );
    // The shortest good frames.
    let mut frame = [0; FRAME_MAX];
    let status = link::Message::<f32, USERS_MAX, SENSORS_MAX>::Security(Default::default());
    let Ok(frame) = link::encode(&status, &mut frame) else {
        panic!("a frame that does not fit");
    };
    let mut end = Endpoint::new();
    let mut messages = 0;
    measure(
        board,
        "ground link: short frames",
        |index| repeated(frame, index),
        |bytes| messages += push(&mut end, bytes),
    );
    assert!(messages > STREAMS);
}

fn credentials(key: u8, start: u8) -> Credentials {
    Credentials {
        key: GroundKey::new([key; 32]),
        start: [start; 12],
    }
}

/// Carries what is due from one end to the other.
fn carry(from: &mut Endpoint, to: &mut Endpoint) -> [u8; FRAME_MAX] {
    let mut frame = [0; FRAME_MAX];
    let Some(sent) = from.take_handshake(&mut frame) else {
        panic!("no handshake is due");
    };
    push(to, sent);
    frame
}

/// Forged frames: each is tried with the key of the session, and with that of the session which it
/// might begin, if the forger names the ground's nonce, which anybody can hear.
fn ground_authenticated(board: &Mps2) {
    let mut vehicle = Endpoint::vehicle(credentials(1, 1));
    let mut ground = Endpoint::ground(credentials(1, 2));
    carry(&mut vehicle, &mut ground);
    carry(&mut ground, &mut vehicle);
    carry(&mut vehicle, &mut ground);
    assert!(vehicle.has_session() && ground.has_session());

    // The same nonces, and another key.
    let mut duped = Endpoint::vehicle(credentials(3, 1));
    let mut forger = Endpoint::ground(credentials(3, 2));
    carry(&mut duped, &mut forger);
    let answer = carry(&mut forger, &mut duped);
    let length = 1 + answer.iter().skip(1).position(|&b| b == 0).expect("an end") + 1;
    measure(
        board,
        "ground link: forged",
        |index| repeated(&answer[..length], index),
        |bytes| {
            let messages = push(&mut vehicle, bytes);
            assert!(messages == 0);
        },
    );
    let forged = vehicle.security().map(|counters| counters.forged);
    assert!(forged.is_some_and(|count| count > STREAMS * 20));
}
