//! The ground link from the receiver's end: bytes as they come, and, because no fuzzer guesses a
//! CRC, bytes as the body of a sound frame. What decodes is then used: no state that can arrive
//! may make the controller panic or command something that is not a number.
#![no_main]

use std::sync::LazyLock;

use ::link::audit::LinkAuditor;
use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    controller::{ChannelQuality, ChannelState, Controller},
    link::{self, Arrival, Decoder, FRAME_MAX, Message, PROTOCOL_VERSION, frame_max},
    policy::StraightLine,
    time::Tick,
};
use libfuzzer_sys::fuzz_target;
use scenario::Scenario;

type HostMessage = Message<f64, USERS_MAX, SENSORS_MAX>;
type HostQuality = ChannelQuality<USERS_MAX, SENSORS_MAX>;

static SCENARIO: LazyLock<Scenario> =
    LazyLock::new(|| Scenario::shipped("separated").expect("shipped"));

fuzz_target!(|data: &[u8]| {
    let Some((&first, rest)) = data.split_first() else {
        return;
    };
    if first % 2 == 0 {
        receive(rest);
    } else {
        receive(&sealed(rest));
    }
});

/// A frame around any bytes.
fn sealed(body: &[u8]) -> Vec<u8> {
    let mut plain = vec![PROTOCOL_VERSION];
    plain.extend_from_slice(body);
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&plain);
    plain.extend_from_slice(&checksum.to_le_bytes());
    let mut frame = vec![0; 1 + cobs::max_encoding_length(plain.len()) + 1];
    let length = cobs::encode(&plain, &mut frame[1..]);
    frame.truncate(length + 2);
    frame
}

fn receive(bytes: &[u8]) {
    let mut wide = Decoder::<FRAME_MAX>::new();
    // A receiver of fewer users and sensors, in single precision: what is too long for it is dropped.
    let mut narrow = Decoder::<{ frame_max::<f32>(2, 3) }>::new();
    let mut quality = HostQuality::default();
    for &byte in bytes {
        let _ = narrow.push::<f32, 2, 3>(byte);
        let outcome: Option<Result<HostMessage, _>> = wide.push(byte);
        if let Some(Ok(message)) = outcome {
            // What was understood can be said again.
            frame(&message);
            match message {
                Message::ChannelState(state) => allocate(state, &quality),
                Message::Quality(noted) => {
                    quality = noted;
                    let state = ChannelState::predicted(
                        &SCENARIO.mission,
                        1,
                        &SCENARIO.mission.parameters().start,
                    );
                    allocate(state, &quality);
                }
                _ => {}
            }
        }
    }
    let mut auditor = LinkAuditor::new(SCENARIO.mission.clone());
    auditor.to_vehicle(bytes);
    auditor
        .check_link_counters(wide.counters())
        .expect("each piece is counted once");
}

fn frame(message: &HostMessage) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    let frame = link::encode(message, &mut buffer);
    frame.expect("every message fits").to_vec()
}

/// The quality, or as much of it as fits, and the state for slot 1, or as much of it as fits, then a
/// slot without a state.
fn allocate(mut state: ChannelState<f64, USERS_MAX, SENSORS_MAX>, quality: &HostQuality) {
    let mission = &SCENARIO.mission;
    state.slot = 1;
    let mut auditor = LinkAuditor::new(mission.clone());
    let say = |auditor: &mut LinkAuditor<f64>, message| {
        let audited = auditor.from_vehicle(&frame(&message));
        audited.expect("a message that keeps the rules");
    };
    let mut controller = Controller::new(mission.clone(), StraightLine::new(mission));
    let position = mission.parameters().start;
    let arrival = |plan| {
        Message::Arrival(Arrival {
            plan,
            position,
            tick: Tick::default(),
        })
    };
    let plan = controller.plan(position).expect("at rest");
    say(&mut auditor, arrival(plan));
    let mut note = |controller: &mut Controller<_, _>, quality: &HostQuality| {
        auditor.to_vehicle(&frame(&Message::Quality(quality.clone())));
        controller.note_quality(quality).is_ok()
    };
    if !note(&mut controller, quality) {
        // As if it had had every entry: the ones it has, over and over.
        let (users, sensors) = (quality.users.iter(), quality.sensors.iter());
        let _ = note(
            &mut controller,
            &HostQuality {
                slot: 1,
                users: users.cycle().take(mission.user_count()).copied().collect(),
                sensors: sensors
                    .cycle()
                    .take(mission.sensor_count())
                    .copied()
                    .collect(),
            },
        );
    }
    let hear = |auditor: &mut LinkAuditor<f64>, state: &ChannelState<f64, _, _>| {
        auditor.to_vehicle(&frame(&Message::ChannelState(state.clone())));
    };
    hear(&mut auditor, &state);
    let command = controller.allocate(&state).or_else(|_| {
        // As if it had had every gain: the ones it has, over and over.
        let gains = state.user_gains.iter().chain(&state.sensor_gains).copied();
        let gains: Vec<_> = gains.collect();
        let mut gains = gains.into_iter().cycle();
        state.user_gains = gains.by_ref().take(mission.user_count()).collect();
        state.sensor_gains = gains.take(mission.sensor_count()).collect();
        hear(&mut auditor, &state);
        controller.allocate(&state)
    });
    let Ok(command) = command else {
        let none = state.user_gains.is_empty() && state.sensor_gains.is_empty();
        assert!(none, "as many gains as asked were refused: {state:?}");
        return;
    };
    say(&mut auditor, Message::Command(command));
    let plan = controller.plan(position).expect("at rest");
    say(&mut auditor, arrival(plan));
    let command = controller.allocate_predicted(&position).expect("under way");
    say(&mut auditor, Message::Command(command));
}
