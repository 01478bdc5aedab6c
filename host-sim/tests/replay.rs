//! Recordings of real flights, replayed into the client: the messages that ArduCopter 4.6.2 and PX4
//! 1.17 alpha (both in simulation) sent, at the times at which they were received.
//!
//! Telemetry is replayed by time. Requests are answered as the recorded autopilot answered them,
//! whenever the client asks, so that a replay does not depend on when the recorded client asked; a
//! request that the recording has no answer for is not answered. The excerpts and the `facts.md`
//! next to them are made by `data/flights/excerpt.py`.

use std::collections::{BTreeMap, VecDeque};

use firmware_core::Position;
use firmware_core::autopilot::failsafe::{Cause, Reaction};
use firmware_core::autopilot::frames::Geodetic;
use firmware_core::autopilot::wire::{Address, Decoder, Encoder, MAX_FRAME};
use firmware_core::autopilot::{Autopilot, AutopilotSettings, Event, Leg, Phase, Sample};
use firmware_core::time::{Duration, Instant};
use mavlink::dialects::common::{
    COMMAND_ACK_DATA, COMMAND_LONG_DATA, GPS_GLOBAL_ORIGIN_DATA, MavCmd, MavMessage, MavParamType,
    MavResult, PARAM_VALUE_DATA, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use vehicle::{Profile, Vehicle, VehicleSettings};

const TICK: Duration = Duration::from_millis(10);
const SLOT: Duration = Duration::from_secs(1);
/// The time from a request to its answer.
const ANSWER: Duration = Duration::from_millis(6);
/// The message id of GPS_GLOBAL_ORIGIN.
const ORIGIN: u32 = 49;
/// The client is told to launch this long before the recorded request for the control mode.
const LAUNCH_LEAD: Duration = Duration::from_millis(1100);

/// One message of a recording.
struct Record {
    at: Instant,
    from: Address,
    message: MavMessage,
}

fn path(name: &str) -> String {
    format!(
        "{}/tests/data/flights/{name}.tlog",
        env!("CARGO_MANIFEST_DIR")
    )
}

/// Returns the records of an excerpt; time counts from the first one.
fn records(name: &str) -> Vec<Record> {
    let bytes = std::fs::read(path(name)).unwrap();
    let mut decoder = Decoder::new();
    let (mut at, mut begin, mut records) = (0, None, Vec::new());
    while at + 8 < bytes.len() {
        let time = u64::from_be_bytes(bytes[at..at + 8].try_into().unwrap());
        at += 8;
        let signature = if bytes[at + 2] & 1 == 1 { 13 } else { 0 };
        let length = 12 + usize::from(bytes[at + 1]) + signature;
        let mut frame = &bytes[at..at + length];
        at += length;
        let begin = *begin.get_or_insert(time);
        while let Some(frame) = decoder.next_frame(&mut frame) {
            records.push(Record {
                at: Instant::from_micros(time - begin),
                from: frame.sender(),
                message: frame.message().expect("recorded messages are readable"),
            });
        }
    }
    assert_eq!(decoder.counters().bad_checksum, 0);
    records
}

/// The answers of the autopilot: results by command and first parameter, and parameters by name.
#[derive(Default)]
struct Answers {
    results: BTreeMap<(u32, u32), MavResult>,
    parameters: BTreeMap<String, PARAM_VALUE_DATA>,
    origin: Option<GPS_GLOBAL_ORIGIN_DATA>,
}

/// Returns the key of a command; for some commands the first parameter is part of it.
fn key(command: &COMMAND_LONG_DATA) -> (u32, u32) {
    let specific = matches!(
        command.command,
        MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL | MavCmd::MAV_CMD_REQUEST_MESSAGE
    );
    let which = if specific { command.param1 as u32 } else { 0 };
    (command.command as u32, which)
}

impl Answers {
    fn of(records: &[Record]) -> Self {
        let mut answers = Self::default();
        let mut asked = None;
        for record in records {
            match &record.message {
                MavMessage::COMMAND_LONG(command) => asked = Some(key(command)),
                MavMessage::COMMAND_ACK(ack) => {
                    if let Some(key) = asked.filter(|(number, _)| *number == ack.command as u32) {
                        answers.results.entry(key).or_insert(ack.result);
                    }
                }
                // The first value counts: later ones were set by the recorded client.
                MavMessage::PARAM_VALUE(value) => {
                    let name = value.param_id.to_str().unwrap().to_owned();
                    answers
                        .parameters
                        .entry(name)
                        .or_insert_with(|| value.clone());
                }
                MavMessage::GPS_GLOBAL_ORIGIN(origin) => {
                    answers.origin.get_or_insert_with(|| origin.clone());
                }
                _ => {}
            }
        }
        answers
    }

    fn to(&mut self, request: &MavMessage) -> Vec<MavMessage> {
        match request {
            MavMessage::COMMAND_LONG(command) => {
                let Some(&result) = self.results.get(&key(command)) else {
                    return Vec::new();
                };
                let mut messages = vec![MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
                    command: command.command,
                    result,
                    ..COMMAND_ACK_DATA::DEFAULT
                })];
                if key(command) == (MavCmd::MAV_CMD_REQUEST_MESSAGE as u32, ORIGIN) {
                    messages.extend(self.origin.clone().map(MavMessage::GPS_GLOBAL_ORIGIN));
                }
                messages
            }
            MavMessage::PARAM_REQUEST_READ(request) => {
                let name = request.param_id.to_str().unwrap();
                let recorded = self.parameters.get(name).cloned();
                // A parameter that the recorded client did not read yet has its default.
                let default = || {
                    let values = [Profile::ArduCopter, Profile::Px4].map(|p| p.parameter(name));
                    let value = values.into_iter().flatten().next()?;
                    Some(PARAM_VALUE_DATA {
                        param_value: value as f32,
                        param_id: request.param_id,
                        param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
                        ..PARAM_VALUE_DATA::DEFAULT
                    })
                };
                let value = recorded.or_else(default);
                value.map(MavMessage::PARAM_VALUE).into_iter().collect()
            }
            MavMessage::PARAM_SET(set) => {
                let Some(value) = self.parameters.get_mut(set.param_id.to_str().unwrap()) else {
                    return Vec::new();
                };
                value.param_value = set.param_value;
                vec![MavMessage::PARAM_VALUE(value.clone())]
            }
            _ => Vec::new(),
        }
    }
}

