//! The built-in `arducopter` and `px4` behave as the recorded autopilots did, and our client flies
//! them.

mod flight;

use firmware_core::Position;
use firmware_core::autopilot::wire::{Address, Decoder, Encoder, MAX_FRAME};
use firmware_core::autopilot::{AutopilotSettings, Coordinates, Leg, Phase};
use firmware_core::time::{Duration, Instant};
use flight::{ALTITUDE_M, Flight, SLOT, ready};
use mavlink::dialects::common::{
    COMMAND_LONG_DATA, HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavCmd, MavFrame, MavMessage,
    MavResult, PositionTargetTypemask as Mask, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use nalgebra::Vector2;
use vehicle::{Ability, Airframe, FlightMode, Profile, Vehicle, VehicleSettings};

/// Parameters that allow 30 m/s.
fn fast(profile: Profile) -> Vec<(String, f32)> {
    let all: &[(&str, f32)] = match profile {
        Profile::ArduCopter => &[
            ("WPNAV_SPEED", 3500.0),
            ("WPNAV_ACCEL", 1000.0),
            ("ANGLE_MAX", 4500.0),
            ("PSC_JERK_XY", 20.0),
        ],
        Profile::Px4 => &[
            ("MPC_XY_VEL_MAX", 35.0),
            ("MPC_XY_CRUISE", 35.0),
            ("MPC_ACC_HOR_MAX", 10.0),
        ],
        _ => &[],
    };
    all.iter()
        .map(|&(name, value)| (name.to_owned(), value))
        .collect()
}

/// Flies legs of `length_m` along a wide circle, planned from the position of the vehicle. Returns
/// the distances between planned and flown position at the ends of the slots once the vehicle
/// moves.
fn missed(flight: &mut Flight, length_m: f64, slots: u32) -> Vec<f64> {
    let begin = flight.now;
    let missed = (0..slots).map(|n| {
        let from = flight.client.position().unwrap().position;
        let angle = f64::from(n) * 0.06;
        let waypoint = from + length_m * Vector2::new(angle.cos(), angle.sin());
        flight.fly_leg(waypoint, begin + SLOT * (n + 1)).missed_m
    });
    missed.collect::<Vec<_>>().split_off(8)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The origin of the local frame becomes known after the first position: the vehicle stays above
/// its position all the same, wherever that is on the map.
#[test]
fn a_vehicle_takes_off_straight_up() {
    let place = Position::new(700.0, 420.0);
    for profile in [Profile::Multirotor, Profile::ArduCopter, Profile::Px4] {
        for coordinates in [Coordinates::Local, Coordinates::Global] {
            let settings = AutopilotSettings {
                coordinates,
                start: place,
                ..flight::settings(profile)
            };
            let vehicle = VehicleSettings::new(profile, flight::origin(), place);
            let mut flight = Flight::new(settings, vehicle);
            flight.client.launch(flight.now);
            let (mut strayed_m, mut seen) = (0.0_f64, 0);
            flight.run_until(Duration::from_secs(300), |flight| {
                let phase = flight.client.phase();
                if let Some(sample) = flight.client.position()
                    && matches!(phase, Phase::TakingOff | Phase::Transit)
                {
                    strayed_m = strayed_m.max((sample.position - place).norm());
                    seen += 1;
                }
                phase == Phase::Ready
            });
            assert!(
                strayed_m < 1.0 && seen > 100,
                "{profile}: {strayed_m} m, {seen}"
            );
        }
    }
}

#[test]
fn with_the_right_parameters_both_track_at_mission_speed() {
    for profile in [Profile::Multirotor, Profile::ArduCopter, Profile::Px4] {
        for coordinates in [Coordinates::Local, Coordinates::Global] {
            let mut flight = ready(profile, |settings, vehicle| {
                settings.coordinates = coordinates;
                vehicle.parameters = fast(profile);
            });
            // The vehicle is at the start's position on the map, although the origin of the local
            // frame differs.
            let off = (flight.vehicle.true_position() - flight::start()).norm();
            assert!(off < 2.0, "{profile}: {off}");
            assert!((flight.vehicle.altitude_m() - ALTITUDE_M).abs() < 2.5);
            let missed = missed(&mut flight, 29.0, 40);
            let middle = median(missed.clone());
            println!("{profile} {coordinates:?}: median {middle:.2} m");
            assert!(middle < 3.0, "{profile}: {missed:.1?}");
            flight.client.land(flight.now);
            flight.run_until_phase(Phase::Landed, Duration::from_secs(120));
            assert_eq!(flight.client.fault(), None);
        }
    }
}

#[test]
fn clipping_parameters_are_said_and_obeyed() {
    for (profile, name, speed) in [
        (
            Profile::ArduCopter,
            "WPNAV_SPEED is 1000: it clips speed; set it to 3500",
            9.5,
        ),
        (
            Profile::Px4,
            "MPC_XY_CRUISE is 5: it clips speed; set it to 35",
            4.75,
        ),
    ] {
        let mut flight = ready(profile, |_, _| {});
        assert!(
            flight.log.iter().any(|line| line.contains(name)),
            "{:#?}",
            flight.log
        );
        assert_eq!(flight.client.limits().speed_mps, speed);
        // The reference is not faster than the vehicle can be: it is slow, but the vehicle follows
        // it.
        let begin = flight.now;
        for n in 0..30 {
            let from = flight.client.position().unwrap().position;
            let ended = flight.fly_leg(from + Vector2::new(29.0, 0.0), begin + SLOT * (n + 1));
            if n > 15 {
                assert!(
                    (ended.missed_m - (29.0 - speed)).abs() < 2.0,
                    "{profile} {ended:?}"
                );
            }
        }
    }
}

/// Sends raw messages to a vehicle.
struct Hand {
    now: Instant,
    vehicle: Vehicle,
    encoder: Encoder,
    heard: Vec<MavMessage>,
    heartbeats: bool,
}

impl Hand {
    fn new(profile: Profile, parameters: &[(&str, f32)]) -> Self {
        let mut settings = flight::vehicle(profile);
        settings.parameters = parameters.iter().map(|&(n, v)| (n.to_owned(), v)).collect();
        Self::with(settings)
    }

    fn with(settings: VehicleSettings) -> Self {
        Self {
            now: Instant::ZERO,
            vehicle: Vehicle::new(settings),
            encoder: Encoder::new(Address {
                system: 255,
                component: 190,
            }),
            heard: Vec::new(),
            heartbeats: true,
        }
    }

    fn send(&mut self, message: &MavMessage) {
        let mut buffer = [0; MAX_FRAME];
        let frame = self.encoder.encode(message, &mut buffer);
        self.vehicle.receive(self.now, frame);
        self.listen();
    }

    fn listen(&mut self) {
        let mut decoder = Decoder::new();
        while let Some(frame) = self.vehicle.next_frame() {
            let mut bytes = &frame[..];
            while let Some(frame) = decoder.next_frame(&mut bytes) {
                self.heard.push(frame.message().unwrap());
            }
        }
    }

    fn wait(&mut self, seconds: f64) {
        let end = self.now + Duration::from_secs_f64(seconds);
        while self.now < end {
            if self.heartbeats && self.now.as_micros().is_multiple_of(1_000_000) {
                self.send(&MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT));
            }
            self.now += Duration::from_millis(10);
            self.vehicle.step(self.now);
            self.listen();
        }
    }

    fn command(&mut self, command: MavCmd, [p1, p2, p3, p7]: [f32; 4]) -> Option<MavResult> {
        self.heard.clear();
        self.send(&MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            command,
            param1: p1,
            param2: p2,
            param3: p3,
            param7: p7,
            target_system: 1,
            target_component: 1,
            ..COMMAND_LONG_DATA::DEFAULT
        }));
        // The answer is sent after the messages that were queued before it.
        for _ in 0..25 {
            let answer = self.heard.iter().find_map(|message| match message {
                MavMessage::COMMAND_ACK(ack) if ack.command == command => Some(ack.result),
                _ => None,
            });
            if answer.is_some() {
                return answer;
            }
            self.wait(0.01);
        }
        None
    }

    fn said(&self, words: &str) -> bool {
        self.heard.iter().any(|message| match message {
            MavMessage::STATUSTEXT(text) => text.text.to_str().unwrap().contains(words),
            _ => false,
        })
    }

    /// Sends a setpoint relative to the origin of the local frame; without `velocity` it is only a
    /// position.
    fn setpoint(&mut self, north: f32, east: f32, velocity: Option<[f32; 2]>, system: u8) {
        let mut type_mask = Mask::POSITION_TARGET_TYPEMASK_AX_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_AY_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_AZ_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_YAW_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE;
        if velocity.is_none() {
            type_mask |= Mask::POSITION_TARGET_TYPEMASK_VX_IGNORE
                | Mask::POSITION_TARGET_TYPEMASK_VY_IGNORE
                | Mask::POSITION_TARGET_TYPEMASK_VZ_IGNORE;
        }
        let [vx, vy] = velocity.unwrap_or_default();
        self.send(&MavMessage::SET_POSITION_TARGET_LOCAL_NED(
            SET_POSITION_TARGET_LOCAL_NED_DATA {
                x: north,
                y: east,
                z: -100.0,
                vx,
                vy,
                type_mask,
                target_system: system,
                target_component: 1,
                coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
                ..SET_POSITION_TARGET_LOCAL_NED_DATA::DEFAULT
            },
        ));
    }

    /// Returns a vehicle in the air at 100 m, in the mode that follows setpoints.
    fn airborne(profile: Profile, parameters: &[(&str, f32)]) -> Self {
        Self::new(profile, parameters).taken_off(profile)
    }

    fn taken_off(self, profile: Profile) -> Self {
        let mut hand = self;
        hand.wait(45.0);
        if profile == Profile::Px4 {
            for _ in 0..10 {
                hand.setpoint(0.0, 0.0, Some([0.0, 0.0]), 1);
                hand.wait(0.1);
            }
            assert_eq!(hand.command(SET_MODE, [1.0, 6.0, 0.0, 0.0]), ACCEPTED);
            assert_eq!(hand.command(ARM, [1.0, 0.0, 0.0, 0.0]), ACCEPTED);
            for _ in 0..500 {
                hand.setpoint(0.0, 0.0, Some([0.0, 0.0]), 1);
                hand.wait(0.1);
            }
        } else {
            assert_eq!(hand.command(SET_MODE, [1.0, 4.0, 0.0, 0.0]), ACCEPTED);
            assert_eq!(hand.command(ARM, [1.0, 0.0, 0.0, 0.0]), ACCEPTED);
            assert_eq!(hand.command(TAKEOFF, [0.0, 0.0, 0.0, 100.0]), ACCEPTED);
            hand.wait(60.0);
        }
        assert!((hand.vehicle.altitude_m() - 100.0).abs() < 1.0);
        hand
    }

    /// Returns the distance north and east of the start, metres.
    fn moved(&self) -> Vector2<f64> {
        self.vehicle.true_position() - flight::start()
    }
}

