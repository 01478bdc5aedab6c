//! Fault injection for the ground link: bytes that are lost, flipped, inserted or repeated, cut
//! frames, silence and floods; frames of another protocol version; states about another slot, with
//! too few gains, or too late; gains that are invalid, and sensors and users that are not received.
//!
//! A [`FaultyLink`] is placed between the two ends: bytes go in and bytes come out, in both
//! directions. It therefore works with an onboard computer in the same process and with one at the
//! end of a socket. A [`Schedule`] defines which faults occur in which slots. The same seed gives
//! the same damage. ([`lossy`](super::lossy) does the same for frames and time on the MAVLink
//! side.)

use firmware_core::{
    PowerGain, SENSORS_MAX, Scalar, USERS_MAX,
    controller::ChannelState,
    link::{self, Decoder, FRAME_MAX, Message, PROTOCOL_VERSION, VehicleStatus},
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
            6 => Self::Flood(random.random_range(1..4 * FRAME_MAX)),
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
}

/// A ground link with faults. `T` is the precision that both ends use.
#[derive(Debug)]
pub struct FaultyLink<T: Scalar> {
    schedule: Schedule,
    seed: u64,
    random: Pcg64Mcg,
    /// The slot whose arrival the vehicle last reported.
    slot: u32,
    from_vehicle: Decoder,
    from_ground: Decoder,
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
            from_vehicle: Decoder::new(),
            from_ground: Decoder::new(),
            late: Vec::new(),
            injected: Injected::default(),
            precision: core::marker::PhantomData,
        }
    }

    /// Returns what was sent to the vehicle.
    pub fn injected(&self) -> &Injected {
        &self.injected
    }

    /// Transfers bytes from the vehicle to the ground.
    pub fn down(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for &byte in bytes {
            let Some(Ok(message)) = self.from_vehicle.push(byte) else {
                continue;
            };
            let message: AnyMessage<T> = message;
            if let Message::Arrival(arrival) = &message {
                self.slot = arrival.plan.slot;
            }
            let faults: Vec<Fault> = self.schedule.faults(self.slot, Direction::Down).collect();
            out.extend(self.carry(&frame(&message), &faults));
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
        for &byte in bytes {
            let Some(Ok(message)) = self.from_ground.push(byte) else {
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
                    frames.extend(frame(&echo));
                    self.injected.echoes += 1;
                }
                _ => {}
            }
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
            frames.extend(frame(&message));
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

fn frame<T: Scalar>(message: &AnyMessage<T>) -> Vec<u8> {
    frame_as(PROTOCOL_VERSION, message)
}

fn frame_as<T: Scalar>(version: u8, message: &AnyMessage<T>) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    // Every message fits into the buffer: `encode_as` does not compile if one could be too long.
    link::encode_as(version, message, &mut buffer).map_or_else(|_| Vec::new(), <[u8]>::to_vec)
}