/// A sample as the client received it, and the time at which its message was received.
struct Seen {
    came: Instant,
    sample: Sample<f64>,
    /// The vehicle's clock at that time, as estimated by the client.
    vehicle_now: Instant,
}

/// A client that receives a recording.
struct Replay {
    records: VecDeque<Record>,
    answers: Answers,
    due: VecDeque<(Instant, MavMessage)>,
    vehicle: Address,
    client: Autopilot<f64>,
    now: Instant,
    launch_at: Option<Instant>,
    land_at: Option<Instant>,
    /// The path of the recorded vehicle, to which the legs lead.
    path: Vec<(Instant, Position<f64>)>,
    slot_end: Instant,
    missed_m: Vec<f64>,
    late: usize,
    seen: Vec<Seen>,
    phases: Vec<(Instant, Phase)>,
    events: Vec<(Instant, Event)>,
    sent: Vec<(Instant, MavMessage)>,
}

impl Replay {
    fn new(name: &str) -> Self {
        let all = records(name);
        let mut answers = Answers::of(&all);
        let (ours, mut records): (Vec<Record>, Vec<Record>) = all
            .into_iter()
            .partition(|record| record.from.component == 191);
        // The flight that never started never asked for the origin; the same simulator, started at
        // the same position, returned this one.
        if answers.origin.is_none() {
            answers.origin = Answers::of(&self::records("px4-sac")).origin;
            let key = (MavCmd::MAV_CMD_REQUEST_MESSAGE as u32, ORIGIN);
            answers.results.insert(key, MavResult::MAV_RESULT_ACCEPTED);
        }
        // Answers are sent on request, not by time.
        records.retain(|record| {
            !matches!(
                record.message,
                MavMessage::COMMAND_ACK(_) | MavMessage::PARAM_VALUE(_)
            )
        });
        let vehicle = records[0].from;
        let commanded = |wanted| {
            let mut commands = ours.iter().filter(|record| match &record.message {
                MavMessage::COMMAND_LONG(command) => command.command == wanted,
                _ => false,
            });
            commands.next().map(|record| record.at)
        };
        let map_origin = answers.origin.as_ref().map(|origin| Geodetic {
            latitude_e7: origin.latitude,
            longitude_e7: origin.longitude,
        });
        let profile = if name.starts_with("px4") {
            Profile::Px4
        } else {
            Profile::ArduCopter
        };
        let path = records.iter().filter_map(|record| match &record.message {
            MavMessage::LOCAL_POSITION_NED(p) => {
                let time = Instant::ZERO + Duration::from_millis(p.time_boot_ms.into());
                Some((time, Position::new(p.y.into(), p.x.into())))
            }
            _ => None,
        });
        Self {
            path: path.collect(),
            launch_at: commanded(MavCmd::MAV_CMD_DO_SET_MODE).map(|at| at.back(LAUNCH_LEAD)),
            land_at: commanded(MavCmd::MAV_CMD_NAV_LAND),
            client: Autopilot::new(AutopilotSettings {
                limits: profile.client_limits(),
                set_parameters: true,
                ..AutopilotSettings::new(map_origin.unwrap(), Position::origin(), 100.0, 30.0)
            })
            .unwrap(),
            records: records.into(),
            answers,
            due: VecDeque::new(),
            vehicle,
            now: Instant::ZERO,
            slot_end: Instant::ZERO,
            missed_m: Vec::new(),
            late: 0,
            seen: Vec::new(),
            phases: Vec::new(),
            events: Vec::new(),
            sent: Vec::new(),
        }
    }

