//! Ten thousand fault schedules on the ground link against the whole onboard computer: six slots
//! each, faults in the first five, none in the last, in missions of a hundred schedules.
//!
//! The following must hold in every case: there is no panic; no command contains a number that is
//! not finite, or violates a power limit; `Gamma` is met at the true channels wherever a command
//! promises it, with fresh or aged state; the shield's constraints hold; in the slot after the
//! faults everything works again; and every piece that the vehicle was sent is counted in one of
//! its counters. `link::audit` demands the rules of the link; what is checked here needs the true
//! channels, the mission or the injected faults.

mod ground;

use std::collections::{BTreeMap, VecDeque};

use firmware_core::{
    Position, SENSORS_MAX, aircomp,
    autopilot::{self, Autopilot, Phase, frames::Geodetic, wire::MAX_FRAME},
    controller::{ChannelSource, Controller, Plan},
    inner::{SlotLimits, Workspace},
    link::{Credentials, Endpoint, FRAME_MAX, GroundKey, Message, SecurityCounters, VehicleStatus},
    mission::MEASUREMENT_M,
    onboard::{Onboard, OnboardSettings, Stage},
    time::{Duration, Instant},
};
use ground::{Ground, HostCommand, HostMessage, HostMission, HostState, Wanderer, mission};
use link::{
    audit::{Audited, LinkAuditor},
    faults::{Direction, Fault, FaultyLink, Injected, Schedule},
};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use vehicle::{Profile, Vehicle, VehicleSettings};

const MISSIONS: u64 = 100;
/// The missions on an authenticated link.
const AUTHENTICATED: u64 = 10;
const SCHEDULES: u32 = 100;
const SLOTS_EACH: u32 = 6;
const TICK: Duration = Duration::from_millis(10);
/// The timeouts are short, so that missing messages do not cost much simulated time.
const SETTINGS: OnboardSettings = OnboardSettings {
    channel_patience: Duration::from_millis(60),
    arrival_interval: Duration::from_millis(20),
    planning_operations: 0,
};

/// The number of times that something was seen, so that a campaign that exercises nothing does not
/// pass.
type Seen = BTreeMap<&'static str, u64>;

fn note(seen: &mut Seen, what: &'static str) {
    *seen.entry(what).or_default() += 1;
}

struct Campaign {
    mission: HostMission,
    schedule: Schedule,
    now: Instant,
    onboard: Onboard<f64, Wanderer>,
    vehicle: Vehicle,
    /// The position of the vehicle at the end of the slot that it last reported.
    place: Position<f64>,
    ground: Ground,
    faulty: FaultyLink<f64>,
    /// The rules of the link, behind the faults.
    auditor: LinkAuditor<f64>,
    position: Position<f64>,
    /// The last messages of the vehicle. A frame whose end was lost is complete at the next
    /// delimiter.
    said: VecDeque<HostMessage>,
    /// The counters and the injected faults at the start of the section.
    begun: (VehicleStatus, SecurityCounters, Injected),
    seen: Seen,
}

