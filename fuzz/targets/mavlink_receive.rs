//! The MAVLink receive path: bytes as they come, frames with a right checksum around any payload,
//! and time that passes, against the whole onboard computer. What it then sends is sound.
#![no_main]

use std::sync::LazyLock;

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    autopilot::{Autopilot, AutopilotSettings, wire},
    controller::Controller,
    link::FRAME_MAX,
    onboard::{self, Onboard},
    policy::StraightLine,
    time::{Duration, Instant},
};
use host_sim::flight::autopilot_settings;
use libfuzzer_sys::fuzz_target;
use mavlink::{Message, dialects::common::MavMessage};
use scenario::Scenario;
use vehicle::Profile;

static START: LazyLock<(Scenario, AutopilotSettings<f64>)> = LazyLock::new(|| {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let settings = autopilot_settings(&scenario, Profile::Multirotor);
    (scenario, settings)
});

/// What the client listens to, so that a byte names a message.
const HEARD: [u32; 16] = [
    0, 1, 22, 24, 30, 32, 33, 44, 47, 51, 73, 77, 147, 230, 242, 253,
];

fuzz_target!(|data: &[u8]| {
    let (scenario, settings) = &*START;
    let mission = &scenario.mission;
    let controller: Controller<f64, _, USERS_MAX, SENSORS_MAX> =
        Controller::new(mission.clone(), StraightLine::new(mission));
    let client = Autopilot::new(settings.clone()).expect("settings that fit");
    let mut onboard = Onboard::new(onboard::OnboardSettings::default(), controller, client);
    let mut now = Instant::ZERO;
    onboard.autopilot_mut().launch(now);
    let mut sequence = 0_u8;
    let mut input = data;
    // Each step: how long it takes and what comes, a length, and that many bytes.
    while let Some(([head, length], rest)) = input.split_first_chunk::<2>() {
        let (bytes, rest) = rest.split_at(rest.len().min(usize::from(*length)));
        input = rest;
        now = now + Duration::from_millis(u64::from(head >> 4) * 20);
        match head & 0xf {
            0 => onboard.receive_mavlink(now, bytes, false),
            1 => onboard.receive_mavlink(now, bytes, true),
            2 => onboard.receive_ground(now, bytes),
            kind => {
                let Some((&name, payload)) = bytes.split_first() else {
                    continue;
                };
                let id = HEARD[usize::from(name) % HEARD.len()];
                // The vehicle, its gimbal, another vehicle.
                let (system, component) = [(1, 1), (1, 154), (2, 1)][usize::from(kind) % 3];
                let frame = sealed(id, sequence, system, component, payload);
                sequence = sequence.wrapping_add(1);
                onboard.receive_mavlink(now, &frame, true);
            }
        }
        onboard.poll(now, &mut ());
        let mut mavlink = [0; wire::MAX_FRAME];
        let mut decoder = wire::Decoder::new();
        while let Some(mut frame) = onboard.take_mavlink_frame(now, &mut mavlink) {
            let sound = decoder.next_frame(&mut frame).expect("a whole frame");
            sound.message().expect("a message");
        }
        let mut ground = [0; FRAME_MAX];
        while onboard.take_ground_frame(&mut ground).is_some() {}
        while onboard.autopilot_mut().take_next_event().is_some() {}
    }
});

/// A MAVLink 2 frame with a right checksum around any payload.
fn sealed(id: u32, sequence: u8, system: u8, component: u8, payload: &[u8]) -> Vec<u8> {
    let payload = &payload[..payload.len().min(255)];
    let [low, middle, high, _] = id.to_le_bytes();
    let mut frame = vec![0xfd, payload.len() as u8, 0, 0, sequence, system, component];
    frame.extend_from_slice(&[low, middle, high]);
    frame.extend_from_slice(payload);
    let checksum = mavlink::calculate_crc(&frame[1..], MavMessage::extra_crc(id));
    frame.extend_from_slice(&checksum.to_le_bytes());
    frame
}
