//! Attacks on the ground link of the whole onboard computer in flight, with and without a key. The
//! ground falls silent after a few slots, and somebody on the radio goes on, who reads, records,
//! repeats and invents frames and does not have the key.
//!
//! Without a key the test documents what each attack achieves; with a key no attack is taken, and none
//! holds off the failsafe for a silent ground. `docs/security.md` has the same as a table.

use firmware_core::{
    Position, PowerGain, USERS_MAX, Watt,
    autopilot::{
        self, Autopilot,
        failsafe::{Cause, Watch},
        frames::Geodetic,
        wire::MAX_FRAME,
    },
    controller::{ChannelState, Controller, DatedChange},
    link::{self, Credentials, Endpoint, FRAME_MAX, GroundKey, NumberedChange},
    mission::{Area, Environment, ExcessLoss, MissionChange, MissionParameters, RadioModel},
    onboard::{Onboard, OnboardSettings, Stage},
    policy::StraightLine,
    time::{Duration, Instant},
};
use vehicle::{Profile, Vehicle, VehicleSettings};

type Mission = firmware_core::Mission<f64>;
type Message = link::Message<f64, USERS_MAX, 64>;

const TICK: Duration = Duration::from_millis(20);
const SLOTS: u32 = 20;
/// The last slot in which the ground answers.
const SILENT_AFTER: u32 = 4;
/// The longest silence of the ground.
const PATIENCE: Duration = Duration::from_secs(4);
/// The key of both ends; the attacker does not know it.
const KEY: [u8; 32] = [0x11; 32];

fn mission() -> Mission {
    let sensors = [(40.0, 60.0), (60.0, 40.0), (80.0, 70.0)];
    Mission::new(MissionParameters {
        slots: SLOTS,
        slot_duration_s: 1.0,
        start: Position::new(20.0, 50.0),
        destination: Position::new(60.0, 50.0),
        area: Area {
            east_m: 150.0,
            north_m: 100.0,
        },
        altitude_m: 30.0,
        max_speed_mps: 5.0,
        carrier_hz: 2e9,
        radio_model: RadioModel::ProbabilisticLos,
        environment: Environment { a: 9.613, b: 0.158 },
        excess_loss_db: ExcessLoss {
            los: 1.0,
            nlos: 20.0,
        },
        noise_power: Watt::from_dbm(-90.0),
        mse_threshold: 0.1,
        user_power_max: Watt(0.2),
        sensor_power_max: Watt(0.05),
        users: [Position::new(90.0, 50.0)].into_iter().collect(),
        sensors: sensors
            .map(|(x, y)| Position::new(x, y))
            .into_iter()
            .collect(),
    })
    .expect("a mission")
}

/// What somebody on the radio does while the ground is silent.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Attack {
    /// Nothing.
    None,
    /// States of the slot that the vehicle asks for, with gains of the attacker's choice.
    ForgedState,
    /// The same, with the nonces and counters that can be read on the radio and a guessed tag.
    ForgedTag,
    /// A lower demand on the MSE, as a change of the mission.
    ForgedChange,
    /// All that the ground has said, again.
    Replay,
    /// The same in the opposite order.
    Reorder,
    /// All that the ground said in an earlier flight of this mission, when the vehicle asks.
    ReplayFlight,
    /// All that the vehicle says, back to it.
    Reflect,
    /// The ground's frames without their ends.
    Truncate,
}

/// What an attack achieved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Achieved {
    /// States of the attacker that a slot was allocated from.
    states: u32,
    /// Changes of the mission.
    changes: u32,
    /// Whether the vehicle did not land because the ground was silent.
    held_off: bool,
}

struct Flight {
    now: Instant,
    onboard: Onboard<f64, StraightLine<f64, USERS_MAX>>,
    vehicle: Vehicle,
    ground: Endpoint,
    /// The key's ends, if there is one: the attacker's own, with another key.
    forger: Option<(Endpoint, Endpoint)>,
    /// The frames of the ground so far, and those of an earlier flight.
    said: Vec<Vec<u8>>,
    earlier: Vec<Vec<u8>>,
    mission: Mission,
    attack: Attack,
    is_silent: bool,
    /// The frames of the attacker that were delivered.
    delivered: u32,
}

/// Returns the credentials of the start number `start` of an end.
fn credentials(end: u8, start: u8, key: [u8; 32]) -> Credentials {
    let mut bytes = [end; 12];
    bytes[0] = start;
    Credentials {
        key: GroundKey::new(key),
        start: bytes,
    }
}

