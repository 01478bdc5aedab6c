// SPDX-License-Identifier: MIT OR Apache-2.0
//! Controllers, links, planners and whole onboard computers of many capacities: each is created, and
//! works with as many users and sensors as it holds.

use std::iter;

use firmware_core::{
    Mission, Position, PowerGain, Scalar,
    autopilot::{Autopilot, AutopilotSettings, frames::Geodetic},
    controller::{ChannelState, Controller},
    link::{Credentials, GroundKey},
    link::{Decoder, Endpoint, HANDSHAKE_FRAME_MAX, Message, encode, secure_frame_max},
    mission::MissionParameters,
    onboard::{Onboard, OnboardSettings, Stage},
    planner::{Capacity, Planner},
    policy::StraightLine,
    time::Instant,
};

/// A mission with as many users and sensors as there can be.
fn full_mission<T: Scalar, const M: usize, const J: usize>() -> Mission<T, M, J> {
    let place = |index: usize, east_m: f64| {
        let (column, row) = ((index % 32) as f64, (index / 32) as f64);
        Position::new(T::of(east_m + 12.0 * column), T::of(50.0 + 25.0 * row))
    };
    let mission = Mission::new(MissionParameters {
        slots: 2 * M as u32,
        max_speed_mps: T::of(1000.0),
        mse_threshold: T::of(0.5 / J as f64),
        users: (0..M).map(|user| place(user, 20.0)).collect(),
        sensors: (0..J).map(|sensor| place(sensor, 500.0)).collect(),
        ..MissionParameters::table_one()
    });
    mission.expect("a valid mission")
}

/// The longest channel state of a slot.
fn full_state<T: Scalar, const M: usize, const J: usize>(slot: u32) -> ChannelState<T, M, J> {
    let gain = |index: usize| PowerGain(T::of(1e-12 * (1.0 + index as f64)));
    ChannelState {
        slot,
        user_gains: (0..M).map(gain).collect(),
        sensor_gains: (0..J).map(gain).collect(),
    }
}

fn client<T: Scalar>(mission: &MissionParameters<T, 0, 0>) -> Autopilot<T> {
    let p = mission;
    let origin = Geodetic {
        latitude_e7: -353_632_621,
        longitude_e7: 1_491_652_374,
    };
    let settings = AutopilotSettings::new(origin, p.start, p.altitude_m, p.max_speed_mps);
    Autopilot::new(settings).expect("valid settings")
}

/// Two slots, one with a channel state and one without.
fn control<T: Scalar, const M: usize, const J: usize>() {
    let mission = full_mission::<T, M, J>();
    let mut controller = Controller::new(mission.clone(), StraightLine::new(&mission));
    let plan = controller
        .plan(mission.parameters().start)
        .expect("at rest");
    let command = controller.allocate(&full_state(plan.slot)).expect("a plan");
    assert_eq!(command.sensor_coefficients.len(), J);
    assert_eq!((command.rejected_gains, command.unheard_sensors), (0, 0));
    command.check(&mission).expect("within its limits");
    let plan = controller.plan(plan.waypoint).expect("at rest");
    let command = controller.allocate_predicted(&plan.waypoint);
    command
        .expect("a plan")
        .check(&mission)
        .expect("within its limits");
}

