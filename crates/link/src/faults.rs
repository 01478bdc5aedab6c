//! Fault injection for the ground link: bytes that are lost, flipped, inserted or repeated, cut
//! frames, silence and floods; frames of another protocol version; states about another slot, with
//! too few gains, or too late; gains that are invalid, and sensors and users that are not received.
//!
//! A [`FaultyLink`] is placed between the two ends: bytes go in and bytes come out, in both
//! directions. It therefore works with an onboard computer in the same process and with one at the
//! end of a socket. A [`Schedule`] defines which faults occur in which slots. The same seed gives
//! the same damage. ([`lossy`](super::lossy) does the same for frames and time on the MAVLink
//! side.)
//!
//! On an authenticated link a [`FaultyLink`] has the key: it is the vehicle to the ground, and the
//! ground to the vehicle. Faults of messages are then those of a ground that is out of order, and
//! damage and [attacks](Fault::is_attack) those of the radio.

use firmware_core::{
    PowerGain, SENSORS_MAX, Scalar, USERS_MAX,
    controller::ChannelState,
    link::{
        self, Credentials, Endpoint, FRAME_MAX, GroundKey, Message, PROTOCOL_VERSION,
        VehicleStatus, frame_max,
    },
};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A fault of the link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Each byte is lost with this probability.
    Lose(f64),
    /// Each byte has one bit flipped with this probability.
    Flip(f64),
    /// Before each byte, another one is inserted with this probability. Half of the inserted bytes
    /// are delimiters.
    Insert(f64),
    /// Each byte is repeated with this probability.
    Repeat(f64),
    /// Frames are truncated at a random position.
    Cut,
    /// Nothing passes.
    Silence,
    /// Before every frame, this many bytes of noise without a delimiter are inserted.
    Flood(usize),
    /// To the vehicle: a frame of another protocol version is inserted before each frame.
    OtherVersion,
    /// To the vehicle: a message of the kind that it sends itself is inserted before each frame.
    Echo,
    /// To the vehicle: states are sent twice.
    Twice,
    /// To the vehicle: states are about a slot this many away.
    OtherSlot(i8),
    /// To the vehicle: states have one gain too few, of a user or of a sensor.
    TooFew(Node),
    /// To the vehicle: states arrive after the next slot's arrival, one slot late.
    Late,
    /// To the vehicle: each gain is replaced by an invalid one with this probability.
    NoGain(f64),
    /// Each sensor is not received with this probability.
    SensorsVanish(f64),
    /// Each user is not received with this probability.
    UsersVanish(f64),
    /// To the vehicle, on an authenticated link: before each frame comes one of somebody without
    /// the key.
    Forged,
    /// To the vehicle, on an authenticated link: before each frame comes an earlier one again.
    Replayed,
    /// To the vehicle, on an authenticated link: before each frame comes one of the vehicle's own.
    Reflected,
    /// To the vehicle, on an authenticated link: before each frame comes one without
    /// authentication.
    Downgraded,
}

/// The sender of a message to the vehicle over the air.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// A user.
    User,
    /// A sensor.
    Sensor,
}

impl Fault {
    /// Returns whether the fault damages bytes, so that the schedule alone does not determine what
    /// happens to a frame.
    pub fn is_damage(&self) -> bool {
        matches!(
            self,
            Self::Lose(_) | Self::Flip(_) | Self::Insert(_) | Self::Repeat(_) | Self::Cut
        )
    }

    /// Returns whether the fault is an attack on an authenticated link.
    pub fn is_attack(&self) -> bool {
        matches!(
            self,
            Self::Forged | Self::Replayed | Self::Reflected | Self::Downgraded
        )
    }

    fn draw_attack(random: &mut impl Rng) -> Self {
        match random.random_range(0..4) {
            0 => Self::Forged,
            1 => Self::Replayed,
            2 => Self::Reflected,
            _ => Self::Downgraded,
        }
    }