impl Flight {
    fn new(attack: Attack, with_key: bool, start: u8, earlier: Vec<Vec<u8>>) -> Self {
        let mission = mission();
        let p = mission.parameters();
        let origin = Geodetic::from_degrees(47.3977, 8.5456).expect("on Earth");
        let settings = autopilot::AutopilotSettings {
            limits: Profile::Ideal.client_limits(),
            watch: Watch {
                ground: Some(PATIENCE),
                ..Watch::default()
            },
            ..autopilot::AutopilotSettings::new(origin, p.start, p.altitude_m, p.max_speed_mps)
        };
        let client = Autopilot::new(settings).unwrap_or_else(|error| panic!("{error}"));
        let controller = Controller::new(mission.clone(), StraightLine::new(&mission));
        let mut onboard = Onboard::new(OnboardSettings::default(), controller, client);
        let mut ground = Endpoint::new();
        let mut forger = None;
        if with_key {
            onboard.authenticate_ground(credentials(1, start, KEY));
            ground = Endpoint::ground(credentials(2, start, KEY));
            let key = [0x12; 32];
            let mut ends = (
                Endpoint::ground(credentials(2, start, key)),
                Endpoint::vehicle(credentials(1, start, key)),
            );
            for _ in 0..2 {
                let to_ground = handshake(&mut ends.1);
                push(&mut ends.0, &to_ground);
                let to_vehicle = handshake(&mut ends.0);
                push(&mut ends.1, &to_vehicle);
            }
            forger = Some(ends);
        }
        Self {
            now: Instant::ZERO,
            onboard,
            vehicle: Vehicle::new(VehicleSettings::new(Profile::Ideal, origin, p.start)),
            ground,
            forger,
            said: Vec::new(),
            earlier,
            mission,
            attack,
            is_silent: false,
            delivered: 0,
        }
    }

    /// Flies to the end and returns what the attack has achieved, and what the ground has said.
    fn fly(mut self) -> (Achieved, Vec<Vec<u8>>, Self) {
        self.onboard.autopilot_mut().launch(self.now);
        while !self.onboard.autopilot().phase().is_final() {
            assert!(self.now < Instant::from_micros(200_000_000), "never lands");
            self.vehicle.step(self.now);
            self.exchange();
            self.now += TICK;
        }
        let status = self.onboard.status();
        let achieved = Achieved {
            states: status.slots.measured - SILENT_AFTER.min(status.slots.measured),
            changes: status.slots.changes,
            held_off: self.onboard.autopilot().fault() != Some(Cause::GroundSilent),
        };
        let whole = self.onboard.stage() == Stage::Completed;
        assert_eq!(
            whole,
            achieved.held_off,
            "{:?}",
            self.onboard.autopilot().fault()
        );
        (achieved, std::mem::take(&mut self.said), self)
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
                self.answer(&frame);
            }
            if quiet {
                return;
            }
        }
    }

    /// The ground answers, or is silent and the attacker goes on.
    fn answer(&mut self, frame: &[u8]) {
        if !self.is_silent {
            let known = self.said.len();
            let mut buffer = [0; FRAME_MAX];
            for &byte in frame {
                let message = self.ground.push::<f64, USERS_MAX, 64>(byte);
                if let Some(answer) = self.ground.take_handshake(&mut buffer) {
                    self.said.push(answer.to_vec());
                }
                if let Some(Ok(Message::Arrival(arrival))) = message {
                    let slot = arrival.plan.slot;
                    if slot > SILENT_AFTER && self.attack != Attack::None {
                        self.is_silent = true;
                        break;
                    }
                    let state = ChannelState::predicted(&self.mission, slot, &arrival.position);
                    let state = Message::ChannelState(state);
                    let frame = self.ground.encode(&state, &mut buffer).expect("a session");
                    self.said.push(frame.to_vec());
                }
            }
            for frame in self.said.iter().skip(known) {
                self.onboard.receive_ground(self.now, frame);
            }
        }
        if self.is_silent {
            for frame in self.attacks(frame) {
                self.delivered += 1;
                self.onboard.receive_ground(self.now, &frame);
            }
        }
    }

    /// Returns the attacker's frames after a frame of the vehicle.
    fn attacks(&mut self, frame: &[u8]) -> Vec<Vec<u8>> {
        let slot = self.onboard.status().slots_done + 1;
        let mut loud = ChannelState::predicted(&self.mission, slot, &Position::new(60.0, 50.0));
        loud.sensor_gains.fill(PowerGain(1e-6));
        let state = Message::ChannelState(loud);
        let change = Message::Change(NumberedChange {
            number: 1,
            change: DatedChange {
                from_slot: slot,
                change: MissionChange::MseThreshold(0.3),
            },
        });
        match self.attack {
            Attack::None => Vec::new(),
            Attack::ForgedState => vec![open(&state)],
            Attack::ForgedChange => vec![open(&change)],
            Attack::ForgedTag => match &mut self.forger {
                Some((ground, _)) => [state, change]
                    .iter()
                    .map(|message| {
                        let mut buffer = [0; FRAME_MAX];
                        ground
                            .encode(message, &mut buffer)
                            .expect("a session")
                            .to_vec()
                    })
                    .collect(),
                None => vec![open(&state)],
            },
            Attack::Replay => self.said.clone(),
            Attack::Reorder => self.said.iter().rev().cloned().collect(),
            Attack::ReplayFlight => self.earlier.clone(),
            Attack::Reflect => vec![frame.to_vec()],
            Attack::Truncate => {
                let cut = |frame: &Vec<u8>| [&frame[..frame.len() - 9], &[0]].concat();
                self.said.iter().map(cut).collect()
            }
        }
    }
}