const SET_MODE: MavCmd = MavCmd::MAV_CMD_DO_SET_MODE;
const ARM: MavCmd = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;
const TAKEOFF: MavCmd = MavCmd::MAV_CMD_NAV_TAKEOFF;
const ACCEPTED: Option<MavResult> = Some(MavResult::MAV_RESULT_ACCEPTED);
const FAILED: Option<MavResult> = Some(MavResult::MAV_RESULT_FAILED);
const FAST: [(&str, f32); 4] = [
    ("WPNAV_SPEED", 3500.0),
    ("WPNAV_ACCEL", 1000.0),
    ("ANGLE_MAX", 4500.0),
    ("PSC_JERK_XY", 20.0),
];

#[test]
fn arducopter_before_it_is_ready() {
    let mut hand = Hand::new(Profile::ArduCopter, &[]);
    hand.wait(5.0);
    // GUIDED without a position is acknowledged; arming is refused with the reason.
    assert_eq!(hand.command(SET_MODE, [1.0, 4.0, 0.0, 0.0]), ACCEPTED);
    assert_eq!(hand.command(ARM, [1.0, 0.0, 0.0, 0.0]), FAILED);
    assert!(hand.said("Need Position Estimate"));
    hand.wait(40.0);
    assert_eq!(hand.command(ARM, [1.0, 0.0, 0.0, 0.0]), ACCEPTED);
    // On the ground setpoints are ignored, and without a take-off the motors stop.
    hand.setpoint(50.0, 0.0, None, 1);
    hand.wait(9.0);
    assert!(hand.vehicle.armed());
    hand.wait(2.0);
    assert!(!hand.vehicle.armed());
    assert_eq!(hand.moved(), Vector2::zeros());
    assert_eq!(hand.command(TAKEOFF, [0.0, 0.0, 0.0, 100.0]), FAILED);
}