    /// Returns the position of the recorded vehicle at that time of its clock, interpolated
    /// linearly between two samples.
    fn recorded_place(&self, at: Instant) -> Option<Position<f64>> {
        let i = self.path.partition_point(|(time, _)| *time < at).max(1);
        let ((begin, from), (end, to)) = (self.path[i - 1], *self.path.get(i)?);
        let fraction = (at - begin).as_secs_f64() / (end - begin).as_secs_f64();
        Some(from + (to - from) * fraction)
    }

    fn exchange(&mut self) {
        while let Some(message) = self.client.poll(self.now) {
            for answer in self.answers.to(&message) {
                self.due.push_back((self.now + ANSWER, answer));
            }
            self.sent.push((self.now, message));
        }
        while let Some(event) = self.client.take_next_event() {
            self.events.push((self.now, event));
        }
        let phase = self.client.phase();
        if self.phases.last().is_none_or(|(_, last)| *last != phase) {
            self.phases.push((self.now, phase));
        }
    }

    fn advance_to(&mut self, at: Instant) {
        loop {
            self.exchange();
            if self.due.front().is_some_and(|(due, _)| *due <= self.now) {
                let answer = self.due.pop_front().map(|(_, answer)| answer);
                self.client
                    .receive(self.now, self.vehicle, &answer.unwrap());
                continue;
            }
            if self
                .launch_at
                .take_if(|launch| *launch <= self.now)
                .is_some()
            {
                self.client.launch(self.now);
            }
            if self.land_at.take_if(|land| *land <= self.now).is_some() {
                self.client.land(self.now);
            }
            self.fly();
            if self.now >= at {
                return;
            }
            self.now = (self.now + TICK).min(at);
        }
    }

