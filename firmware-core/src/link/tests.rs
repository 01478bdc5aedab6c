// SPDX-License-Identifier: MIT OR Apache-2.0

use super::{frame::CHECKSUM, *};
use crate::{
    Watt,
    controller::{
        ChannelQuality, ChannelSource, ChannelState, DatedChange, Plan, SensorQuality, SlotCommand,
        UserQuality,
    },
    inner::*,
    mission::MissionChange,
    scalar::Position,
    shield::Intervention,
    test_missions::table_one,
    time::Tick,
    time::{Duration, Instant},
    units::PowerGain,
};
use proptest::prelude::*;
use std::vec::Vec as StdVec;

type HostMessage = Message<f64, 16, 64>;

fn channel_state(slot: u32) -> HostMessage {
    let mission = table_one::<f64>();
    Message::ChannelState(ChannelState::predicted(
        &mission,
        slot,
        &Position::new(400.0, 300.0),
    ))
}

fn largest_command() -> HostMessage {
    Message::Command(SlotCommand {
        slot: u32::MAX,
        served_user: Some(15),
        user_power: Watt(0.2),
        sensor_coefficients: (0..64).map(|_| 0.123_456_789).collect(),
        normalizing_factor: 1e6,
        rate: 1.0,
        mse: 0.015,
        status: Status::Infeasible { least_mse: 0.016 },
        source: ChannelSource::Predicted,
        age_slots: u32::MAX,
        rejected_gains: u16::MAX,
        unheard_sensors: u16::MAX,
    })
}

fn largest_state() -> HostMessage {
    Message::ChannelState(ChannelState {
        slot: u32::MAX,
        user_gains: (0..16).map(|_| PowerGain(1e-12)).collect(),
        sensor_gains: (0..64).map(|_| PowerGain(1.1e-11)).collect(),
    })
}

fn frame(message: &HostMessage) -> StdVec<u8> {
    let mut buffer = [0; FRAME_MAX];
    encode(message, &mut buffer).unwrap().to_vec()
}

fn receive(bytes: &[u8]) -> (StdVec<Result<HostMessage, FrameError>>, LinkCounters) {
    let mut decoder = Decoder::<FRAME_MAX>::new();
    let seen = bytes
        .iter()
        .filter_map(|&byte| decoder.push(byte))
        .collect();
    (seen, *decoder.counters())
}

#[test]
fn messages_survive_and_fit() {
    for message in [
        channel_state(7),
        largest_command(),
        largest_state(),
        change(),
        quality(),
        largest_quality(),
    ] {
        let bytes = frame(&message);
        assert_eq!(receive(&bytes).0, [Ok(message)]);
    }
}

/// The bytes of a frame are a format: a change of them is a new version.
#[test]
fn the_format_is_stable() {
    let message: HostMessage = Message::Arrival(Arrival {
        plan: Plan {
            slot: 300,
            waypoint: Position::new(1.0, -2.0),
            served_user: 3,
            intervention: Intervention {
                user: true,
                ..Intervention::default()
            },
        },
        position: Position::new(1.0, -2.5),
        tick: Tick {
            time: Instant::from_micros(300),
            lateness: Duration::from_micros(5),
            extrapolated: true,
            clock_rate: 1.0,
        },
    });
    assert_eq!(
        frame(&message),
        [
            0, 5, 4, 1, 172, 2, 1, 1, 1, 1, 1, 3, 240, 63, 1, 1, 1, 1, 1, 1, 3, 192, 3, 2, 1, 1, 1,
            1, 1, 1, 1, 1, 3, 240, 63, 1, 1, 1, 1, 1, 7, 4, 192, 172, 2, 5, 1, 1, 7, 128, 63, 35,
            231, 26, 234, 0
        ]
    );
    assert_eq!(
        frame(&change()),
        [
            0, 6, 4, 4, 1, 172, 2, 2, 15, 1, 1, 1, 1, 1, 3, 240, 63, 1, 1, 1, 1, 1, 1, 6, 192, 139,
            204, 42, 219, 0
        ]
    );
    assert_eq!(
        frame(&quality()),
        [
            0, 6, 4, 6, 172, 2, 2, 3, 171, 2, 1, 7, 171, 25, 88, 141, 82, 111, 0
        ]
    );
}