/// Returns a message as a frame without authentication.
fn open(message: &Message) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    link::encode(message, &mut buffer).expect("fits").to_vec()
}

fn handshake(end: &mut Endpoint) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    end.take_handshake(&mut buffer).unwrap_or_default().to_vec()
}

fn push(end: &mut Endpoint, bytes: &[u8]) {
    for &byte in bytes {
        let _ = end.push::<f64, USERS_MAX, 64>(byte);
    }
}

/// Flies the mission with a ground that answers in every slot, and returns what it said.
fn whole_flight(with_key: bool) -> Vec<Vec<u8>> {
    let (achieved, said, flight) = Flight::new(Attack::None, with_key, 0, Vec::new()).fly();
    assert!(achieved.held_off, "the ground was never silent");
    assert_eq!(flight.onboard.status().slots.measured, SLOTS);
    assert_eq!(flight.onboard.status().slots.echoes, 0);
    said
}

/// Every attack, and what it achieves on an open link. A forger has the vehicle allocate from gains of
/// its choice, change the mission, and fly on without a ground; so does somebody who recorded an
/// earlier flight. What the ground or the vehicle said in this flight achieves nothing.
const ATTACKS: [(Attack, Achieved); 8] = {
    const NOTHING: Achieved = Achieved {
        states: 0,
        changes: 0,
        held_off: false,
    };
    const EVERY_SLOT: Achieved = Achieved {
        states: SLOTS - SILENT_AFTER,
        changes: 0,
        held_off: true,
    };
    [
        (Attack::ForgedState, EVERY_SLOT),
        (Attack::ForgedTag, EVERY_SLOT),
        (
            Attack::ForgedChange,
            Achieved {
                changes: 1,
                ..NOTHING
            },
        ),
        (Attack::Replay, NOTHING),
        (Attack::Reorder, NOTHING),
        (Attack::ReplayFlight, EVERY_SLOT),
        (Attack::Reflect, NOTHING),
        (Attack::Truncate, NOTHING),
    ]
};

#[test]
fn what_each_attack_achieves_on_an_open_link() {
    let earlier = whole_flight(false);
    for (attack, expected) in ATTACKS {
        let (achieved, _, flight) = Flight::new(attack, false, 1, earlier.clone()).fly();
        assert!(
            flight.delivered > 3,
            "{attack:?}: only {}",
            flight.delivered
        );
        assert_eq!(achieved, expected, "{attack:?}");
        if attack == Attack::Reflect {
            assert!(flight.onboard.status().slots.echoes > 3);
        }
    }
}

#[test]
fn with_a_key_no_attack_is_taken_or_holds_off_the_failsafe() {
    let earlier = whole_flight(true);
    for (attack, _) in ATTACKS {
        let (achieved, _, flight) = Flight::new(attack, true, 1, earlier.clone()).fly();
        assert!(
            flight.delivered > 3,
            "{attack:?}: only {}",
            flight.delivered
        );
        assert_eq!(achieved, Achieved::default(), "{attack:?}");
        let status = flight.onboard.status();
        // The ground's own states, and the attacker's frames refused one by one.
        assert_eq!(status.link.messages, SILENT_AFTER, "{attack:?}");
        let security = flight.onboard.security().expect("a key");
        let refused = security.refused() + status.link.dropped();
        assert_eq!(refused, flight.delivered, "{attack:?}: {security:?}");
        let counted = match attack {
            Attack::None => unreachable!(),
            Attack::ForgedState | Attack::ForgedChange => security.unauthenticated,
            Attack::ForgedTag => security.forged,
            Attack::Replay | Attack::Reorder => security.replayed,
            Attack::ReplayFlight => security.other_session,
            Attack::Reflect => security.reflected,
            Attack::Truncate => status.link.dropped(),
        };
        assert_eq!(counted, refused, "{attack:?}: {security:?}");
        assert_eq!(
            (security.sessions, security.handshakes),
            (1, 1),
            "{attack:?}"
        );
    }
}

/// A ground that is restarted answers the offer that the vehicle makes in each slot.
#[test]
fn a_ground_that_is_restarted_in_flight_is_heard_again() {
    let mut flight = Flight::new(Attack::None, true, 0, Vec::new());
    flight.onboard.autopilot_mut().launch(flight.now);
    let mut restarts = 0;
    while !flight.onboard.autopilot().phase().is_final() {
        flight.vehicle.step(flight.now);
        flight.exchange();
        flight.now += TICK;
        let done = flight.onboard.status().slots_done;
        if done / 6 > restarts {
            restarts += 1;
            flight.ground = Endpoint::ground(credentials(2, 10 + restarts as u8, KEY));
        }
    }
    assert_eq!(flight.onboard.stage(), Stage::Completed);
    let security = flight.onboard.security().expect("a key");
    assert_eq!((restarts, security.sessions), (3, 4));
    let slots = flight.onboard.status().slots;
    // A restart costs the slot in which it happens at most.
    assert!(slots.measured >= SLOTS - restarts, "{slots:?}");
    assert_eq!(security.refused(), 0, "{security:?}");
}
