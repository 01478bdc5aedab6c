// SPDX-License-Identifier: MIT OR Apache-2.0
//! Laws of the MAVLink client that hold for *any* order of messages, answers, calls and time.
//!
//! A model observes the client from outside: it tracks what was last reported to the client about
//! mode and arming, and checks every message that the client sends.

use std::cell::RefCell;

use firmware_core::MotionLimits;
use firmware_core::Position;
use firmware_core::autopilot::frames::Geodetic;
use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::wire::Address;
use firmware_core::autopilot::{
    Autopilot, AutopilotSettings, Coordinates, Event, Geofence, Leg, Phase, failsafe::Reaction,
};
use firmware_core::time::{Duration, Instant};
use mavlink::dialects::common::{
    COMMAND_ACK_DATA, ESTIMATOR_STATUS_DATA, EstimatorStatusFlags, GPS_GLOBAL_ORIGIN_DATA,
    HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavCmd, MavMessage, MavModeFlag,
    MavResult, MavState, MavSysStatusSensor, MavType, PARAM_VALUE_DATA, SYS_STATUS_DATA,
};
use mavlink::types::CharArray;
use proptest::prelude::*;
use proptest::test_runner::{RngSeed, TestRunner};

#[derive(Clone, Debug)]
enum Action {
    Wait(u64),
    Heartbeat {
        mode: u8,
        armed: bool,
    },
    Stranger {
        mode: u8,
        armed: bool,
    },
    Answer {
        command: u8,
        result: u8,
    },
    /// An answer to whatever was asked last.
    Accept,
    Position {
        x: f32,
        y: f32,
        altitude: f32,
        late: u32,
    },
    Broken,
    Status {
        prearm: bool,
        battery: i8,
    },
    Estimate(bool),
    Launch,
    Leg {
        x: f64,
        y: f64,
        millis: u64,
    },
    Land,
    Return,
    Stop,
    /// A well-behaved autopilot for a while: answers, arms, climbs.
    Cooperate(u8),
}

fn action() -> impl Strategy<Value = Action> {
    use Action as A;
    let coordinate = prop_oneof![
        16 => -110.0..210.0f64,
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(1e30)
    ];
    prop_oneof![
        6 => (1u64..3000).prop_map(A::Wait),
        4 => (0u8..5, any::<bool>()).prop_map(|(mode, armed)| A::Heartbeat { mode, armed }),
        1 => (0u8..5, any::<bool>()).prop_map(|(mode, armed)| A::Stranger { mode, armed }),
        4 => (0u8..8, 0u8..8).prop_map(|(command, result)| A::Answer { command, result }),
        4 => Just(A::Accept),
        4 => (-80.0f32..200.0, -80.0f32..200.0, 0.0f32..120.0, 0u32..200)
            .prop_map(|(x, y, altitude, late)| A::Position { x, y, altitude, late }),
        1 => Just(A::Broken),
        2 => (any::<bool>(), -1i8..100).prop_map(|(prearm, battery)| A::Status { prearm, battery }),
        2 => any::<bool>().prop_map(A::Estimate),
        3 => Just(A::Launch),
        8 => (coordinate.clone(), coordinate, 0u64..2000)
            .prop_map(|(x, y, millis)| A::Leg { x, y, millis }),
        1 => Just(A::Land),
        1 => Just(A::Return),
        1 => Just(A::Stop),
        8 => (1u8..60).prop_map(A::Cooperate),
    ]
}

const VEHICLE: Address = Address {
    system: 1,
    component: 1,
};
/// The value of every parameter, which limits the speed.
const PARAMETER: f32 = 12.0;
const STRANGER: Address = Address {
    system: 9,
    component: 1,
};

fn fence() -> Geofence<f64> {
    Geofence {
        low: Position::new(-100.0, -100.0),
        high: Position::new(200.0, 200.0),
        ceiling_m: 110.0,
    }
}