/// The longest messages of an authenticated link cross it, in frames of `F` bytes.
fn connect<T: Scalar, const M: usize, const J: usize, const F: usize>() {
    let credentials = |start| Credentials {
        key: GroundKey::new([7; 32]),
        start: [start; 12],
    };
    let mut vehicle = Endpoint::<F>::vehicle(credentials(1));
    let mut ground = Endpoint::<F>::ground(credentials(2));
    let mut handshake = [0; HANDSHAKE_FRAME_MAX];
    for _ in 0..2 {
        for (from, to) in [(true, false), (false, true)] {
            let (from, to) = match (from, to) {
                (true, _) => (&mut vehicle, &mut ground),
                _ => (&mut ground, &mut vehicle),
            };
            for &byte in from.take_handshake(&mut handshake).unwrap_or_default() {
                assert_eq!(to.push::<T, M, J>(byte), None);
            }
        }
    }
    assert!(vehicle.has_session() && ground.has_session());
    let state = Message::<T, M, J>::ChannelState(full_state(u32::MAX));
    let mut frame = [0; F];
    let sent = ground.encode(&state, &mut frame).expect("it fits");
    let received: Vec<_> = sent.iter().filter_map(|&byte| vehicle.push(byte)).collect();
    assert_eq!(received, [Ok(state.clone())]);
    // Without authentication, from one byte to the next.
    let mut decoder = Decoder::<F>::new();
    let sent = encode(&state, &mut frame).expect("it fits");
    let received: Vec<_> = sent.iter().filter_map(|&byte| decoder.push(byte)).collect();
    assert_eq!(received, [Ok(state)]);
}

/// An onboard computer is created and sends its first frames.
fn start<T: Scalar, const M: usize, const J: usize, const F: usize>() {
    type Computer<T, const M: usize, const J: usize, const F: usize> =
        Onboard<T, StraightLine<T, M>, M, J, firmware_core::inner::ExactSolver, F>;
    let mission = full_mission::<T, M, J>();
    let policy = StraightLine::new(&mission);
    let mut computer = Computer::<T, M, J, F>::with_frames(
        OnboardSettings::default(),
        Controller::new(mission, policy),
        client(&MissionParameters::table_one()),
    );
    computer.authenticate_ground(Credentials {
        key: GroundKey::new([7; 32]),
        start: [1; 12],
    });
    let now = Instant::from_micros(10_000);
    computer.launch(now);
    computer.receive_ground(now, &[0; F]);
    computer.poll(now, &mut ());
    let mut frame = [0; F];
    assert!(computer.take_ground_frame(&mut frame).is_some(), "an offer");
    assert_eq!(computer.stage(), Stage::Preparing);
}

/// A planner makes its first plan.
fn plan<T: Scalar, const M: usize, const J: usize>() {
    let mission = full_mission::<T, M, J>();
    let capacity = Capacity {
        nodes: 9,
        stages: 2,
        ..Capacity::new(mission.slots() as usize, M)
    };
    let zero = T::zero();
    let numbers: Vec<T> = iter::repeat_n(zero, capacity.values()).collect();
    let memory = (numbers, vec![0_u8; capacity.indices()]);
    let mut planner = Planner::new(&mission, capacity, memory).expect("it fits");
    planner.advance(100_000);
    assert!(planner.waypoint(1).is_some());
}

macro_rules! capacities {
    ($($name:ident: $m:literal users, $j:literal sensors;)*) => {$(
        #[test]
        fn $name() {
            // The planner's and the computer's largest are larger than the stack of a test.
            let run = || {
                control::<f32, $m, $j>();
                control::<f64, $m, $j>();
                connect::<f32, $m, $j, { secure_frame_max::<f32>($m, $j) }>();
                connect::<f64, $m, $j, { secure_frame_max::<f64>($m, $j) }>();
                start::<f32, $m, $j, { secure_frame_max::<f32>($m, $j) }>();
                start::<f64, $m, $j, { secure_frame_max::<f64>($m, $j) }>();
                plan::<f32, $m, $j>();
                plan::<f64, $m, $j>();
            };
            let large = std::thread::Builder::new().stack_size(64 << 20);
            large.spawn(run).expect("a thread").join().expect("no panic");
        }
    )*};
}

capacities! {
    one_user_and_one_sensor: 1 users, 1 sensors;
    four_users_and_eight_sensors: 4 users, 8 sensors;
    sixty_six_sensors: 16 users, 66 sensors;
    forty_users_and_a_hundred_sensors: 40 users, 100 sensors;
    more_users_than_sensors: 256 users, 3 sensors;
    a_thousand_sensors: 256 users, 1024 sensors;
}