/// A buffer suffices from the length on that COBS can need for the message, and every smaller one is
/// an error.
#[test]
fn too_small_a_buffer_is_an_error() {
    for message in [channel_state(1), largest_state(), full_status()] {
        let mut plain = frame(&message);
        plain.pop();
        let plain = cobs::decode_in_place(&mut plain[1..]).expect("a frame");
        let needed = 1 + cobs::max_encoding_length(plain) + 1;
        for capacity in 0..=frame_max::<f64>(16, 64) {
            let mut buffer = [0; FRAME_MAX];
            let outcome = encode(&message, &mut buffer[..capacity]);
            if capacity < needed {
                assert_eq!(outcome, Err(FrameTooLong { capacity }));
            } else {
                assert!(outcome.is_ok(), "{capacity} of {needed}");
            }
        }
    }
}

#[test]
fn another_version_is_named() {
    let mut plain = [9u8, 9, 9, 0, 0, 0, 0];
    let checksum = CHECKSUM.checksum(&plain[..3]).to_le_bytes();
    plain[3..].copy_from_slice(&checksum);
    let mut bytes = [0; 16];
    let length = cobs::encode(&plain, &mut bytes);
    assert_eq!(
        receive(&bytes[..=length]).0,
        [Err(FrameError::Version { got: 9 })]
    );
}

#[test]
fn a_flood_is_dropped_and_the_next_frame_arrives() {
    let mut bytes = std::vec![7u8; 10 * FRAME_MAX];
    bytes.push(0);
    bytes.extend(frame(&channel_state(1)));
    let (seen, counters) = receive(&bytes);
    assert_eq!(seen, [Err(FrameError::TooLong), Ok(channel_state(1))]);
    assert_eq!((counters.messages, counters.dropped()), (1, 1));
}

/// Everything at its longest.
fn full_status() -> HostMessage {
    let count = u32::MAX;
    let counters = [[0xff; 4].as_slice(), &[0x0f]].concat();
    let mut bytes = counters.repeat(VehicleStatus::COUNTERS);
    // A plan: two numbers and a flag.
    bytes.extend([1, 1, 2, 3, 4, 1, 2, 3, 4, 1]);
    let (status, rest): (VehicleStatus, _) =
        postcard::take_from_bytes(&bytes).expect("as many counters as are claimed");
    assert!(rest.is_empty(), "fewer counters than are claimed");
    assert_eq!(status.slots_done, count);
    assert!(status.plan.is_some());
    Message::Status(status)
}

fn change() -> HostMessage {
    Message::Change(NumberedChange {
        number: 1,
        change: DatedChange {
            from_slot: 300,
            change: MissionChange::User {
                user: 15,
                position_m: Position::new(1.0, -2.0),
            },
        },
    })
}

/// Of one user and one sensor that are known exactly, and one of each that are not.
fn quality() -> HostMessage {
    let known = |variance, phase| SensorQuality::new(variance, phase).expect("valid");
    let user = |variance| UserQuality::new(variance).expect("valid");
    Message::Quality(ChannelQuality {
        slot: 300,
        users: [user(0.0), user(0.1)].into_iter().collect(),
        sensors: [known(0.0, 0.0), known(0.1, 0.3)].into_iter().collect(),
    })
}

fn largest_quality() -> HostMessage {
    let worst = SensorQuality::new(10.0, core::f64::consts::PI).expect("valid");
    Message::Quality(ChannelQuality {
        slot: u32::MAX,
        users: (0..16)
            .map(|_| UserQuality::new(10.0).expect("valid"))
            .collect(),
        sensors: (0..64).map(|_| worst).collect(),
    })
}

/// The bound is the length of the longest message, not a guess above it: channel state, here.
#[test]
fn the_longest_frame_is_known() {
    for message in [
        largest_command(),
        largest_state(),
        full_status(),
        largest_quality(),
    ] {
        assert!(frame(&message).len() <= FRAME_MAX);
    }
    // COBS may save two bytes in a bound of three; lengths below 128 take one byte, not three.
    let longest = frame(&largest_state()).len();
    let most = frame_max::<f64>(16, 64);
    assert!((most - 8..=most).contains(&longest), "{longest} of {most}");
    // Kind, nonce, counter and tag: 37 bytes, which COBS does not lengthen.
    assert_eq!((most, FRAME_MAX), (662, 699));
}

/// So is it at capacities where another message is the longest: few users leave the command, and
/// few sensors the status.
#[test]
fn the_bound_is_that_of_the_longest_message() {
    let mut command = largest_command();
    if let Message::Command(command) = &mut command {
        command.served_user = Some(usize::MAX);
    }
    // Lengths below 128 take one byte of the three that the bound has for each.
    for (users, sensors, message, lengths) in [
        (16, 64, largest_state(), 2),
        (1, 64, command, 1),
        (1, 1, full_status(), 0),
    ] {
        let mut bytes = frame(&message);
        bytes.pop();
        let plain = cobs::decode_in_place(&mut bytes[1..]).expect("a frame");
        let longest = 1 + cobs::max_encoding_length(plain + 2 * lengths) + 1;
        assert_eq!(
            longest,
            frame_max::<f64>(users, sensors),
            "{users} {sensors}"
        );
    }
}