struct Model {
    now: Instant,
    firmware: Firmware,
    client: Autopilot<f64>,
    /// The state that was last reported to the client.
    mode: Option<u32>,
    armed: bool,
    /// The mode and arming of the last heartbeat that was sent.
    told_armed: bool,
    position: (f32, f32),
    altitude: f32,
    /// The altitude before take-off, and the height that a take-off climbs from there.
    stood: f32,
    rises: f32,
    /// The lowest and the highest altitude reported before take-off: the ground is in between.
    ground: (f32, f32),
    /// When a position was last reported.
    placed: Option<Instant>,
    faulted: bool,
    released: bool,
    launched: bool,
    was_in_control: bool,
    last_command: Option<MavCmd>,
    /// The parameter that was asked for, or set, and what it then is.
    asked_for: Option<(CharArray<16>, f32)>,
    may_set: bool,
    parameters_set: u32,
    parameters_restored: u32,
    reached: Vec<Phase>,
}

impl Model {
    fn new(firmware: Firmware, coordinates: Coordinates, limited: bool) -> Self {
        let origin = Geodetic::from_degrees(10.0, 20.0).unwrap();
        let mut settings = AutopilotSettings::new(origin, Position::new(10.0, 20.0), 100.0, 30.0);
        settings.geofence = Some(fence());
        settings.coordinates = coordinates;
        settings.set_parameters = limited;
        if limited {
            settings.limits = MotionLimits {
                speed_mps: 20.0,
                acceleration_mps2: 5.0,
                jerk_mps3: 20.0,
            };
        }
        Self {
            now: Instant::ZERO,
            firmware,
            client: Autopilot::new(settings).unwrap(),
            mode: None,
            armed: false,
            told_armed: false,
            position: (20.0, 10.0),
            altitude: 0.0,
            stood: 0.0,
            rises: 100.0,
            ground: (f32::INFINITY, f32::NEG_INFINITY),
            placed: None,
            faulted: false,
            released: false,
            launched: false,
            was_in_control: false,
            last_command: None,
            asked_for: None,
            may_set: limited,
            parameters_set: 0,
            parameters_restored: 0,
            reached: vec![],
        }
    }

    fn mode_number(&self, choice: u8) -> u32 {
        match choice {
            0 | 1 => self.firmware.control_mode().0,
            2 => self.firmware.land_mode().0,
            3 => self.firmware.return_mode().0,
            _ => 5,
        }
    }

