//! Missions whose onboard computer is a board: the microcontroller image at the other end of three
//! serial lines, or its twin in this process, which has the same precision and the same steps.
//!
//! ```text
//!   Ground  <-- ground link -->  board  <-- MAVLink -->  vehicle
//!                                  ^
//!   clock   <-- console -----------+
//! ```
//!
//! In both cases the host provides the time (`firmware_core::console`): a flight in QEMU is
//! reproducible byte for byte, however slow it is, and it equals that of the twin as far as the
//! arithmetic is the same.

mod campaign;
mod image;

use std::{fmt, io, sync::Arc};

use firmware_core::{
    Position,
    autopilot::{Geofence, Phase, guidance::Limits, wire::MAX_FRAME},
    console::{
        BoardComputer, Clock as WhoseClock, Footprint, MissionOrder, PolicyKind,
        in_single_precision,
    },
    link::FRAME_MAX,
    onboard::Stage,
    policy::mlp::Mlp,
    time::Instant,
};

use super::{
    clock::Clock,
    ground::Ground,
    observer::Observer,
    outcome::{FailedFlight, FlightError, outcome_with_record},
    peer::Peer,
    reason,
    settings::{CONNECT_PATIENCE, FlightSettings, autopilot_settings},
    stopwatch::Stopwatch,
};
pub use campaign::{Campaign, SLOTS_EACH, Tally};
pub use image::Image;

use crate::{
    record::{FlightEvent, FlightNotes, FlightRecord, PathSample},
    world::World,
};
use link::NoHeartbeat;
use scenario::Scenario;
use vehicle::Profile;

/// The output of a board in a round.
#[derive(Debug)]
pub struct Round {
    /// The frames for the vehicle.
    mavlink: Vec<Vec<u8>>,
    /// The bytes for the ground.
    ground: Vec<u8>,
    /// The events, in words.
    events: Vec<String>,
    stage: Stage,
    phase: Phase,
    place: Option<(Position<f32>, f32)>,
    broken_off: Option<String>,
    plan_us: f64,
    allocate_us: f64,
}

/// An onboard computer that receives the time from the host.
pub trait Board: fmt::Debug {
    /// Takes the bytes that were received from both sides, advances, and returns the output.
    ///
    /// # Errors
    /// Returns an error if the board does not answer.
    fn round(&mut self, now: Instant, vehicle: &[Vec<u8>], ground: &[u8]) -> io::Result<Round>;

    /// Asks the board to end the mission.
    ///
    /// # Errors
    /// Returns an error if the board does not answer.
    fn stop(&mut self) -> io::Result<()>;

    /// Returns the memory usage, if the board can report it.
    ///
    /// # Errors
    /// Returns an error if the board does not answer.
    fn footprint(&mut self) -> io::Result<Option<Footprint>>;
}

/// Returns the order of a mission for a board.
pub fn order(scenario: &Scenario, profile: Profile, policy_kind: PolicyKind) -> MissionOrder {
    let flight = autopilot_settings(scenario, profile);
    let number = |x: f64| x as f32;
    MissionOrder {
        mission: in_single_precision(scenario.mission.parameters()),
        map_origin: scenario.map_origin(),
        limits: Limits {
            speed_mps: number(flight.limits.speed_mps),
            acceleration_mps2: number(flight.limits.acceleration_mps2),
            jerk_mps3: number(flight.limits.jerk_mps3),
        },
        geofence: flight.geofence.map(|fence| Geofence {
            low: fence.low.map(number),
            high: fence.high.map(number),
            ceiling_m: number(fence.ceiling_m),
        }),
        ground_patience: flight.watch.ground,
        policy_kind,
        clock: WhoseClock::Console,
    }
}

/// The computer of a board, in this process.
#[derive(Debug)]
pub struct Twin {
    computer: Box<BoardComputer<Arc<[u8]>>>,
    stop_asked: bool,
    broken_off: bool,
}