    /// Flies one leg after the other, each to the recorded vehicle's position at its end.
    fn fly(&mut self) {
        if self.client.phase() == Phase::LegEnded
            && let Some(ended) = self.client.leg_ended(self.now)
        {
            self.missed_m.push(ended.missed_m);
            self.late += usize::from(ended.tick.extrapolated);
        }
        if matches!(self.client.phase(), Phase::Ready | Phase::LegEnded) {
            let vehicle_now = self.client.vehicle_time(self.now).expect("it flies");
            let begin = if vehicle_now < self.slot_end + SLOT {
                self.slot_end
            } else {
                vehicle_now
            };
            let end = begin + SLOT;
            if let Some(waypoint) = self.recorded_place(end)
                && self.client.fly_leg(self.now, Leg { waypoint, end }).is_ok()
            {
                self.slot_end = end;
            }
        }
    }

    fn run(mut self) -> Self {
        while let Some(record) = self.records.pop_front() {
            self.advance_to(record.at);
            self.client.receive(self.now, record.from, &record.message);
            if matches!(record.message, MavMessage::LOCAL_POSITION_NED(_))
                && let Some(sample) = self.client.position()
            {
                let came = self.now;
                let vehicle_now = self.client.vehicle_time(came).expect("a sample came");
                self.seen.push(Seen {
                    came,
                    sample,
                    vehicle_now,
                });
            }
            self.exchange();
        }
        let end = self.now + Duration::from_millis(300);
        self.advance_to(end);
        self
    }

    fn reached(&self, wanted: Phase) -> Option<Instant> {
        // A phase that ends at once is visible only in the events, a leg only in the phases.
        let said = |(at, event): &(Instant, Event)| match event {
            Event::Phase(phase) if *phase == wanted => Some(*at),
            _ => None,
        };
        let seen = |(at, phase): &(Instant, Phase)| (*phase == wanted).then_some(*at);
        let said = self.events.iter().find_map(said);
        said.or_else(|| self.phases.iter().find_map(seen))
    }

    fn setpoints_after(&self, at: Instant) -> usize {
        let setpoints = self.sent.iter().filter(|(sent, message)| {
            let setpoint = matches!(
                message,
                MavMessage::SET_POSITION_TARGET_LOCAL_NED(_)
                    | MavMessage::SET_POSITION_TARGET_GLOBAL_INT(_)
            );
            setpoint && *sent > at
        });
        setpoints.count()
    }

    fn log(&self) -> String {
        let line = |(at, event): &(Instant, Event)| {
            format!("{:9.3} {event}\n", at.as_micros() as f64 * 1e-6)
        };
        self.events.iter().map(line).collect()
    }
}

fn seconds(at: Instant) -> f64 {
    at.as_micros() as f64 * 1e-6
}

/// PX4 stands still with ESTIMATOR_CONST_POS_MODE set for the whole recording.
#[test]
fn an_unmodified_px4_is_ready_to_start() {
    let replay = Replay::new("px4-unmodified-never-starts").run();
    let ready = replay.reached(Phase::Standby);
    let ready = ready.unwrap_or_else(|| panic!("never ready:\n{}", replay.log()));
    println!("ready after {:.1} s", seconds(ready));
    assert!(seconds(ready) < 30.0, "{}", replay.log());
    assert_eq!(replay.client.phase(), Phase::Standby, "{}", replay.log());
    assert_eq!(replay.client.fault(), None);
}

/// The mode changes at `at_s` of the recording: the client gives up control at once and
/// permanently.
#[track_caller]
fn taken_over(name: &str, mode: &str, at_s: f64, said: &[&str]) {
    let replay = Replay::new(name).run();
    let log = replay.log();
    // The vehicle was flying before.
    assert!(replay.reached(Phase::Leg).is_some(), "{log}");
    let taken = replay.events.iter().find_map(|(at, event)| match event {
        Event::Failsafe {
            cause: Cause::ControlTaken(_),
            reaction: Reaction::Release,
        } => Some(*at),
        _ => None,
    });
    let taken = taken.unwrap_or_else(|| panic!("control was not taken:\n{log}"));
    println!("{name}: taken at {:.3} s", seconds(taken));
    assert!((seconds(taken) - at_s).abs() < 0.3, "{log}");
    assert_eq!(replay.reached(Phase::Released), Some(taken), "{log}");
    assert!(log.contains(&format!("mode {mode}")), "{log}");
    for words in said {
        assert!(log.contains(words), "{words}: {log}");
    }
    // Until the end of the recording, whatever mode is set later.
    assert_eq!(replay.setpoints_after(taken), 0);
    assert_eq!(replay.client.phase(), Phase::Released);
    let fault = replay.client.fault();
    assert!(matches!(fault, Some(Cause::ControlTaken(_))), "{fault:?}");
}