    fn heartbeat(&self, mode: u32, armed: bool) -> MavMessage {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: mode,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: match self.firmware {
                Firmware::Generic => MavAutopilot::MAV_AUTOPILOT_GENERIC,
                Firmware::ArduCopter => MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
                Firmware::Px4 => MavAutopilot::MAV_AUTOPILOT_PX4,
            },
            base_mode: if armed {
                MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED
            } else {
                MavModeFlag::empty()
            },
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        })
    }

    fn tell(&mut self, message: &MavMessage) {
        self.client.receive(self.now, VEHICLE, message);
        self.judge();
    }

    fn tell_heartbeat(&mut self, mode: u32, armed: bool) {
        (self.mode, self.armed, self.told_armed) = (Some(mode), armed, armed);
        let message = self.heartbeat(mode, armed);
        self.tell(&message);
    }

    fn tell_position(&mut self, late: u32) {
        let (x, y) = self.position;
        let z = -self.altitude;
        if x.is_finite() && y.is_finite() {
            self.placed = Some(self.now);
        }
        if !self.client.phase().is_flying() && self.client.phase() != Phase::TakingOff {
            self.stood = self.altitude;
            let (low, high) = self.ground;
            self.ground = (low.min(self.altitude), high.max(self.altitude));
        }
        let time_boot_ms = self.now.millis_wrapping().saturating_sub(late);
        let message = LOCAL_POSITION_NED_DATA {
            time_boot_ms,
            x,
            y,
            z,
            vx: 1.0,
            vy: -1.0,
            vz: 0.0,
        };
        self.tell(&MavMessage::LOCAL_POSITION_NED(message));
    }

    fn tell_estimate(&mut self, good: bool) {
        let mut status = ESTIMATOR_STATUS_DATA::DEFAULT;
        status.flags = if good {
            EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_ABS
        } else {
            EstimatorStatusFlags::ESTIMATOR_CONST_POS_MODE
        };
        self.tell(&MavMessage::ESTIMATOR_STATUS(status));
    }

    fn tell_origin(&mut self) {
        let message = GPS_GLOBAL_ORIGIN_DATA {
            latitude: 100_000_000,
            longitude: 200_000_000,
            ..GPS_GLOBAL_ORIGIN_DATA::DEFAULT
        };
        self.tell(&MavMessage::GPS_GLOBAL_ORIGIN(message));
    }

    fn tell_status(&mut self, prearm: bool, battery: i8) {
        let bit = MavSysStatusSensor::MAV_SYS_STATUS_PREARM_CHECK;
        let mut status = SYS_STATUS_DATA::DEFAULT;
        status.onboard_control_sensors_present = bit;
        status.onboard_control_sensors_health = if prearm {
            bit
        } else {
            MavSysStatusSensor::empty()
        };
        status.battery_remaining = battery;
        self.tell(&MavMessage::SYS_STATUS(status));
    }

    fn tell_answer(&mut self, command: MavCmd, result: MavResult) {
        let ack = COMMAND_ACK_DATA {
            command,
            result,
            ..COMMAND_ACK_DATA::DEFAULT
        };
        self.tell(&MavMessage::COMMAND_ACK(ack));
    }

    /// Simulates half a second of an autopilot that follows every command.
    fn cooperate(&mut self) {
        for _ in 0..5 {
            self.now += Duration::from_millis(100);
            self.judge();
            if let Some(command) = self.last_command.take() {
                self.tell_answer(command, MavResult::MAV_RESULT_ACCEPTED);
                let firmware = self.firmware;
                match command {
                    MavCmd::MAV_CMD_DO_SET_MODE => self.mode = Some(firmware.control_mode().0),
                    MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => {
                        self.armed = self.client.phase() != Phase::Disarming;
                    }
                    MavCmd::MAV_CMD_NAV_TAKEOFF => self.altitude = self.stood + self.rises,
                    MavCmd::MAV_CMD_NAV_LAND => self.mode = Some(firmware.land_mode().0),
                    _ => {}
                }
            }
            if let Some((param_id, param_value)) = self.asked_for.take() {
                let value = PARAM_VALUE_DATA {
                    param_id,
                    param_value,
                    ..PARAM_VALUE_DATA::DEFAULT
                };
                self.tell(&MavMessage::PARAM_VALUE(value));
            }
            let phase = self.client.phase();
            if phase == Phase::TakingOff && self.firmware == Firmware::Px4 {
                self.altitude = self.stood + self.rises;
            }
            self.tell_position(0);
        }
        self.tell_estimate(true);
        self.tell_origin();
        self.tell_status(true, 90);
        self.tell_heartbeat(self.mode.unwrap_or(5), self.armed);
    }

    /// Simulates so many half seconds from the first heartbeat on, without failures; 60 of them
    /// lead to the mission's start.
    fn start(&mut self, halves: u8) {
        if halves == 0 {
            return;
        }
        self.act(&Action::Heartbeat {
            mode: 4,
            armed: false,
        });
        self.act(&Action::Launch);
        self.act(&Action::Cooperate(halves));
    }

    fn act(&mut self, action: &Action) {
        match *action {
            Action::Wait(millis) => self.now += Duration::from_millis(millis),
            Action::Heartbeat { mode, armed } => self.tell_heartbeat(self.mode_number(mode), armed),
            Action::Stranger { mode, armed } => {
                // Not before ours: the first autopilot that is heard is the one that is flown.
                if self.mode.is_some() {
                    let message = self.heartbeat(self.mode_number(mode), armed);
                    self.client.receive(self.now, STRANGER, &message);
                }
            }
            Action::Answer { command, result } => {
                use MavCmd as C;
                use MavResult as R;
                let command = [
                    C::MAV_CMD_DO_SET_MODE,
                    C::MAV_CMD_COMPONENT_ARM_DISARM,
                    C::MAV_CMD_NAV_TAKEOFF,
                    C::MAV_CMD_NAV_LAND,
                    C::MAV_CMD_NAV_RETURN_TO_LAUNCH,
                    C::MAV_CMD_SET_MESSAGE_INTERVAL,
                    C::MAV_CMD_REQUEST_MESSAGE,
                    C::MAV_CMD_NAV_WAYPOINT,
                ][usize::from(command)];
                let result = [
                    R::MAV_RESULT_ACCEPTED,
                    R::MAV_RESULT_ACCEPTED,
                    R::MAV_RESULT_TEMPORARILY_REJECTED,
                    R::MAV_RESULT_DENIED,
                    R::MAV_RESULT_UNSUPPORTED,
                    R::MAV_RESULT_FAILED,
                    R::MAV_RESULT_IN_PROGRESS,
                    R::MAV_RESULT_CANCELLED,
                ][usize::from(result)];
                self.tell_answer(command, result);
            }
            Action::Accept => {
                if let Some(command) = self.last_command.take() {
                    self.tell_answer(command, MavResult::MAV_RESULT_ACCEPTED);
                }
            }
            Action::Position {
                x,
                y,
                altitude,
                late,
            } => {
                self.position = (x, y);
                self.altitude = altitude;
                self.tell_position(late);
            }
            Action::Broken => {
                let known = self.position;
                self.position = (f32::NAN, f32::INFINITY);
                self.tell_position(0);
                self.position = known;
            }
            Action::Status { prearm, battery } => self.tell_status(prearm, battery),
            Action::Estimate(good) => self.tell_estimate(good),
            Action::Launch => {
                self.launched = true;
                self.client.launch(self.now);
            }
            Action::Leg { x, y, millis } => {
                let vehicle_now = self.client.vehicle_time(self.now);
                let end = vehicle_now.unwrap_or(self.now) + Duration::from_millis(millis);
                let waypoint = Position::new(x, y);
                let inside = x.is_finite() && y.is_finite() && fence().contains(&waypoint, 0.0);
                let taken = self.client.fly_leg(self.now, Leg { waypoint, end }).is_ok();
                // A leg that is over already is counted by its tick; a place outside never is.
                assert!(!taken || inside);
            }
            Action::Land => self.client.land(self.now),
            Action::Return => self.client.return_and_land(self.now),
            Action::Stop => self.client.stop(self.now),
            Action::Cooperate(halves) => {
                for _ in 0..halves {
                    self.cooperate();
                }
            }
        }
        self.judge();
    }

    /// Takes all events and messages and checks them against the laws.
    fn judge(&mut self) {
        for round in 0.. {
            assert!(round < 40, "poll never ends");
            let phase_before = self.client.phase();
            let message = self.client.poll(self.now);
            while let Some(event) = self.client.take_next_event() {
                if let Event::Failsafe { reaction, .. } = event {
                    self.faulted = true;
                    self.released |= reaction == Reaction::Release;
                }
            }
            self.reached.push(self.client.phase());
            let Some(message) = message else {
                return;
            };
            self.judge_message(&message, phase_before);
        }
    }

    fn judge_message(&mut self, message: &MavMessage, phase: Phase) {
        match message {
            MavMessage::HEARTBEAT(_) => {}
            MavMessage::COMMAND_LONG(c) => {
                let numbers = [
                    c.param1, c.param2, c.param3, c.param4, c.param5, c.param6, c.param7,
                ];
                assert!(numbers.iter().all(|n| n.is_finite()), "{c:?}");
                assert_eq!((c.target_system, c.target_component), (1, 1));
                let moves = !matches!(
                    c.command,
                    MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL | MavCmd::MAV_CMD_REQUEST_MESSAGE
                );
                assert!(!moves || self.launched, "moves without a launch: {c:?}");
                assert!(!moves || !self.released, "commands after release: {c:?}");
                let arms = c.command == MavCmd::MAV_CMD_COMPONENT_ARM_DISARM && c.param1 == 1.0;
                assert!(!arms || !self.faulted, "arms after a failsafe");
                self.last_command = Some(c.command);
            }
            MavMessage::SET_POSITION_TARGET_LOCAL_NED(s) => {
                let numbers = [s.x, s.y, s.z, s.vx, s.vy, s.vz, s.afx, s.afy, s.afz];
                assert!(numbers.iter().all(|n| n.is_finite()), "{s:?}");
                let place = Position::new(f64::from(s.y), f64::from(s.x));
                assert!(fence().contains(&place, -1e-3), "{s:?}");
                let (low, high) = self.ground;
                assert!((low - 1e-3..=high + 100.001).contains(&-s.z), "{s:?}");
                self.judge_setpoint(phase);
            }
            MavMessage::SET_POSITION_TARGET_GLOBAL_INT(s) => {
                let numbers = [s.alt, s.vx, s.vy, s.vz, s.afx, s.afy, s.afz];
                assert!(numbers.iter().all(|n| n.is_finite()), "{s:?}");
                self.judge_setpoint(phase);
            }
            MavMessage::PARAM_REQUEST_READ(read) => {
                assert_eq!(phase, Phase::Checking);
                self.asked_for = Some((read.param_id, PARAMETER));
            }
            MavMessage::PARAM_SET(set) => {
                assert!(self.may_set && set.param_value.is_finite(), "{set:?}");
                if set.param_value == PARAMETER {
                    // Put back: after the flight, and not while somebody else flies.
                    assert!(
                        self.client.phase().is_final() && !self.told_armed,
                        "{set:?}"
                    );
                    self.parameters_restored += 1;
                } else {
                    assert_eq!(phase, Phase::Checking);
                    assert!(!self.faulted && !self.released, "{set:?}");
                    self.parameters_set += 1;
                }
                self.asked_for = Some((set.param_id, set.param_value));
            }
            other => panic!("the client never sends {other:?}"),
        }
    }

    fn judge_setpoint(&mut self, phase: Phase) {
        assert!(self.launched && !self.released);
        let in_control = self.mode == Some(self.firmware.control_mode().0);
        // PX4 gives control only to a stream that flows already.
        let asking = self.firmware == Firmware::Px4 && phase == Phase::TakingControl;
        assert!(
            in_control || asking,
            "setpoint in mode {:?}, {phase:?}",
            self.mode
        );
        self.was_in_control |= in_control;
        let known = self.placed.is_some_and(|placed| {
            self.now - placed
                <= firmware_core::autopilot::failsafe::Watch::<f64>::default().position
        });
        assert!(known, "setpoint without a position, {phase:?}");
    }
}