impl Twin {
    /// Creates a twin that behaves like the image with this policy in its flash memory.
    ///
    /// # Errors
    /// Returns the reason if the order is refused, in words.
    pub fn new(order: &MissionOrder, policy: Option<Arc<[u8]>>) -> Result<Self, String> {
        let trained = policy.map(Mlp::load).transpose();
        let trained = trained.map_err(|error| error.to_string())?;
        let computer = order.build(trained.as_ref());
        let mut computer = computer.map_err(|refusal| refusal.to_string())?;
        computer.autopilot_mut().launch(Instant::ZERO);
        Ok(Self {
            computer: Box::new(computer),
            stop_asked: false,
            broken_off: false,
        })
    }
}

impl Board for Twin {
    fn round(&mut self, now: Instant, vehicle: &[Vec<u8>], ground: &[u8]) -> io::Result<Round> {
        let computer = &mut *self.computer;
        computer.receive_ground(now, ground);
        for frame in vehicle {
            computer.receive_mavlink(now, frame, false);
        }
        if std::mem::take(&mut self.stop_asked) {
            computer.autopilot_mut().stop(now);
        }
        let mut stopwatch = Stopwatch::default();
        computer.poll(now, &mut stopwatch);
        let mut mavlink = Vec::new();
        let mut frame = [0; MAX_FRAME];
        while let Some(frame) = computer.take_mavlink_frame(now, &mut frame) {
            mavlink.push(frame.to_vec());
        }
        let mut ground = Vec::new();
        let mut frame = [0; FRAME_MAX];
        while let Some(frame) = computer.take_ground_frame(&mut frame) {
            ground.extend_from_slice(frame);
        }
        let mut events = Vec::new();
        while let Some(event) = computer.autopilot_mut().take_next_event() {
            events.push(event.to_string());
        }
        let broken_off = (computer.stage() == Stage::Aborted && !self.broken_off).then(|| {
            let client = computer.autopilot();
            let cause = client.fault().map(|cause| cause.to_string());
            let refusal = client.refusal().map(|refusal| refusal.to_string());
            reason::first(computer.fault(), refusal.or(cause))
                .unwrap_or_else(|| client.phase().to_string())
        });
        self.broken_off |= broken_off.is_some();
        let place = computer.autopilot().position();
        Ok(Round {
            mavlink,
            ground,
            events,
            stage: computer.stage(),
            phase: computer.autopilot().phase(),
            place: place.map(|sample| (sample.position, sample.altitude_m)),
            broken_off,
            plan_us: stopwatch.plan_us.iter().sum(),
            allocate_us: stopwatch.allocate_us.iter().sum(),
        })
    }

    fn stop(&mut self) -> io::Result<()> {
        self.stop_asked = true;
        Ok(())
    }

    fn footprint(&mut self) -> io::Result<Option<Footprint>> {
        Ok(None)
    }
}

/// Flies `scenario` with `board` and the vehicle at the other end of `peer`. The `inner` and
/// `policy` of the settings are names for the record: the board decides.
///
/// # Errors
/// Returns an error if the board does not answer, a link fails, or the mission was aborted.
pub fn fly(
    scenario: &Scenario,
    board: &mut impl Board,
    settings: &FlightSettings,
    mut peer: Peer,
    observer: &mut impl Observer,
) -> Result<FlightRecord, FailedFlight> {
    let world = World::new(scenario, settings.seed, settings.symbols_per_slot);
    let mut flight = BoardFlight {
        board,
        ground: Ground::new(world, settings.inner.method(&scenario.mission)),
        clock: Clock::new(settings.pace),
        stopwatch: Stopwatch::default(),
        uplink: Vec::new(),
        events: Vec::new(),
        path: Vec::new(),
        started: None,
        slots: scenario.mission.slots(),
        broken_off: None,
        connected: false,
    };
    let outcome = flight.run(&mut peer, observer);
    peer.finish(observer);
    let connected = flight.connected;
    let record = FlightRecord {
        scenario: scenario.clone(),
        policy: settings.policy.clone(),
        inner: settings.inner.to_string(),
        profile: settings.profile.name().into(),
        seed: settings.seed,
        link: flight.ground.link(),
        slots: flight.ground.into_slots(),
        path: flight.path,
        events: flight.events,
        completed: false,
        ended: String::new(),
        notes: FlightNotes::default(),
    };
    outcome_with_record(outcome, connected, record)
}