impl Campaign {
    /// Creates a campaign on a link that is authenticated with `key`, or open.
    fn new(seed: u64, key: Option<&GroundKey>) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mission = mission(&mut random, SCHEDULES * SLOTS_EACH);
        let mut schedule = Schedule::default();
        for section in 0..SCHEDULES {
            let begin = section * SLOTS_EACH + 1;
            let draw = match key {
                Some(_) => Schedule::draw_with_attacks,
                None => Schedule::draw,
            };
            let faults = draw(&mut random, begin, begin + SLOTS_EACH - 1);
            schedule.episodes.extend(faults.episodes);
        }
        let p = mission.parameters();
        let origin = Geodetic::from_degrees(47.3977, 8.5456).expect("on Earth");
        let controller = Controller::new(mission.clone(), Wanderer(random.clone()));
        let client = Autopilot::new(autopilot::AutopilotSettings {
            limits: Profile::Ideal.client_limits(),
            ..autopilot::AutopilotSettings::new(origin, p.start, p.altitude_m, p.max_speed_mps)
        });
        let client = client.unwrap_or_else(|error| panic!("{error}"));
        let mut onboard = Onboard::new(SETTINGS, controller, client);
        let credentials = |key: &GroundKey, end: u8| Credentials {
            key: key.clone(),
            start: [end; 12],
        };
        let vehicle = key.map(|key| credentials(key, 3));
        if let Some(vehicle) = &vehicle {
            onboard.authenticate_ground(vehicle.clone());
        }
        let ground = key.map_or_else(Endpoint::new, |key| Endpoint::ground(credentials(key, 4)));
        Self {
            now: Instant::ZERO,
            onboard,
            vehicle: Vehicle::new(VehicleSettings::new(Profile::Ideal, origin, p.start)),
            place: p.start,
            ground: Ground::new(&mission, &random, ground),
            faulty: match key {
                Some(key) => FaultyLink::authenticated(schedule.clone(), seed, key),
                None => FaultyLink::new(schedule.clone(), seed),
            },
            auditor: match vehicle {
                Some(vehicle) => LinkAuditor::authenticated(mission.clone(), vehicle),
                None => LinkAuditor::new(mission.clone()),
            },
            position: p.start,
            schedule,
            mission,
            said: VecDeque::new(),
            begun: Default::default(),
            seen: Seen::new(),
        }
    }

    fn fly(mut self) -> Seen {
        self.onboard.autopilot_mut().launch(self.now);
        while !self.onboard.autopilot().phase().is_final() {
            assert!(
                self.now < Instant::from_micros(1_000_000_000),
                "never lands"
            );
            self.vehicle.step(self.now);
            self.exchange();
            self.now += TICK;
        }
        self.exchange();
        assert_eq!(
            self.onboard.stage(),
            Stage::Completed,
            "{:?}",
            self.onboard.fault()
        );
        assert_eq!(self.onboard.autopilot().phase(), Phase::Landed);
        assert!(
            self.mission.has_arrived(&self.position),
            "{}",
            self.position
        );
        let status = self.check_counters();
        assert_eq!(status.slots_done, self.mission.slots());
        // A quota can only be missed because of slots in which its user could not be served.
        let owed = self.onboard.controller().fairness().owed();
        assert!(
            owed <= status.slots.nobody_served + status.slots.user_replaced,
            "{owed} {status:?}"
        );
        // The last message that the ground received from the vehicle equals the vehicle's own
        // counters.
        let last = self
            .ground
            .heard
            .iter()
            .rev()
            .find_map(|message| match message {
                Message::Status(status) => Some(*status),
                _ => None,
            });
        assert_eq!(
            last.map(|last| (last.slots, last.link)),
            Some((status.slots, status.link))
        );
        self.seen
    }

    fn exchange(&mut self) {
        let mut mavlink = [0; MAX_FRAME];
        let mut downlink = [0; FRAME_MAX];
        loop {
            let mut quiet = true;
            while let Some(frame) = self.vehicle.next_frame() {
                quiet = false;
                self.onboard.receive_mavlink(self.now, &frame, true);
            }
            self.onboard.poll(self.now, &mut ());
            while let Some(frame) = self.onboard.take_mavlink_frame(self.now, &mut mavlink) {
                quiet = false;
                self.vehicle.receive(self.now, frame);
            }
            while let Some(frame) = self.onboard.take_ground_frame(&mut downlink) {
                quiet = false;
                let frame = frame.to_vec();
                self.carry(&frame);
            }
            if quiet {
                return;
            }
        }
    }

    /// Processes a frame from the vehicle: it is inspected, damaged and answered; the answer is
    /// damaged too.
    fn carry(&mut self, frame: &[u8]) {
        let audited = self.auditor.from_vehicle(frame);
        let audited = audited.unwrap_or_else(|error| panic!("{error}: {frame:?}"));
        let message = match audited.as_slice() {
            [message] => message,
            // A frame of the handshake.
            [] if self.onboard.security().is_some() => return self.pass(frame),
            other => panic!("not one message: {other:?} of {frame:?}"),
        };
        let message = match message {
            Audited::Arrival {
                arrival,
                is_repeated,
            } => {
                // At the time of the command the vehicle may already be at the end of the next
                // slot.
                self.place = self.vehicle.true_position();
                if !is_repeated {
                    self.arrival(&arrival.plan, arrival.position);
                }
                Message::Arrival(*arrival)
            }
            Audited::Command {
                command,
                plan,
                state,
                was_repeated,
            } => {
                self.command(command, plan, (state.as_ref(), *was_repeated));
                Message::Command(command.clone())
            }
            Audited::Status(status) => {
                assert_eq!(*status, self.onboard.status());
                Message::Status(*status)
            }
            Audited::Security(counters) => {
                assert_eq!(Some(counters), self.onboard.security());
                Message::Security(*counters)
            }
        };
        // A frame that has lost its end is heard with the next one, some silent slots later.
        self.said.truncate(100);
        self.said.push_front(message);
        self.pass(frame);
    }

    /// Damages a frame from the vehicle, answers it, and damages the answer.
    fn pass(&mut self, frame: &[u8]) {
        let over = self.place;
        let heard = self.ground.heard.len();
        let down = self.faulty.down(frame);
        let answer = self.ground.receive(&down, &over);
        for heard in &self.ground.heard[heard..] {
            assert!(self.said.contains(heard), "never said: {heard:?}");
        }
        let up = self.faulty.up(&answer);
        self.auditor.to_vehicle(&up);
        self.onboard.receive_ground(self.now, &up);
    }

    fn arrival(&mut self, plan: &Plan<f64>, position: Position<f64>) {
        let reach_m = self.mission.reach_m();
        assert!(!plan.intervention.out_of_reach, "{plan:?}");
        let area = &self.mission.parameters().area;
        assert!(area.contains(&plan.waypoint), "{plan:?}");
        let step_m = (plan.waypoint - self.position).norm();
        assert!(step_m <= reach_m + MEASUREMENT_M, "{step_m} {plan:?}");
        assert!(
            (plan.waypoint - position).norm() <= MEASUREMENT_M,
            "{plan:?} {position}"
        );
        self.position = position;
        self.ground.stray();
    }

    /// Checks a command of the slot `plan`, which was computed from `state`.
    fn command(
        &mut self,
        command: &HostCommand,
        plan: &Plan<f64>,
        (state, asked_again): (Option<&HostState>, bool),
    ) {
        let slot = plan.slot;
        let context = || {
            let up: Vec<_> = self.schedule.faults(slot, Direction::Up).collect();
            format!("{command:?} for {plan:?} under {up:?} with {state:?}")
        };
        let p = self.mission.parameters();
        let fresh = state.is_some();
        let replaced = command
            .served_user
            .is_some_and(|user| user != plan.served_user);

        // The guarantees hold at the true channels.
        let truth = self.ground.truth(slot, &self.place);
        let user_gain = command.served_user.map(|user| truth.user_gains[user]);
        let at_truth = aircomp::Slot {
            sensor_gains: &truth.sensor_gains,
            sensor_coefficients: &command.sensor_coefficients,
            user_gain: user_gain.unwrap_or_default(),
            user_power: command.user_power,
            noise_power: p.noise_power,
        };
        let mse = at_truth.mse(command.normalizing_factor);
        assert!(mse <= command.mse * (1.0 + 1e-9), "{mse}: {}", context());
        let least = command.rate * (1.0 - 1e-9);
        assert!(at_truth.rate() >= least, "{}", context());
        if command.status.is_feasible() {
            let most = p.mse_threshold * (1.0 + 1e-9);
            assert!(mse <= most, "{mse}: {}", context());
        }

        if slot.is_multiple_of(SLOTS_EACH) {
            let context = context();
            // No frame was lost because of earlier damage: neither the arrival nor its answer.
            assert!(!asked_again, "asked again: {context}");
            self.in_order_again(command, &truth, &context);
            self.end_section(slot, &context);
        }
        let seen = &mut self.seen;
        note(seen, "commands");
        match (fresh, command.status.is_feasible()) {
            (true, true) => note(seen, "fresh, feasible"),
            (true, false) => note(seen, "fresh, infeasible"),
            (false, true) => note(seen, "aged, feasible"),
            (false, false) => note(seen, "aged, infeasible"),
        }
        if command.rejected_gains > 0 {
            note(seen, "gains rejected");
        }
        if fresh {
            self.ground.become_known(&self.place);
        }
        if replaced {
            note(seen, "user replaced");
        }
        if command.served_user.is_none() {
            note(seen, "nobody served");
        }
    }

    /// Checks a slot without faults after slots with faults: fresh state, nothing missing, the
    /// optimum.
    fn in_order_again(&self, command: &HostCommand, truth: &HostState, context: &str) {
        assert_eq!(
            command.source,
            ChannelSource::Measured,
            "out of step: {context}"
        );
        assert_eq!(
            (command.rejected_gains, command.unheard_sensors),
            (0, 0),
            "{context}"
        );
        let mut workspace = Workspace::<f64, SENSORS_MAX>::default();
        let user = command.served_user.map(|user| truth.user_gains[user]);
        let best = workspace
            .sensors(&SlotLimits::of_mission(&self.mission), &truth.sensor_gains)
            .and_then(|field| field.solve(user))
            .expect("a slot problem");
        assert!(
            (command.rate - best.rate).abs() <= 1e-9 * best.rate,
            "{best:?}: {context}"
        );
    }

    /// Faults that damage no bytes are counted exactly as often as they were injected.
    fn end_section(&mut self, slot: u32, context: &str) {
        let (status, injected) = (self.onboard.status(), *self.faulty.injected());
        let security = self.onboard.security().copied().unwrap_or_default();
        let now = (status, security, injected);
        let (before, security_before, injected_before) = std::mem::replace(&mut self.begun, now);
        let faults: Vec<Fault> = (slot - SLOTS_EACH + 1..=slot)
            .flat_map(|slot| self.schedule.faults(slot, Direction::Up))
            .collect();
        let undecided =
            |fault: &Fault| fault.is_damage() || matches!(fault, Fault::Silence | Fault::Flood(_));
        if faults.iter().any(undecided) {
            return;
        }
        note(&mut self.seen, "sections without damage on the way up");
        let other_version = injected.other_version - injected_before.other_version;
        assert_eq!(
            status.link.version - before.link.version,
            other_version,
            "{context}"
        );
        let dropped = status.link.dropped() - before.link.dropped();
        assert_eq!(dropped, other_version, "{context}");
        let echoes = injected.echoes - injected_before.echoes;
        assert_eq!(
            status.slots.echoes - before.slots.echoes,
            echoes,
            "{context}"
        );
        let refused = [
            security.forged - security_before.forged,
            security.replayed - security_before.replayed,
            security.reflected - security_before.reflected,
            security.unauthenticated - security_before.unauthenticated,
        ];
        let attacks = [
            injected.forged - injected_before.forged,
            injected.replayed - injected_before.replayed,
            injected.reflected - injected_before.reflected,
            injected.downgraded - injected_before.downgraded,
        ];
        assert_eq!(refused, attacks, "{context}");
        // A state that is also for another slot is first counted as out of turn.
        let out_of_turn = |fault: &Fault| matches!(fault, Fault::Late | Fault::OtherSlot(_));
        if !faults.iter().any(out_of_turn) {
            let too_few = injected.too_few - injected_before.too_few;
            let counted = status.slots.states_of_wrong_size - before.slots.states_of_wrong_size;
            assert_eq!(counted, too_few, "{context}");
        }
    }

    /// Checks that nothing is lost without being counted: the counters add up and are those that
    /// follow from the bytes.
    fn check_counters(&mut self) -> VehicleStatus {
        let status = self.onboard.status();
        let checked = self.auditor.check_status(&status);
        checked.unwrap_or_else(|error| panic!("{error}"));
        let (link, slots) = (status.link, status.slots);
        let mavlink = status.mavlink;
        assert!(mavlink.frames > 0 && mavlink.bad_checksum + mavlink.skipped_bytes == 0);
        for (what, count) in [
            ("pieces too long", link.too_long),
            ("pieces malformed", link.malformed),
            ("pieces with a wrong checksum", link.checksum),
            ("frames of another version", link.version),
            ("echoes", slots.echoes),
            ("states out of turn", slots.states_out_of_turn),
            ("states of a wrong size", slots.states_of_wrong_size),
            ("arrivals repeated", slots.arrivals_repeated),
        ] {
            *self.seen.entry(what).or_default() += u64::from(count);
        }
        if let Some(security) = self.onboard.security() {
            // One session, and nothing ended it.
            assert_eq!(security.sessions, 1);
            for (what, count) in [
                ("forged frames", security.forged),
                ("replayed frames", security.replayed),
                ("reflected frames", security.reflected),
                ("frames without authentication", security.unauthenticated),
            ] {
                *self.seen.entry(what).or_default() += u64::from(count);
            }
        }
        status
    }
}