fn firmware() -> impl Strategy<Value = Firmware> {
    prop_oneof![
        Just(Firmware::Generic),
        Just(Firmware::ArduCopter),
        Just(Firmware::Px4)
    ]
}

/// 4,000 random histories of up to 120 actions, the same each time.
#[test]
fn the_laws_hold_for_any_order_of_things() {
    let mut runner = TestRunner::new(ProptestConfig {
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(6),
        ..ProptestConfig::with_cases(4_000)
    });
    let history = (
        firmware(),
        any::<bool>(),
        any::<bool>(),
        prop_oneof![Just(0u8), 4u8..10, Just(60)],
        proptest::collection::vec(action(), 1..120),
    );
    let reached = RefCell::new(Vec::<Phase>::new());
    let parameters = RefCell::new((0, 0));
    let outcome = runner.run(&history, |(firmware, global, limited, begun, actions)| {
        let coordinates = if global {
            Coordinates::Global
        } else {
            Coordinates::Local
        };
        let mut model = Model::new(firmware, coordinates, limited);
        model.start(begun);
        for action in &actions {
            model.act(action);
        }
        parameters.borrow_mut().0 += model.parameters_set;
        parameters.borrow_mut().1 += model.parameters_restored;
        model.reached.dedup();
        reached.borrow_mut().extend(model.reached);
        Ok(())
    });
    outcome.unwrap();
    // The histories are of use only if they get somewhere.
    let (set, restored) = *parameters.borrow();
    println!("parameters: {set} times set, {restored} times put back");
    assert!(set > 1_000 && restored > 300);
    for phase in [
        Phase::Standby,
        Phase::TakingControl,
        Phase::Arming,
        Phase::TakingOff,
        Phase::Transit,
        Phase::Ready,
        Phase::Leg,
        Phase::LegEnded,
        Phase::Landing,
        Phase::Disarming,
        Phase::Landed,
        Phase::Released,
        Phase::Failed,
    ] {
        let times = reached.borrow().iter().filter(|p| **p == phase).count();
        println!("{phase}: {times}");
        assert!(times >= 30, "{phase} was reached {times} times");
    }
}

