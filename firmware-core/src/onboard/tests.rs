// SPDX-License-Identifier: MIT OR Apache-2.0
//! Signatures of an onboard computer without a clock, and qualities of channels.

use mavlink::dialects::common::{
    HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState, MavType, SYSTEM_TIME_DATA,
};

use super::{Onboard, OnboardSettings};
use crate::{
    Position,
    autopilot::{
        Autopilot, AutopilotSettings,
        frames::Geodetic,
        wire::{
            Address, Encoder, MAX_FRAME,
            signing::{LinkSigning, Signer, SigningKey, SigningState, SigningTime},
        },
    },
    controller::{ChannelQuality, Controller, SensorQuality, UserQuality},
    link::{FRAME_MAX, Message, encode},
    policy::StraightLine,
    test_missions::table_one,
    time::Instant,
};

type Computer = Onboard<f64, StraightLine<f64, 16>, 16, 64>;

const AUTOPILOT: Address = Address {
    system: 1,
    component: 1,
};
const CAMERA: Address = Address {
    system: 1,
    component: 100,
};

fn computer(signing: Option<LinkSigning>) -> Computer {
    let mission = table_one::<f64>();
    let origin = Geodetic {
        latitude_e7: -353_632_621,
        longitude_e7: 1_491_652_374,
    };
    let start = Position::new(50.0, 50.0);
    let settings = AutopilotSettings::new(origin, start, 100.0, 30.0);
    let policy = StraightLine::new(&mission);
    let mut computer = Onboard::new(
        OnboardSettings::default(),
        Controller::new(mission, policy),
        Autopilot::new(settings).unwrap(),
    );
    if let Some(signing) = signing {
        computer.sign_with(signing);
    }
    computer
}

fn setup() -> LinkSigning {
    LinkSigning {
        key: SigningKey::new([1; 32]),
        link: 3,
        state: SigningState::default(),
    }
}

fn sender(own: Address, key: u8, unix_us: u64) -> Encoder {
    let time = SigningTime::from_unix_us(unix_us).unwrap();
    let mut encoder = Encoder::new(own);
    encoder.sign_with(Signer::new(SigningKey::new([key; 32]), 0, time));
    encoder
}

fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_STANDBY,
        mavlink_version: 3,
    })
}

fn system_time(time_unix_usec: u64) -> MavMessage {
    MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
        time_unix_usec,
        time_boot_ms: 1,
    })
}

fn receive(computer: &mut Computer, from: &mut Encoder, message: &MavMessage) {
    let mut buffer = [0; MAX_FRAME];
    let frame = from.encode(message, &mut buffer);
    computer.receive_mavlink(Instant::from_micros(1), frame, true);
}

fn time(computer: &Computer) -> SigningTime {
    computer.signing_state().unwrap().time
}

/// 2026-01-01, and an hour later.
const BOOTED_US: u64 = 1_767_225_600_000_000;
const LATER_US: u64 = BOOTED_US + 3_600_000_000;

/// The date in a SYSTEM_TIME counts if the autopilot that is flown has signed it, and nothing else.
#[test]
fn the_date_is_that_of_the_autopilot() {
    let mut computer = computer(Some(setup()));
    let mut autopilot = sender(AUTOPILOT, 1, BOOTED_US);
    assert_eq!(time(&computer), SigningTime::UNKNOWN);
    receive(&mut computer, &mut autopilot, &heartbeat());
    let heard = time(&computer);
    assert_eq!(heard, autopilot.signer().unwrap().time());

    let later = system_time(LATER_US);
    receive(&mut computer, &mut sender(AUTOPILOT, 2, BOOTED_US), &later);
    receive(&mut computer, &mut Encoder::new(AUTOPILOT), &later);
    assert_eq!(time(&computer), heard, "forged");
    receive(&mut computer, &mut sender(CAMERA, 1, BOOTED_US), &later);
    assert_eq!(time(&computer), heard, "another component");
    // Clocks that were not set, or show what no clock can.
    for date in [0, 60_000_000, u64::MAX] {
        receive(&mut computer, &mut autopilot, &system_time(date));
        assert_eq!(time(&computer), autopilot.signer().unwrap().time());
    }

    receive(&mut computer, &mut autopilot, &later);
    assert_eq!(
        time(&computer),
        SigningTime::from_unix_us(LATER_US).unwrap()
    );
    // It never goes back.
    autopilot.signer_mut().unwrap().advance_to(time(&computer));
    receive(&mut computer, &mut autopilot, &system_time(BOOTED_US));
    assert_eq!(time(&computer), autopilot.signer().unwrap().time());
}