/// A mission in progress.
struct BoardFlight<'b, B> {
    board: &'b mut B,
    ground: Ground,
    clock: Clock,
    stopwatch: Stopwatch,
    /// The bytes for the board's next round.
    uplink: Vec<u8>,
    events: Vec<FlightEvent>,
    path: Vec<PathSample>,
    started: Option<Instant>,
    slots: u32,
    broken_off: Option<String>,
    /// The board has received messages of a vehicle.
    connected: bool,
}

impl<B: Board> BoardFlight<'_, B> {
    fn run(&mut self, peer: &mut Peer, observer: &mut impl Observer) -> Result<(), FlightError> {
        let mut stop_asked = false;
        loop {
            let now = self.clock.now();
            peer.step(now)?;
            let round = self.exchange(now, peer, observer)?;
            self.note_path(now, peer, &round);
            self.connected |= !matches!(round.phase, Phase::Connecting | Phase::Failed);
            if round.phase.is_final() {
                return self.verdict(&round);
            }
            let waited = now.duration_since(Instant::ZERO);
            if round.phase == Phase::Connecting && waited > CONNECT_PATIENCE {
                return Err(FlightError::NobodyThere(NoHeartbeat {
                    waited_s: waited.as_secs_f64(),
                    refused: 0,
                    last_error: peer.last_error(),
                }));
            }
            if !stop_asked && observer.wants_stop() {
                stop_asked = true;
                self.board.stop()?;
                if self.connected {
                    observer.waiting(
                        "ctrl-C: landing; waiting for the motors to stop (a second ctrl-C ends at \
                         once)",
                    );
                }
            }
            if observer.wants_end() {
                return Err(FlightError::Ended {
                    slots_done: self.ground.slots().len(),
                    slots: self.slots,
                    state: round.phase.to_string(),
                });
            }
            self.clock.advance(peer)?;
        }
    }

    /// Carries frames in both directions until no more are pending; returns the last round.
    fn exchange(
        &mut self,
        now: Instant,
        peer: &mut Peer,
        observer: &mut impl Observer,
    ) -> Result<Round, FlightError> {
        loop {
            let mut from_vehicle = Vec::new();
            while let Some(frame) = peer.receive(now)? {
                from_vehicle.push(frame);
            }
            let uplink = std::mem::take(&mut self.uplink);
            let round = self.board.round(now, &from_vehicle, &uplink)?;
            self.stopwatch.add(round.plan_us, round.allocate_us);
            for frame in &round.mavlink {
                peer.send(now, frame)?;
            }
            let done = self.ground.slots().len();
            self.uplink = self
                .ground
                .receive_single(&round.ground, |time| peer.true_position_at(time));
            for slot in self.ground.slots_mut().iter_mut().skip(done) {
                self.stopwatch.note(slot);
                observer.slot(slot);
            }
            for text in &round.events {
                let event = FlightEvent {
                    time_s: now.duration_since(Instant::ZERO).as_secs_f64(),
                    text: text.clone(),
                    notable: reason::are_notable(text),
                };
                observer.event(&event);
                self.events.push(event);
            }
            if let Some(why) = &round.broken_off {
                self.broken_off = Some(why.clone());
            }
            let said = !(round.mavlink.is_empty() && round.ground.is_empty());
            if !said && from_vehicle.is_empty() && uplink.is_empty() {
                return Ok(round);
            }
        }
    }

    fn note_path(&mut self, now: Instant, peer: &Peer, round: &Round) {
        if !matches!(round.stage, Stage::Flying | Stage::Measuring) {
            return;
        }
        let started = *self.started.get_or_insert(now);
        let truth = peer
            .true_position()
            .map(|place| (place, peer.altitude_m().unwrap_or_default()));
        let measured = round
            .place
            .map(|(place, altitude_m)| (place.map(f64::from), f64::from(altitude_m)));
        if let Some((position, altitude_m)) = truth.or(measured) {
            self.path.push(PathSample {
                time_s: now.duration_since(started).as_secs_f64(),
                position,
                altitude_m,
            });
        }
    }

    fn verdict(&self, round: &Round) -> Result<(), FlightError> {
        if round.stage == Stage::Completed {
            return Ok(());
        }
        Err(FlightError::BrokenOff {
            slots_done: self.ground.slots().len(),
            slots: self.slots,
            reason: self
                .broken_off
                .clone()
                .unwrap_or_else(|| round.phase.to_string()),
        })
    }
}