#[test]
fn the_battery_failsafe_of_arducopter_takes_control() {
    let said = ["Battery 1 is low", "Battery Failsafe"];
    taken_over("arducopter-battery-rtl", "RTL", 108.0, &said);
}

#[test]
fn the_fence_of_arducopter_takes_control() {
    taken_over("arducopter-fence-rtl", "RTL", 103.6, &["fence breached"]);
}

/// The recorded pilot switches to LOITER, and 20 s later back to GUIDED.
#[test]
fn a_pilot_takes_control_and_it_is_never_taken_back() {
    let said = ["LOITER", "GUIDED"];
    taken_over("arducopter-pilot-takes-over", "LOITER", 102.8, &said);
}

/// Returns the rate of the recording's clock, in seconds of the vehicle's time per second of ours,
/// and for each of the (received, stamped) times, s, the time at which the message would have been
/// received with the smallest delay of the five seconds around it.
fn true_times(points: &[(f64, f64)]) -> (f64, Vec<f64>) {
    let n = points.len() as f64;
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / n;
    let (came, boot) = (mean(&|p| p.0), mean(&|p| p.1));
    let rate = mean(&|p| (p.0 - came) * (p.1 - boot)) / mean(&|p| (p.0 - came).powi(2));
    let delays: Vec<f64> = points
        .iter()
        .map(|(came, boot)| came - boot / rate)
        .collect();
    let time = |(i, (_, boot)): (usize, &(f64, f64))| {
        let around = &delays[i.saturating_sub(50)..(i + 50).min(delays.len())];
        boot / rate + around.iter().copied().fold(f64::INFINITY, f64::min)
    };
    (rate, points.iter().enumerate().map(time).collect())
}

/// Returns the error of each sample's time, ms, relative to the fastest sample of the five seconds
/// around it and the recording's own clock rate; positive if the client takes it for later than it
/// was.
fn time_errors_ms(seen: &[Seen]) -> Vec<f64> {
    let points: Vec<(f64, f64)> = seen
        .iter()
        .map(|seen| (seconds(seen.came), seconds(seen.sample.time)))
        .collect();
    let (_, truth) = true_times(&points);
    let error = |(seen, at): (&Seen, f64)| {
        let age_s = seconds(seen.vehicle_now) - seconds(seen.sample.time);
        ((seconds(seen.came) - at) - age_s) * 1e3
    };
    seen.iter().zip(truth).map(error).collect()
}

/// The whole flight: launched, every leg flown, landed; samples in order and at the right time.
#[track_caller]
fn flown(name: &str, legs: usize, worst_ms: f64) {
    let replay = Replay::new(name).run();
    let log = replay.log();
    for phase in [Phase::Standby, Phase::TakingOff, Phase::Ready, Phase::Leg] {
        assert!(replay.reached(phase).is_some(), "never {phase}:\n{log}");
    }
    assert_eq!(replay.client.fault(), None, "{log}");
    assert_eq!(replay.client.phase(), Phase::Landed, "{log}");
    assert!(replay.missed_m.len() >= legs, "{}", replay.missed_m.len());
    let missed_m = replay.missed_m.iter().copied().fold(0.0, f64::max);
    println!(
        "{name}: {} legs, at most {missed_m:.1} m from where the vehicle was, {} late",
        replay.missed_m.len(),
        replay.late
    );
    // A leg is late if the client did not know the position of the vehicle at its end.
    assert!(replay.late <= legs / 10, "{} late:\n{log}", replay.late);
    assert!(missed_m < 4.0, "{missed_m} m");
    for pair in replay.seen.windows(2) {
        let (a, b) = (&pair[0].sample, &pair[1].sample);
        assert!(b.time >= a.time, "time goes backwards: {a:?}, {b:?}");
    }
    let mut errors_ms = time_errors_ms(&replay.seen);
    // The estimate may take some seconds to settle, and the simulator stalled twice.
    errors_ms.drain(..200);
    errors_ms.iter_mut().for_each(|error| *error = error.abs());
    errors_ms.sort_by(f64::total_cmp);
    let at = |part: f64| errors_ms[(part * (errors_ms.len() - 1) as f64) as usize];
    let (half, most) = (at(0.5), at(0.95));
    println!("{name}: times wrong by {half:.1} ms (median), {most:.1} ms (95 %)");
    assert!(most < worst_ms, "{name}: {most} ms");
}