#[test]
fn arducopter_drops_setpoints_in_silence() {
    let mut hand = Hand::airborne(Profile::ArduCopter, &FAST);
    hand.heard.clear();
    hand.setpoint(50.0, 0.0, None, 7);
    assert!(hand.heard.is_empty(), "wrong system: {:?}", hand.heard);
    assert_eq!(hand.command(SET_MODE, [1.0, 5.0, 0.0, 0.0]), ACCEPTED);
    hand.setpoint(50.0, 0.0, None, 1);
    hand.wait(5.0);
    assert!(hand.moved().norm() < 0.1, "not in LOITER");
    assert_eq!(hand.command(SET_MODE, [1.0, 4.0, 0.0, 0.0]), ACCEPTED);
    hand.setpoint(50.0, 20.0, None, 1);
    let echoed = |m: &MavMessage| matches!(m, MavMessage::POSITION_TARGET_GLOBAL_INT(_));
    assert!(hand.heard.iter().any(echoed));
    hand.wait(20.0);
    // A position without a velocity is a place to stop at, north and east of the estimator's
    // origin.
    assert!(
        (hand.moved() - Vector2::new(20.0, 50.0)).norm() < 0.5,
        "{:?}",
        hand.moved()
    );
}

#[test]
fn arducopter_position_only_targets_lag_and_moving_ones_do_not() {
    for (moving, least, most) in [(false, 40.0, 1e3), (true, 0.0, 2.0)] {
        let mut hand = Hand::airborne(Profile::ArduCopter, &FAST);
        let mut lag = 0.0;
        let mut place = 0.0;
        for step in 0..600 {
            // 25 m/s after a ramp of 5 s, as one position per second or as a stream at 10 Hz.
            let time = f64::from(step) * 0.1;
            let speed = 25.0 * (time / 5.0).min(1.0);
            place += speed * 0.1;
            if moving || step % 10 == 0 {
                let velocity = moving.then_some([0.0, speed as f32]);
                hand.setpoint(0.0, place as f32, velocity, 1);
            }
            lag = (place - hand.moved().x).abs();
            hand.wait(0.1);
        }
        println!("moving {moving}: lag {lag:.1} m");
        assert!((least..most).contains(&lag), "moving {moving}: {lag}");
    }
}

