//! Ten thousand fault schedules on the ground link against the whole onboard computer: six slots
//! each, faults in the first five, none in the last, in missions of a hundred schedules.
//!
//! The following must hold in every case: there is no panic; no command contains a number that is
//! not finite, or violates a power limit; `Gamma` is met at the true channels wherever a command
//! promises it, with fresh or aged state; the shield's constraints hold; in the slot after the
//! faults everything works again; and every piece that the vehicle was sent is counted in one of
//! its counters.

mod ground;

use std::collections::{BTreeMap, VecDeque};

use firmware_core::{
    Position, PowerGain, SENSORS_MAX, aircomp,
    autopilot::{self, Autopilot, Phase, frames::Geodetic, wire::MAX_FRAME},
    controller::{ChannelSource, Controller, Plan},
    inner::{SlotLimits, Workspace},
    link::{Decoder, FRAME_MAX, Message, VehicleStatus},
    mission::MEASUREMENT_M,
    onboard::{Onboard, OnboardSettings, Stage},
    time::{Duration, Instant},
};
use ground::{Ground, HostCommand, HostMessage, HostMission, HostState, Wanderer, mission};
use link::faults::{Direction, Fault, FaultyLink, Injected, Schedule};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use vehicle::{Profile, Vehicle, VehicleSettings};

const MISSIONS: u64 = 100;
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
    /// The present slot as the vehicle reported it, and the state that it should use.
    plan: Option<Plan<f64>>,
    delivered: Option<HostState>,
    /// A second decoder behind the faults, whose counters are the expected values of the vehicle's.
    witness: Decoder,
    expected: VehicleStatus,
    position: Position<f64>,
    /// The last messages of the vehicle. A frame whose end was lost is complete at the next
    /// delimiter.
    said: VecDeque<HostMessage>,
    /// The counters and the injected faults at the start of the section.
    begun: (VehicleStatus, Injected),
    /// Whether the first arrival message of the slot was answered.
    asked_once: bool,
    seen: Seen,
}