#[test]
fn the_arducopter_flight_is_followed() {
    flown("arducopter-sac", 50, 15.0);
}

#[test]
fn the_arducopter_flight_of_a_stock_airframe_is_followed() {
    // The simulator stalled for half a second.
    flown("arducopter-sac-stock-frame", 50, 60.0);
}

/// The clock of PX4's simulator ran at 0.991 of ours.
#[test]
fn the_px4_flight_is_followed() {
    flown("px4-sac", 50, 40.0);
}

#[test]
fn the_px4_flight_of_a_stock_airframe_is_followed() {
    flown("px4-sac-stock-frame", 50, 40.0);
}

/// A built-in vehicle that hovers at 100 m in the mode that follows setpoints and receives raw
/// messages.
struct StandIn {
    vehicle: Vehicle,
    encoder: Encoder,
    now: Instant,
    system: u8,
}

impl StandIn {
    fn airborne(profile: Profile, system: u8, clock_rate: f64) -> Self {
        let parameters: &[(&str, f32)] = match profile {
            Profile::Px4 => &[
                ("MPC_XY_VEL_MAX", 35.0),
                ("MPC_XY_CRUISE", 35.0),
                ("MPC_ACC_HOR_MAX", 10.0),
            ],
            _ => &[
                ("WPNAV_SPEED", 3500.0),
                ("WPNAV_ACCEL", 1000.0),
                ("ANGLE_MAX", 4500.0),
            ],
        };
        let origin = Geodetic::from_degrees(-35.362_812_9, 149.165_787).unwrap();
        let own = |&(name, value): &(&str, f32)| (name.to_owned(), value);
        let settings = VehicleSettings {
            system,
            clock_rate,
            parameters: parameters.iter().map(own).collect(),
            ..VehicleSettings::new(profile, origin, Position::origin())
        };
        let mut stand_in = Self {
            vehicle: Vehicle::new(settings),
            encoder: Encoder::new(Address {
                system: 255,
                component: 191,
            }),
            now: Instant::ZERO,
            system,
        };
        stand_in.wait(45.0);
        let mode = if profile == Profile::Px4 { 6.0 } else { 4.0 };
        if profile == Profile::Px4 {
            stand_in.hover(1.0);
        }
        stand_in.command(MavCmd::MAV_CMD_DO_SET_MODE, [1.0, mode], 0.0);
        stand_in.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, [1.0, 0.0], 0.0);
        if profile == Profile::Px4 {
            stand_in.hover(60.0);
        } else {
            stand_in.command(MavCmd::MAV_CMD_NAV_TAKEOFF, [0.0, 0.0], 100.0);
            stand_in.wait(60.0);
        }
        assert!((stand_in.vehicle.altitude_m() - 100.0).abs() < 1.0);
        stand_in
    }

    fn send(&mut self, message: &MavMessage) {
        let mut buffer = [0; MAX_FRAME];
        let frame = self.encoder.encode(message, &mut buffer);
        self.vehicle.receive(self.now, frame);
    }

    fn wait(&mut self, seconds: f64) {
        self.now += Duration::from_secs_f64(seconds);
        self.vehicle.step(self.now);
    }

    fn command(&mut self, command: MavCmd, [param1, param2]: [f32; 2], param7: f32) {
        self.send(&MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            command,
            param1,
            param2,
            param7,
            target_system: self.system,
            target_component: 1,
            ..COMMAND_LONG_DATA::DEFAULT
        }));
    }

    fn hover(&mut self, seconds: f64) {
        for _ in 0..(seconds * 10.0) as usize {
            self.send(&MavMessage::SET_POSITION_TARGET_LOCAL_NED(
                SET_POSITION_TARGET_LOCAL_NED_DATA {
                    z: -100.0,
                    target_system: self.system,
                    target_component: 1,
                    ..SET_POSITION_TARGET_LOCAL_NED_DATA::DEFAULT
                },
            ));
            self.wait(0.1);
        }
    }
}