    fn draw(random: &mut impl Rng) -> Self {
        // From one byte in a mission to every third byte.
        let mut rate = || 10f64.powf(random.random_range(-4.0..-0.5));
        let rate = rate();
        let share = random.random_range(0.02..1.0);
        match random.random_range(0..16) {
            0 => Self::Lose(rate),
            1 => Self::Flip(rate),
            2 => Self::Insert(rate),
            3 => Self::Repeat(rate),
            4 => Self::Cut,
            5 => Self::Silence,
            6 => Self::Flood(random.random_range(1..4 * frame_max::<f64>(USERS_MAX, SENSORS_MAX))),
            7 => Self::OtherVersion,
            8 => Self::Echo,
            9 => Self::Twice,
            // The offset is never one slot ahead: such a state, if it is late, would be accepted as
            // the right one.
            10 => Self::OtherSlot(if random.random() { 100 } else { -1 }),
            11 if random.random() => Self::TooFew(Node::User),
            11 => Self::TooFew(Node::Sensor),
            12 => Self::Late,
            13 => Self::NoGain(share),
            14 => Self::SensorsVanish(share),
            _ => Self::UsersVanish(share),
        }
    }
}

/// The direction in which bytes are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the ground to the vehicle.
    Up,
    /// From the vehicle to the ground.
    Down,
}

/// A fault that occurs in a range of slots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Episode {
    /// The fault.
    pub fault: Fault,
    /// The direction that is affected. Faults of messages always affect the direction to the
    /// vehicle.
    pub direction: Direction,
    /// The first slot that is affected.
    pub from_slot: u32,
    /// The first slot after those that are affected.
    pub to_slot: u32,
}

/// The faults of a mission and the slots in which they occur.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Schedule {
    /// The episodes, in any order. Episodes that overlap are all applied.
    pub episodes: Vec<Episode>,
}

impl Schedule {
    /// Draws one to four random episodes from slot `from_slot` to `to_slot`, the latter excluded.
    pub fn draw(random: &mut impl Rng, from_slot: u32, to_slot: u32) -> Self {
        let episodes = (0..random.random_range(1..=4)).map(|_| {
            let begin = random.random_range(from_slot..to_slot);
            let fault = Fault::draw(random);
            let carried_by_any =
                fault.is_damage() || matches!(fault, Fault::Silence | Fault::Flood(_));
            Episode {
                fault,
                direction: if carried_by_any && random.random() {
                    Direction::Down
                } else {
                    Direction::Up
                },
                from_slot: begin,
                to_slot: random.random_range(begin + 1..=to_slot),
            }
        });
        Self {
            episodes: episodes.collect(),
        }
    }

    /// As [`draw`](Self::draw), with one or two attacks on an authenticated link as well.
    pub fn draw_with_attacks(random: &mut impl Rng, from_slot: u32, to_slot: u32) -> Self {
        let mut schedule = Self::draw(random, from_slot, to_slot);
        for _ in 0..random.random_range(1..=2) {
            let begin = random.random_range(from_slot..to_slot);
            schedule.episodes.push(Episode {
                fault: Fault::draw_attack(random),
                direction: Direction::Up,
                from_slot: begin,
                to_slot: random.random_range(begin + 1..=to_slot),
            });
        }
        schedule
    }

    /// Returns the faults of a slot in a direction.
    pub fn faults(&self, slot: u32, direction: Direction) -> impl Iterator<Item = Fault> + '_ {
        self.episodes
            .iter()
            .filter(move |e| e.direction == direction && (e.from_slot..e.to_slot).contains(&slot))
            .map(|e| e.fault)
    }
}

/// The messages that a [`FaultyLink`] has changed or inserted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Injected {
    /// The number of frames of another protocol version.
    pub other_version: u32,
    /// The number of messages of the kind that the vehicle sends itself.
    pub echoes: u32,
    /// The number of states with a gain too few.
    pub too_few: u32,
    /// The number of frames that were made without the key.
    pub forged: u32,
    /// The number of frames that were sent again.
    pub replayed: u32,
    /// The number of frames of the vehicle that were sent back to it.
    pub reflected: u32,
    /// The number of frames without authentication.
    pub downgraded: u32,
}