impl Campaign {
    fn new(seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mission = mission(&mut random, SCHEDULES * SLOTS_EACH);
        let mut schedule = Schedule::default();
        for section in 0..SCHEDULES {
            let begin = section * SLOTS_EACH + 1;
            let faults = Schedule::draw(&mut random, begin, begin + SLOTS_EACH - 1);
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
        Self {
            now: Instant::ZERO,
            onboard: Onboard::new(SETTINGS, controller, client),
            vehicle: Vehicle::new(VehicleSettings::new(Profile::Ideal, origin, p.start)),
            place: p.start,
            ground: Ground::new(&mission, &random),
            faulty: FaultyLink::new(schedule.clone(), seed),
            plan: None,
            delivered: None,
            witness: Decoder::new(),
            expected: VehicleStatus::default(),
            position: p.start,
            schedule,
            mission,
            said: VecDeque::new(),
            asked_once: true,
            begun: (VehicleStatus::default(), Injected::default()),
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
        let mut own = Decoder::<FRAME_MAX>::new();
        let sent: Vec<HostMessage> = frame.iter().filter_map(|&b| own.push(b)?.ok()).collect();
        let [message] = sent.as_slice() else {
            panic!("the vehicle's own frame is damaged: {frame:?}");
        };
        match message {
            Message::Arrival(arrival) => {
                // At the time of the command the vehicle may already be at the end of the next
                // slot.
                self.place = self.vehicle.true_position();
                self.arrival(&arrival.plan, arrival.position);
            }
            Message::Command(command) => self.command(command),
            Message::Status(status) => assert_eq!(*status, self.onboard.status()),
            Message::ChannelState(_) | Message::Change(_) => panic!("not the vehicle's to send"),
        }
        let over = self.place;
        let heard = self.ground.heard.len();
        let down = self.faulty.down(frame);
        let answer = self.ground.receive(&down, &over);
        self.said.truncate(20);
        self.said.push_front(message.clone());
        for heard in &self.ground.heard[heard..] {
            assert!(self.said.contains(heard), "never said: {heard:?}");
        }
        let up = self.faulty.up(&answer);
        self.witness_of(&up);
        self.onboard.receive_ground(self.now, &up);
    }

    /// Predicts how the vehicle processes these bytes.
    fn witness_of(&mut self, bytes: &[u8]) {
        let counters = &mut self.expected.slots;
        for &byte in bytes {
            let Some(Ok(message)) = self.witness.push(byte) else {
                continue;
            };
            let message: HostMessage = message;
            let Message::ChannelState(state) = message else {
                counters.echoes += 1;
                continue;
            };
            let waiting = self.plan.filter(|plan| plan.slot == state.slot);
            let fits = state.user_gains.len() == self.mission.user_count()
                && state.sensor_gains.len() == self.mission.sensor_count();
            if waiting.is_none() || (fits && self.delivered.is_some()) {
                counters.states_out_of_turn += 1;
            } else if !fits {
                counters.states_of_wrong_size += 1;
            } else {
                self.delivered = Some(state);
            }
        }
    }

    fn arrival(&mut self, plan: &Plan<f64>, position: Position<f64>) {
        let reach_m = self.mission.reach_m();
        if self.plan == Some(*plan) {
            self.expected.slots.arrivals_repeated += 1;
            self.asked_once = false;
            return;
        }
        assert_eq!(plan.slot, self.expected.slots_done + 1);
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
        self.asked_once = true;
        self.plan = Some(*plan);
        self.delivered = None;
    }

    fn command(&mut self, command: &HostCommand) {
        let plan = self.plan.take().expect("an arrival before its command");
        let state = self.delivered.take();
        let slot = plan.slot;
        let context = || {
            let up: Vec<_> = self.schedule.faults(slot, Direction::Up).collect();
            format!("{command:?} for {plan:?} under {up:?} with {state:?}")
        };
        let p = self.mission.parameters();
        assert_eq!(command.slot, slot, "{}", context());
        if let Err(error) = command.check(&self.mission) {
            panic!("{error}: {}", context());
        }
        let coefficients = &command.sensor_coefficients;

        // The source of the gains is the state that was delivered.
        let fresh = command.source == ChannelSource::Measured;
        assert_eq!(fresh, state.is_some(), "{}", context());
        assert_eq!(fresh, command.age_slots == 0, "{}", context());
        let counters = &mut self.expected.slots;
        let (mut rejected, mut unheard) = (0, command.unheard_sensors);
        if let Some(state) = &state {
            let invalid =
                |gains: &[PowerGain<f64>]| gains.iter().filter(|g| !g.is_passive()).count();
            rejected = (invalid(&state.user_gains) + invalid(&state.sensor_gains)) as u16;
            let heard = |gain: &PowerGain<f64>| gain.is_passive() && gain.0 > 0.0;
            unheard = state
                .sensor_gains
                .iter()
                .filter(|gain| !heard(gain))
                .count() as u16;
            for (gain, b) in state.sensor_gains.iter().zip(coefficients) {
                assert!(heard(gain) || *b == 0.0, "{}", context());
            }
            let served = command.served_user.map(|user| state.user_gains[user]);
            assert!(served.is_none_or(|gain| heard(&gain)), "{}", context());
            let anybody = state.user_gains.iter().any(heard);
            assert_eq!(anybody, served.is_some(), "{}", context());
            counters.measured += 1;
        } else {
            counters.stale += 1;
        }
        assert_eq!(command.rejected_gains, rejected, "{}", context());
        assert_eq!(command.unheard_sensors, unheard, "{}", context());
        counters.rejected_gains += u32::from(rejected);
        counters.unheard_sensors += u32::from(unheard);
        counters.infeasible += u32::from(!command.status.is_feasible());
        counters.nobody_served += u32::from(command.served_user.is_none());
        let replaced = command
            .served_user
            .is_some_and(|user| user != plan.served_user);
        counters.user_replaced += u32::from(replaced);
        self.expected.slots_done += 1;

        // The guarantees hold at the true channels.
        let truth = self.ground.truth(slot, &self.place);
        let user_gain = command.served_user.map(|user| truth.user_gains[user]);
        let at_truth = aircomp::Slot {
            sensor_gains: &truth.sensor_gains,
            sensor_coefficients: coefficients,
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
        if rejected > 0 {
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
        // No frame was lost because of earlier damage: neither the arrival nor its answer.
        assert!(self.asked_once, "asked again: {context}");
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
        let (before, injected_before) = std::mem::replace(&mut self.begun, (status, injected));
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
        // A state that is also for another slot is first counted as out of turn.
        let out_of_turn = |fault: &Fault| matches!(fault, Fault::Late | Fault::OtherSlot(_));
        if !faults.iter().any(out_of_turn) {
            let too_few = injected.too_few - injected_before.too_few;
            let counted = status.slots.states_of_wrong_size - before.slots.states_of_wrong_size;
            assert_eq!(counted, too_few, "{context}");
        }
    }

    /// Checks that nothing is lost without being counted: the counters add up and equal those of
    /// the witness.
    fn check_counters(&mut self) -> VehicleStatus {
        let status = self.onboard.status();
        let injected = self.faulty.injected();
        self.expected.link = *self.witness.counters();
        self.expected.mavlink = status.mavlink;
        assert_eq!(status, self.expected);
        let link = status.link;
        assert_eq!(
            link.messages + link.dropped(),
            injected.pieces,
            "{link:?} {injected:?}"
        );
        let slots = status.slots;
        assert_eq!(slots.measured + slots.stale, status.slots_done);
        assert_eq!(slots.unsent, 0);
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
        status
    }
}

#[test]
fn ten_thousand_schedules_break_nothing() {
    let threads = std::thread::available_parallelism().map_or(2, |n| n.get() as u64);
    let mut total = Seen::new();
    std::thread::scope(|scope| {
        let crews: Vec<_> = (0..threads)
            .map(|first| {
                scope.spawn(move || {
                    let missions = (first..MISSIONS).step_by(threads as usize);
                    missions
                        .map(|seed| Campaign::new(seed).fly())
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
    let commands = MISSIONS * u64::from(SCHEDULES * SLOTS_EACH);
    assert_eq!(total["commands"], commands);
    // Each of these must have occurred often; otherwise the campaign proves nothing.
    for (what, count) in &total {
        assert!(*count > 100, "{what}: only {count}");
    }
    assert!(total.len() >= 17, "{total:?}");
}