/// The local frame of the autopilot may begin above or below the place of take-off: heights that
/// are commanded and heights that are judged count from that place all the same.
#[test]
fn heights_count_from_the_place_of_take_off() {
    for firmware in [Firmware::Generic, Firmware::ArduCopter, Firmware::Px4] {
        for ground in [-3.0_f32, 1.5, 40.0] {
            let mut model = Model::new(firmware, Coordinates::Local, false);
            model.altitude = ground;
            model.act(&Action::Heartbeat {
                mode: 4,
                armed: false,
            });
            model.act(&Action::Launch);
            // Not high enough yet.
            model.rises = 97.0;
            model.act(&Action::Cooperate(60));
            let phase = model.client.phase();
            assert_eq!(phase, Phase::TakingOff, "{firmware:?} {ground}");
            model.rises = 100.0;
            model.altitude = ground + 100.0;
            model.act(&Action::Cooperate(20));
            let phase = model.client.phase();
            assert_eq!(phase, Phase::Ready, "{firmware:?} {ground}");
            // A setpoint below the ground or more than 100 m above it breaks a law of the model.
            assert!(model.was_in_control);
            assert_eq!(model.client.fault(), None);
        }
    }
}

/// Both links fall silent in flight. When the autopilot is heard again, the position of the vehicle
/// is not known yet, and the landing is requested without setpoints.
#[test]
fn a_heartbeat_alone_does_not_bring_the_setpoints_back() {
    for firmware in [Firmware::Generic, Firmware::ArduCopter, Firmware::Px4] {
        let mut model = Model::new(firmware, Coordinates::Local, false);
        model.start(60);
        assert_eq!(model.client.phase(), Phase::Ready);
        // Heartbeats are missed after 5 s, those of PX4 after 10; a position was told just before.
        let tenths = if firmware == Firmware::Px4 { 99 } else { 49 };
        for _ in 0..tenths {
            model.act(&Action::Wait(100));
            model.tell_position(0);
        }
        model.act(&Action::Wait(1_400));
        assert!(model.faulted, "{firmware:?}");
        model.act(&Action::Wait(6_000));
        model.act(&Action::Heartbeat {
            mode: 0,
            armed: true,
        });
        for _ in 0..20 {
            model.act(&Action::Wait(100));
        }
        assert_eq!(model.client.phase(), Phase::Landing, "{firmware:?}");
        // Known again, the reference comes to rest until the landing is accepted.
        model.was_in_control = false;
        model.tell_position(0);
        model.act(&Action::Wait(200));
        assert!(model.was_in_control, "{firmware:?}");
    }
}