/// Sends the recorded setpoints to the built-in vehicle at the recorded times. Returns the distance
/// between its position and that of the real one, m (root mean square, and maximum).
fn distance_m(profile: Profile, name: &str) -> (f64, f64) {
    let records = records(name);
    let mut setpoints = Vec::new();
    let mut samples = Vec::new();
    for record in &records {
        match &record.message {
            MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint) => {
                setpoints.push((seconds(record.at), setpoint));
            }
            MavMessage::LOCAL_POSITION_NED(sample) => {
                samples.push((
                    seconds(record.at),
                    f64::from(sample.time_boot_ms) * 1e-3,
                    sample,
                ));
            }
            _ => {}
        }
    }
    let points: Vec<(f64, f64)> = samples.iter().map(|s| (s.0, s.1)).collect();
    let (rate, times) = true_times(&points);
    // From the first setpoint in the air that moves the vehicle to the last one.
    let moves = |(_, s): &&(f64, &SET_POSITION_TARGET_LOCAL_NED_DATA)| {
        s.vx.hypot(s.vy) > 0.0 && s.z < -98.0
    };
    let begin = setpoints.iter().find(moves).unwrap().0;
    let end = setpoints.last().unwrap().0;
    let mut stand_in = StandIn::airborne(profile, setpoints[0].1.target_system, rate);
    let zero = seconds(stand_in.now) - begin;
    let (mut squares, mut most, mut number) = (0.0, 0.0_f64, 0);
    let mut setpoints = setpoints
        .into_iter()
        .filter(|(at, _)| *at >= begin)
        .peekable();
    for (at, (_, _, sample)) in times.into_iter().zip(&samples) {
        if at < begin || at > end {
            continue;
        }
        while let Some((sent, setpoint)) = setpoints.next_if(|(sent, _)| *sent <= at) {
            stand_in.now = Instant::from_micros(((zero + sent) * 1e6) as u64);
            stand_in.send(&MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint.clone()));
        }
        stand_in.now = Instant::from_micros(((zero + at) * 1e6) as u64);
        stand_in.vehicle.step(stand_in.now);
        // The vehicle moves in steps of 10 ms of its own time.
        let rest = (zero + at) * rate % 0.01;
        let place = stand_in.vehicle.true_position() + stand_in.vehicle.velocity() * rest;
        let off = place - Position::new(f64::from(sample.y), f64::from(sample.x));
        squares += off.norm_squared();
        most = most.max(off.norm());
        number += 1;
    }
    assert!(number > 1000, "{number}");
    ((squares / f64::from(number)).sqrt(), most)
}

/// With the recorded setpoints at their recorded times, from the start to the landing.
#[test]
fn the_built_in_vehicles_fly_as_the_recorded_ones_did() {
    for (profile, name, limit_m) in [
        (Profile::ArduCopter, "arducopter-sac", 0.6),
        (Profile::Px4, "px4-sac", 0.7),
    ] {
        let (rms, most) = distance_m(profile, name);
        println!("{name}: {rms:.2} m rms, at most {most:.2} m");
        assert!(rms < limit_m, "{name}: {rms} m");
        assert!(most < 4.0 * limit_m, "{name}: {most} m");
    }
}