/// A ground link with faults. `T` is the precision that both ends use.
#[derive(Debug)]
pub struct FaultyLink<T: Scalar> {
    schedule: Schedule,
    seed: u64,
    random: Pcg64Mcg,
    /// The slot whose arrival the vehicle last reported.
    slot: u32,
    /// The end that the vehicle talks to.
    ground: Endpoint,
    /// The end that the ground talks to.
    vehicle: Endpoint,
    /// Frames of the handshake for either side, which are sent with the next bytes.
    to_vehicle: Vec<u8>,
    to_ground: Vec<u8>,
    attacker: Option<Attacker>,
    /// The frames that are sent when the slot is over.
    late: Vec<(u32, Vec<u8>)>,
    injected: Injected,
    precision: core::marker::PhantomData<T>,
}

type AnyMessage<T> = Message<T, USERS_MAX, SENSORS_MAX>;

impl<T: Scalar> FaultyLink<T> {
    /// Creates a link with this schedule.
    pub fn new(schedule: Schedule, seed: u64) -> Self {
        Self {
            schedule,
            seed,
            random: Pcg64Mcg::seed_from_u64(seed),
            slot: 0,
            ground: Endpoint::new(),
            vehicle: Endpoint::new(),
            to_vehicle: Vec::new(),
            to_ground: Vec::new(),
            attacker: None,
            late: Vec::new(),
            injected: Injected::default(),
            precision: core::marker::PhantomData,
        }
    }

    /// Creates a link between two ends that share `key`.
    pub fn authenticated(schedule: Schedule, seed: u64, key: &GroundKey) -> Self {
        let credentials = |key: &GroundKey, end: u8| {
            let mut start = [end; 12];
            start[..8].copy_from_slice(&seed.to_le_bytes());
            let key = key.clone();
            Credentials { key, start }
        };
        let (vehicle, ground) = (credentials(key, 1), credentials(key, 2));
        Self {
            vehicle: Endpoint::vehicle(vehicle),
            attacker: Some(Attacker::new(ground.start)),
            ground: Endpoint::ground(ground),
            ..Self::new(schedule, seed)
        }
    }

    /// Returns what was sent to the vehicle.
    pub fn injected(&self) -> &Injected {
        &self.injected
    }

    /// Transfers bytes from the vehicle to the ground.
    pub fn down(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = std::mem::take(&mut self.to_ground);
        if let Some(attacker) = self.attacker.as_mut().filter(|_| !bytes.is_empty()) {
            attacker.vehicle_said = bytes.to_vec();
        }
        for &byte in bytes {
            let offered = self.ground.is_handshake_due();
            let message = self.ground.push(byte);
            if !offered && self.ground.is_handshake_due() {
                // The vehicle has offered a session. It gets its answer, and the ground an offer.
                self.to_vehicle.extend(handshake(&mut self.ground));
                self.vehicle.offer();
                let offer = handshake(&mut self.vehicle);
                let faults: Vec<Fault> = self.schedule.faults(self.slot, Direction::Down).collect();
                out.extend(self.carry(&offer, &faults));
            }
            let Some(Ok(message)) = message else {
                continue;
            };
            let message: AnyMessage<T> = message;
            if let Message::Arrival(arrival) = &message {
                self.slot = arrival.plan.slot;
            }
            let faults: Vec<Fault> = self.schedule.faults(self.slot, Direction::Down).collect();
            let frame = frame_by(&mut self.vehicle, &message);
            out.extend(self.carry(&frame, &faults));
        }
        out
    }