/// A case that the random histories found: stopped before the launch.
#[test]
fn a_stop_before_the_launch_breaks_no_law() {
    let mut model = Model::new(Firmware::Generic, Coordinates::Local, false);
    for action in [Action::Stop, Action::Launch, Action::Cooperate(3)] {
        model.act(&action);
    }
    assert_eq!(model.client.phase(), Phase::Failed);
}

/// The model observes a complete flight with a cooperative autopilot.
#[test]
fn a_cooperative_autopilot_is_flown_to_the_end() {
    for firmware in [Firmware::Generic, Firmware::ArduCopter, Firmware::Px4] {
        let mut model = Model::new(firmware, Coordinates::Local, true);
        model.start(60);
        assert_eq!(model.client.phase(), Phase::Ready, "{firmware:?}");
        model.act(&Action::Leg {
            x: 20.0,
            y: 20.0,
            millis: 900,
        });
        model.act(&Action::Cooperate(4));
        assert_eq!(model.client.phase(), Phase::LegEnded, "{firmware:?}");
        model.act(&Action::Land);
        model.act(&Action::Cooperate(4));
        model.act(&Action::Heartbeat {
            mode: 2,
            armed: false,
        });
        assert_eq!(model.client.phase(), Phase::Landed, "{firmware:?}");
        assert!(model.was_in_control);
        assert_eq!(model.client.fault(), None);
    }
}