#[test]
fn arducopter_flies_on_for_guid_timeout_when_a_moving_stream_stops() {
    let mut hand = Hand::airborne(Profile::ArduCopter, &FAST);
    let mut place = 0.0;
    for step in 0..400 {
        let speed = 30.0 * (f64::from(step) * 0.01).min(1.0);
        place += speed * 0.1;
        hand.setpoint(0.0, place as f32, Some([0.0, speed as f32]), 1);
        hand.wait(0.1);
    }
    let last = hand.moved().x;
    hand.wait(3.0);
    let after = hand.moved().x - last;
    assert!((80.0..100.0).contains(&after), "{after}");
    hand.wait(10.0);
    assert!(hand.vehicle.velocity().norm() < 0.1);
}

#[test]
fn arducopter_without_the_ground_station() {
    for (enabled, mode) in [(0.0, FlightMode::Guided), (1.0, FlightMode::Return)] {
        let mut hand = Hand::airborne(Profile::ArduCopter, &[("FS_GCS_ENABLE", enabled)]);
        hand.heartbeats = false;
        hand.wait(3.9); // the last one is up to a second old
        assert_eq!(hand.vehicle.mode(), FlightMode::Guided);
        hand.wait(2.0);
        assert_eq!(hand.vehicle.mode(), mode);
        hand.heartbeats = true;
        hand.wait(3.0);
        assert_eq!(hand.vehicle.mode(), mode, "it stays");
    }
}