/// Flies the missions on all processors, and demands that everything that they are for was seen in
/// them often: otherwise the campaign proves nothing.
fn fly(missions: u64, key: Option<&GroundKey>) -> Seen {
    let threads = std::thread::available_parallelism().map_or(2, |n| n.get() as u64);
    let mut total = Seen::new();
    std::thread::scope(|scope| {
        let crews: Vec<_> = (0..threads)
            .map(|first| {
                scope.spawn(move || {
                    let missions = (first..missions).step_by(threads as usize);
                    missions
                        .map(|seed| Campaign::new(seed, key).fly())
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        for crew in crews {
            for (what, count) in crew.join().expect("no panic").into_iter().flatten() {
                *total.entry(what).or_default() += count;
            }
        }
    });
    for (what, count) in &total {
        println!("{count:7} {what}");
    }
    let commands = missions * u64::from(SCHEDULES * SLOTS_EACH);
    assert_eq!(total["commands"], commands);
    for (what, count) in &total {
        assert!(*count > missions, "{what}: only {count}");
    }
    total
}

#[test]
fn ten_thousand_schedules_break_nothing() {
    let seen = fly(MISSIONS, None);
    assert!(seen.len() >= 17, "{seen:?}");
}

/// The same with a key, and with somebody on the radio who does not have it: besides the rules above,
/// every frame of theirs is refused and counted as what it is, and the session goes on.
#[test]
fn a_thousand_schedules_with_attackers_break_nothing() {
    let seen = fly(AUTHENTICATED, Some(&GroundKey::new([42; 32])));
    assert!(seen.len() >= 21, "{seen:?}");
}