/// The messages that the bound leaves out fit where it is shortest.
#[test]
fn the_longest_arrival_and_change_are_shorter_than_a_status() {
    let place = Position::new(1.0, -2.0);
    let arrival = Message::Arrival(Arrival {
        plan: Plan {
            slot: u32::MAX,
            waypoint: place,
            served_user: usize::MAX,
            intervention: Intervention {
                displacement: true,
                user: true,
                broken_output: true,
                out_of_reach: true,
            },
        },
        position: place,
        tick: Tick {
            time: Instant::from_micros(u64::MAX),
            lateness: Duration::from_micros(u64::MAX),
            extrapolated: true,
            clock_rate: 1.0,
        },
    });
    let change = |change| {
        Message::Change(NumberedChange {
            number: u32::MAX,
            change: DatedChange {
                from_slot: u32::MAX,
                change,
            },
        })
    };
    let changes = [
        MissionChange::User {
            user: u16::MAX,
            position_m: place,
        },
        MissionChange::UserLeft { user: u16::MAX },
        MissionChange::Sensor {
            sensor: u16::MAX,
            position_m: place,
        },
        MissionChange::SensorLeft { sensor: u16::MAX },
        MissionChange::MseThreshold(0.1),
        MissionChange::NoisePower(Watt(1e-12)),
        MissionChange::MaxSpeed(30.0),
        MissionChange::Slots(u32::MAX),
    ];
    for message in changes.map(change).into_iter().chain([arrival]) {
        let length = frame(&message).len();
        assert!(length < frame_max::<f64>(0, 0), "{message:?}: {length}");
    }
}

/// Something that happens to bytes on their way.
#[derive(Clone, Debug)]
enum Damage {
    Flip(usize, u8),
    Lose(usize, usize),
    Insert(usize, StdVec<u8>),
    Repeat(usize, usize),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = || 0usize..1_000_000;
    prop_oneof![
        (at(), 0u8..8).prop_map(|(at, bit)| Damage::Flip(at, bit)),
        (at(), 1usize..900).prop_map(|(at, length)| Damage::Lose(at, length)),
        // Delimiters are what confuses most.
        (
            at(),
            proptest::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 1..900)
        )
            .prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
        (at(), 1usize..900).prop_map(|(at, length)| Damage::Repeat(at, length)),
    ]
}

impl Damage {
    fn apply(&self, bytes: &mut StdVec<u8>) {
        if bytes.is_empty() {
            return;
        }
        match self {
            Self::Flip(at, bit) => {
                let at = at % bytes.len();
                bytes[at] ^= 1 << bit;
            }
            Self::Lose(at, length) => {
                let at = at % bytes.len();
                bytes.drain(at..(at + length).min(bytes.len()));
            }
            Self::Insert(at, more) => {
                let at = at % bytes.len();
                bytes.splice(at..at, more.iter().copied());
            }
            Self::Repeat(at, length) => {
                let at = at % bytes.len();
                let again = bytes[at..(at + length).min(bytes.len())].to_vec();
                bytes.splice(at..at, again);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    /// Damage costs the frames that it touches and no other: what was sent before the first
    /// damaged byte and after the last one arrives, delimiters lost or not, and nothing arrives
    /// that was not sent.
    #[test]
    fn damage_is_contained(
        done in proptest::collection::vec(damage(), 1..5),
        inside in 1u32..4,
    ) {
        let mut bytes = frame(&channel_state(1));
        let mut damaged: StdVec<u8> =
            (0..inside).flat_map(|n| frame(&channel_state(2 + n))).collect();
        for damage in &done {
            damage.apply(&mut damaged);
        }
        bytes.extend(damaged);
        bytes.extend(frame(&channel_state(9)));
        let (seen, counters) = receive(&bytes);
        prop_assert_eq!(seen.first(), Some(&Ok(channel_state(1))));
        prop_assert_eq!(seen.last(), Some(&Ok(channel_state(9))));
        for outcome in seen.iter().flatten() {
            prop_assert!((1..10).any(|slot| *outcome == channel_state(slot)));
        }
        let good = seen.iter().filter(|outcome| outcome.is_ok()).count();
        prop_assert_eq!(counters.messages as usize, good);
        prop_assert_eq!(counters.dropped() as usize, seen.len() - good);
    }

    #[test]
    fn noise_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..3000)) {
        let (_, counters) = receive(&bytes);
        prop_assert_eq!(counters.messages, 0);
    }
}