#[test]
fn arducopter_does_not_survive_a_number_that_is_none() {
    let mut hand = Hand::airborne(Profile::ArduCopter, &[]);
    hand.setpoint(f32::NAN, 0.0, None, 1);
    hand.heard.clear();
    hand.wait(10.0);
    assert!(hand.heard.is_empty());
    assert_eq!(hand.vehicle.altitude_m(), 0.0);
}

#[test]
fn px4_follows_only_a_stream() {
    let mut hand = Hand::new(Profile::Px4, &[]);
    hand.wait(15.0);
    let rejected = Some(MavResult::MAV_RESULT_TEMPORARILY_REJECTED);
    assert_eq!(hand.command(SET_MODE, [1.0, 6.0, 0.0, 0.0]), rejected);
    for _ in 0..5 {
        hand.setpoint(0.0, 0.0, None, 1);
        hand.wait(0.9); // too slow
    }
    assert_eq!(hand.command(SET_MODE, [1.0, 6.0, 0.0, 0.0]), rejected);

    let mut hand = Hand::airborne(Profile::Px4, &[]);
    for _ in 0..40 {
        hand.setpoint(0.0, 30.0, Some([0.0, 0.0]), 1);
        hand.wait(0.1);
    }
    // The stream ends: the vehicle stops at the last target, leaves OFFBOARD, then descends.
    hand.wait(4.0);
    assert_eq!(hand.vehicle.mode(), FlightMode::Guided);
    hand.wait(4.0);
    assert_eq!(hand.vehicle.mode(), FlightMode::Manual);
    assert!(hand.said("Offboard control lost"));
    let high = hand.vehicle.altitude_m();
    hand.wait(20.0);
    let sunk = high - hand.vehicle.altitude_m();
    assert!((5.0..15.0).contains(&sunk), "{sunk}");
    assert!(
        (hand.moved() - Vector2::new(30.0, 0.0)).norm() < 2.0,
        "{:?}",
        hand.moved()
    );
}

#[test]
fn a_place_on_the_map_is_the_same_for_every_vehicle() {
    for profile in Profile::ALL {
        let mut flight = ready(profile, |settings, _| {
            settings.start = Position::new(90.0, 60.0)
        });
        flight.run_for(Duration::from_secs(5));
        let off = (flight.vehicle.true_position() - Position::new(90.0, 60.0)).norm();
        assert!(off < 0.5, "{profile}: {off}");
    }
}

/// Returns the time, the time stamp and the message of each position as it left the vehicle, while
/// `hand` waits.
fn samples(hand: &mut Hand, seconds: f64) -> Vec<(f64, LOCAL_POSITION_NED_DATA)> {
    let mut samples = Vec::new();
    for _ in 0..(seconds * 1000.0) as usize {
        hand.heard.clear();
        hand.now += Duration::from_millis(1);
        hand.vehicle.step(hand.now);
        hand.listen();
        for message in &hand.heard {
            if let MavMessage::LOCAL_POSITION_NED(sample) = message {
                samples.push((hand.now.as_micros() as f64 * 1e-6, sample.clone()));
            }
        }
    }
    samples
}

const SET_INTERVAL: MavCmd = MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;