    /// Transfers bytes from the ground to the vehicle. It must also be called to fetch late frames.
    pub fn up(&mut self, bytes: &[u8]) -> Vec<u8> {
        let faults: Vec<Fault> = self.schedule.faults(self.slot, Direction::Up).collect();
        let now = self.slot;
        let is_due = |(slot, _): &mut (u32, Vec<u8>)| *slot < now;
        let mut out: Vec<u8> = self
            .late
            .extract_if(.., is_due)
            .flat_map(|(_, frames)| frames)
            .collect();
        let answer = std::mem::take(&mut self.to_vehicle);
        out.extend(self.carry(&answer, &faults));
        for &byte in bytes {
            let message = self.vehicle.push(byte);
            if self.vehicle.is_handshake_due() {
                self.to_ground.extend(handshake(&mut self.vehicle));
            }
            let Some(Ok(message)) = message else {
                continue;
            };
            let frames = self.spoil(message, &faults);
            if faults.contains(&Fault::Late) {
                self.late.push((self.slot, frames));
            } else {
                out.extend(self.carry(&frames, &faults));
            }
        }
        out
    }

    /// Returns a message, and what is inserted before it, as frames.
    fn spoil(&mut self, mut message: AnyMessage<T>, faults: &[Fault]) -> Vec<u8> {
        let mut frames = Vec::new();
        for fault in faults {
            match fault {
                Fault::OtherVersion => {
                    frames.extend(frame_as(PROTOCOL_VERSION.wrapping_add(1), &message));
                    self.injected.other_version += 1;
                }
                Fault::Echo => {
                    let echo: AnyMessage<T> = Message::Status(VehicleStatus::default());
                    frames.extend(frame_by(&mut self.ground, &echo));
                    self.injected.echoes += 1;
                }
                _ => {}
            }
        }
        if let Some(attacker) = &mut self.attacker {
            frames.extend(attacker.frames(&message, faults, &mut self.injected));
        }
        if let Message::ChannelState(state) = &mut message {
            for fault in faults {
                self.spoil_state(state, *fault);
            }
        }
        let copies = if faults.contains(&Fault::Twice) { 2 } else { 1 };
        let too_few = faults.iter().any(|fault| matches!(fault, Fault::TooFew(_)));
        self.injected.too_few += if too_few { copies } else { 0 };
        for _ in 0..copies {
            let frame = frame_by(&mut self.ground, &message);
            if let Some(attacker) = &mut self.attacker {
                attacker.ground_said.clone_from(&frame);
            }
            frames.extend(frame);
        }
        frames
    }

    fn spoil_state(&self, state: &mut ChannelState<T, USERS_MAX, SENSORS_MAX>, fault: Fault) {
        // Each slot has its own generator, so that a repeated answer is damaged in the same way.
        let mut random = Pcg64Mcg::seed_from_u64(self.seed ^ (u64::from(state.slot) << 20));
        let mut each = |gains: &mut [PowerGain<T>], share: f64, value: &dyn Fn(usize) -> f64| {
            for gain in gains {
                let kind = random.random_range(0..4);
                if random.random_bool(share) {
                    *gain = PowerGain(T::of(value(kind)));
                }
            }
        };
        // With a gain above 1, more power would be received than was sent.
        let no_gain = |kind: usize| [f64::NAN, f64::INFINITY, -1e-11, 1.5][kind];
        match fault {
            Fault::OtherSlot(by) => state.slot = state.slot.saturating_add_signed(by.into()),
            Fault::TooFew(Node::User) => drop(state.user_gains.pop()),
            Fault::TooFew(Node::Sensor) => drop(state.sensor_gains.pop()),
            Fault::NoGain(share) => {
                each(&mut state.user_gains, share, &no_gain);
                each(&mut state.sensor_gains, share, &no_gain);
            }
            Fault::SensorsVanish(share) => each(&mut state.sensor_gains, share, &|_| 0.0),
            Fault::UsersVanish(share) => each(&mut state.user_gains, share, &|_| 0.0),
            _ => {}
        }
    }