/// What is sent after the first frame of the autopilot has its time and our link id.
#[test]
fn the_computer_signs_with_the_time_of_the_autopilot() {
    let mut computer = computer(Some(setup()));
    receive(
        &mut computer,
        &mut sender(AUTOPILOT, 1, BOOTED_US),
        &heartbeat(),
    );
    let heard = time(&computer);
    let mut buffer = [0; MAX_FRAME];
    let now = Instant::from_micros(2_000_000);
    let frame = computer.take_mavlink_frame(now, &mut buffer).unwrap();
    let tail = &frame[frame.len() - 13..];
    assert_eq!(tail[0], 3);
    assert_eq!(tail[1..7], (heard.units() + 1).to_le_bytes()[..6]);
    assert_eq!(time(&computer).units(), heard.units() + 1);
}

#[test]
fn a_computer_without_a_key_has_no_state_and_ignores_the_date() {
    let mut computer = computer(None);
    let mut autopilot = Encoder::new(AUTOPILOT);
    receive(&mut computer, &mut autopilot, &heartbeat());
    receive(&mut computer, &mut autopilot, &system_time(LATER_US));
    computer.set_signing_time(LATER_US);
    assert_eq!(computer.signing_state(), None);
    computer.sign_with(setup());
    assert_eq!(time(&computer), SigningTime::UNKNOWN);
}

/// A quality is in effect when it is received. One of a slot to come, one that is older, and one with
/// a wrong number of entries are counted and ignored.
#[test]
fn the_quality_in_effect_is_the_last_one_of_the_right_size() {
    type Quality = ChannelQuality<16, 64>;
    let mut computer = computer(None);
    let hear = |computer: &mut Computer, quality: &Quality| {
        let message = Message::<f64, 16, 64>::Quality(quality.clone());
        let mut buffer = [0; FRAME_MAX];
        let frame = encode(&message, &mut buffer).expect("fits");
        computer.receive_ground(Instant::from_micros(1), frame);
        let slots = computer.status().slots;
        (slots.states_out_of_turn, slots.states_of_wrong_size)
    };
    let mission = table_one::<f64>();
    let of = |slot, variance| {
        let user = UserQuality::new(variance).expect("valid");
        let sensor = SensorQuality::new(variance, 0.1).expect("valid");
        Quality::uniform(&mission, slot, user, sensor)
    };
    let first = of(1, 0.1);
    assert_eq!(hear(&mut computer, &of(2, 0.2)), (1, 0));
    assert!(computer.controller().quality().is_exact());
    assert_eq!(hear(&mut computer, &first), (1, 0));
    assert_eq!(computer.controller().quality(), &first);
    assert_eq!(hear(&mut computer, &of(0, 0.3)), (2, 0));
    let mut short = of(1, 0.3);
    short.sensors.pop();
    assert_eq!(hear(&mut computer, &short), (2, 1));
    let mut long = of(1, 0.3);
    long.users.push(UserQuality::default()).expect("space");
    assert_eq!(hear(&mut computer, &long), (2, 2));
    assert_eq!(computer.controller().quality(), &first);
    // Another one of the same slot replaces it.
    assert_eq!(hear(&mut computer, &of(1, 0.4)), (2, 2));
    assert_eq!(computer.controller().quality(), &of(1, 0.4));
    let status = computer.status();
    assert_eq!((status.link.messages, status.slots.echoes), (6, 0));
}