/// As recorded (`data/flights/facts.md`): ArduCopter stamps its samples regularly and delivers them
/// with jitter, PX4 does the opposite; their clocks run at 0.9997 and 0.99; now and then no sample
/// is received for 130 ms, and then all of them, in order.
#[test]
fn samples_come_as_recorded() {
    for (profile, rate, stamped, received) in [
        (Profile::ArduCopter, 0.9997, 50..=50, 40.0..60.0),
        (Profile::Px4, 0.99, 40..=56, 44.0..58.0),
    ] {
        let mut hand = Hand::new(profile, &[]);
        hand.wait(45.0);
        let asked = hand.command(SET_INTERVAL, [32.0, 50_000.0, 0.0, 0.0]);
        assert_eq!(asked, ACCEPTED);
        let samples = samples(&mut hand, 200.0);
        let (first, last) = (&samples[5], &samples[samples.len() - 5]);
        let own = f64::from(last.1.time_boot_ms - first.1.time_boot_ms) * 1e-3;
        let measured = own / (last.0 - first.0);
        assert!((measured - rate).abs() < 1e-3, "{profile}: {measured}");
        let intervals = samples.windows(2).map(|pair| (pair[1].0 - pair[0].0) * 1e3);
        let mut intervals: Vec<f64> = intervals.collect();
        for pair in samples.windows(2).skip(1) {
            let step = pair[1].1.time_boot_ms - pair[0].1.time_boot_ms;
            assert!(stamped.contains(&step), "{profile}: {step} ms");
        }
        intervals.sort_by(f64::total_cmp);
        let at = |part: f64| intervals[(part * (intervals.len() - 1) as f64) as usize];
        let (low, middle, high, most) = (at(0.02), at(0.5), at(0.98), at(1.0));
        println!("{profile}: {low:.0} / {middle:.0} / {high:.0} / {most:.0} ms");
        assert!(
            received.contains(&low) && received.contains(&high),
            "{low} {high}"
        );
        assert!((middle * rate - 50.0).abs() < 1.5, "{profile}: {middle}");
        let hiccups = intervals
            .iter()
            .filter(|interval| **interval > 100.0)
            .count();
        assert!((2..=6).contains(&hiccups), "{profile}: {hiccups}");
        assert!(most < 190.0, "{profile}: {most}");
    }
}

/// The same seed gives the same samples at the same times; another seed gives different ones.
#[test]
fn jitter_is_the_same_for_the_same_seed() {
    let flown = |seed| {
        let mut settings = flight::vehicle(Profile::Px4);
        settings.seed = seed;
        let mut hand = Hand::with(settings);
        samples(&mut hand, 30.0)
    };
    assert_eq!(flown(1), flown(1));
    assert_ne!(flown(1), flown(2));
}

/// PX4 reports that its position is constant while it stands still, and only then.
#[test]
fn px4_sets_the_flag_for_a_constant_position_on_the_ground() {
    use mavlink::dialects::common::EstimatorStatusFlags as F;
    let last = |hand: &Hand| {
        let mut flags = hand.heard.iter().filter_map(|message| match message {
            MavMessage::ESTIMATOR_STATUS(status) => Some(status.flags.bits()),
            _ => None,
        });
        flags.next_back().unwrap()
    };
    let mut hand = Hand::new(Profile::Px4, &[]);
    hand.wait(1.0);
    assert_eq!(last(&hand), 229);
    hand.wait(60.0);
    assert_eq!(last(&hand), 1023);
    let hand = Hand::airborne(Profile::Px4, &[]);
    assert_eq!(last(&hand), 895);
    assert!(!F::from_bits_retain(895).contains(F::ESTIMATOR_CONST_POS_MODE));
}

/// Flies east with a stream of setpoints that is always ahead; returns the speed that is reached.
fn speed_reached(profile: Profile, change: impl FnOnce(&mut VehicleSettings)) -> f64 {
    let mut settings = flight::vehicle(profile);
    settings.parameters = fast(profile);
    change(&mut settings);
    let mut hand = Hand::with(settings).taken_off(profile);
    for _ in 0..300 {
        let east = hand.moved().x as f32;
        hand.setpoint(0.0, east + 60.0, Some([0.0, 30.0]), 1);
        hand.wait(0.1);
    }
    hand.vehicle.velocity().x
}

/// The default airframes of the simulators are slow; a headwind slows the vehicle down.
#[test]
fn airframes_and_wind_limit_the_speed() {
    for (profile, stock) in [(Profile::ArduCopter, 15.2), (Profile::Px4, 10.0)] {
        let strong = speed_reached(profile, |_| {});
        assert!(strong > 29.0, "{profile}: {strong}");
        let stock_ability = profile.ability_with(Airframe::Stock);
        let slow = speed_reached(profile, |settings| settings.ability = stock_ability);
        assert!((slow - stock).abs() < 0.5, "{profile}: {slow}");
        // Wind from the west pushes a slow vehicle along; its airspeed is the same as before.
        let pushed = speed_reached(profile, |settings| {
            settings.ability = Ability {
                speed_mps: 40.0,
                ..stock_ability
            };
            settings.wind_mps = 8.0;
        });
        assert!((pushed - stock - 8.0).abs() < 5.0, "{profile}: {pushed}");
    }
}