    /// Applies the faults of the medium to bytes.
    fn carry(&mut self, bytes: &[u8], faults: &[Fault]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        if bytes.is_empty() {
            return bytes;
        }
        let random = &mut self.random;
        for fault in faults {
            match *fault {
                Fault::Lose(rate) => bytes.retain(|_| !random.random_bool(rate)),
                Fault::Flip(rate) => {
                    for byte in &mut bytes {
                        if random.random_bool(rate) {
                            *byte ^= 1 << random.random_range(0..8);
                        }
                    }
                }
                Fault::Insert(rate) | Fault::Repeat(rate) => {
                    let again = matches!(fault, Fault::Repeat(_));
                    let mut more = Vec::with_capacity(bytes.len());
                    for byte in bytes {
                        if random.random_bool(rate) {
                            more.push(match (again, random.random()) {
                                (true, _) => byte,
                                (false, true) => 0,
                                (false, false) => random.random(),
                            });
                        }
                        more.push(byte);
                    }
                    bytes = more;
                }
                Fault::Cut => bytes.truncate(random.random_range(0..bytes.len().max(1))),
                Fault::Silence => bytes.clear(),
                Fault::Flood(length) => {
                    let noise = std::iter::repeat_with(|| random.random_range(1..=u8::MAX));
                    let noise: Vec<u8> = noise.take(length).collect();
                    bytes.splice(0..0, noise);
                }
                _ => {}
            }
        }
        bytes
    }
}

/// Somebody on the radio who records and sends frames, and does not have the key.
#[derive(Debug)]
struct Attacker {
    /// An end of the link with another key, and the nonces of the ground, which can be read on the
    /// radio.
    forger: Endpoint,
    /// The last frames that were sent to the vehicle and by it.
    ground_said: Vec<u8>,
    vehicle_said: Vec<u8>,
}

impl Attacker {
    fn new(start: [u8; 12]) -> Self {
        let key = GroundKey::new([0xbd; 32]);
        let mut forger = Endpoint::ground(Credentials {
            key: key.clone(),
            start,
        });
        let mut accomplice = Endpoint::vehicle(Credentials { key, start });
        // Offer, answer, confirmation.
        let (mut up, mut down) = (Vec::new(), handshake(&mut accomplice));
        for _ in 0..2 {
            push_all(&mut forger, &down);
            up.extend(handshake(&mut forger));
            push_all(&mut accomplice, &up);
            down = handshake(&mut accomplice);
        }
        Self {
            forger,
            ground_said: Vec::new(),
            vehicle_said: Vec::new(),
        }
    }

    /// Returns the frames of these attacks.
    fn frames<T: Scalar>(
        &mut self,
        message: &AnyMessage<T>,
        faults: &[Fault],
        injected: &mut Injected,
    ) -> Vec<u8> {
        let mut frames = Vec::new();
        for fault in faults {
            let (frame, count) = match fault {
                Fault::Forged => (frame_by(&mut self.forger, message), &mut injected.forged),
                Fault::Replayed => (self.ground_said.clone(), &mut injected.replayed),
                Fault::Reflected => (self.vehicle_said.clone(), &mut injected.reflected),
                Fault::Downgraded => {
                    let frame = frame_as(PROTOCOL_VERSION, message);
                    (frame, &mut injected.downgraded)
                }
                _ => continue,
            };
            // Each frame has two delimiters.
            *count += frame.iter().filter(|&&byte| byte == 0).count() as u32 / 2;
            frames.extend(frame);
        }
        frames
    }
}

fn push_all(end: &mut Endpoint, bytes: &[u8]) {
    for &byte in bytes {
        let _ = end.push::<f64, USERS_MAX, SENSORS_MAX>(byte);
    }
}

/// Returns the frame of the handshake that an end has to send, or nothing.
fn handshake(end: &mut Endpoint) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    end.take_handshake(&mut buffer)
        .map_or_else(Vec::new, <[u8]>::to_vec)
}

/// Returns a message as a frame of an end; nothing if it has no session.
fn frame_by<T: Scalar>(end: &mut Endpoint, message: &AnyMessage<T>) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    end.encode(message, &mut buffer)
        .map_or_else(|_| Vec::new(), <[u8]>::to_vec)
}

fn frame_as<T: Scalar>(version: u8, message: &AnyMessage<T>) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    // Every message fits into the buffer: `encode_as` does not compile if one could be too long.
    link::encode_as(version, message, &mut buffer).map_or_else(|_| Vec::new(), <[u8]>::to_vec)
}