/// In wind the vehicle holds its position only approximately, because of gusts.
#[test]
fn wind_pushes_a_vehicle_that_hovers() {
    for (wind_mps, least, most) in [(0.0, 0.0, 0.01), (8.0, 0.05, 4.0)] {
        let settings = VehicleSettings {
            wind_mps,
            ..flight::vehicle(Profile::ArduCopter)
        };
        let mut hand = Hand::with(settings).taken_off(Profile::ArduCopter);
        let mut farthest = 0.0_f64;
        for _ in 0..600 {
            hand.setpoint(0.0, 0.0, Some([0.0, 0.0]), 1);
            hand.wait(0.1);
            farthest = farthest.max(hand.moved().norm());
        }
        println!("{wind_mps} m/s of wind: {farthest:.2} m");
        assert!((least..=most).contains(&farthest), "{farthest}");
    }
}

/// A vehicle that fails sends no more messages, and nothing that is sent to it has an effect.
#[test]
fn a_dead_vehicle_is_silent() {
    let settings = VehicleSettings {
        die_after: Some(Duration::from_secs(50)),
        clock_rate: 1.0,
        ..flight::vehicle(Profile::ArduCopter)
    };
    let mut hand = Hand::with(settings);
    hand.wait(49.0);
    assert!(!hand.vehicle.is_dead());
    hand.wait(2.0);
    assert!(hand.vehicle.is_dead());
    hand.heard.clear();
    assert_eq!(hand.command(SET_MODE, [1.0, 4.0, 0.0, 0.0]), None);
    hand.wait(30.0);
    assert!(hand.heard.is_empty());
    assert_eq!(hand.vehicle.mode(), FlightMode::Manual);
}

/// As recorded: ArduCopter's own failsafes report the reason and change the mode to RTL, and the
/// client permanently gives up control.
#[test]
fn arducopter_returns_by_itself_and_the_client_lets_go() {
    for (name, value, said) in [
        ("BATT_FS_LOW_ACT", 2.0, "Battery Failsafe"),
        ("FENCE_ENABLE", 1.0, "Circle fence breached"),
    ] {
        let mut flight = ready(Profile::ArduCopter, |_, vehicle| {
            vehicle.parameters = fast(Profile::ArduCopter);
            vehicle.parameters.push((name.to_owned(), value));
            vehicle.parameters.push(("FENCE_RADIUS".to_owned(), 50.0));
        });
        let begin = flight.now;
        flight.vehicle.faults.battery_low = name.starts_with("BATT");
        for n in 0..12 {
            let from = flight.client.position().unwrap().position;
            let waypoint = from + Vector2::new(20.0, 0.0);
            let end = begin + SLOT * (n + 1);
            if flight
                .client
                .fly_leg(flight.now, Leg { waypoint, end })
                .is_err()
            {
                break;
            }
            flight.run_until(SLOT * 2, |flight| {
                flight.client.leg_ended(flight.now).is_some()
                    || flight.client.phase() == Phase::Released
            });
        }
        assert_eq!(flight.client.phase(), Phase::Released, "{:#?}", flight.log);
        assert_eq!(flight.vehicle.mode(), FlightMode::Return);
        assert!(
            flight.log.iter().any(|line| line.contains(said)),
            "{:#?}",
            flight.log
        );
        let count = |flight: &Flight| {
            let sent = flight.sent.iter().filter(|(_, message)| {
                matches!(message, MavMessage::SET_POSITION_TARGET_LOCAL_NED(_))
            });
            sent.count()
        };
        let before = count(&flight);
        flight.run_for(Duration::from_secs(60));
        assert_eq!(count(&flight), before, "no setpoint after the release");
    }
}
