//! Flies a mission: world, ground link, onboard computer, MAVLink and vehicle in one loop.
//!
//! ```text
//!   World <- Ground  <-- postcard frames -->  Onboard  <-- MAVLink 2 frames -->  vehicle
//! ```
//!
//! Both links carry encoded bytes even when both ends live in this process. With the built-in
//! vehicle time is simulated, in steps of 10 ms, as fast as it computes or at a pace; with any
//! other it is the clock's.

mod airframe;
pub mod board;
mod clock;
mod ground;
mod peer;
mod precision;

use std::time::Instant as WallInstant;

use firmware_core::{
    Displacement, Position, SENSORS_MAX, USERS_MAX,
    autopilot::{
        self, Autopilot, Event, Finding, Geofence, Phase, SettingsError,
        failsafe::{Cause, Watch},
        frames::Geodetic,
        preflight::Preflight,
        wire::{
            MAX_FRAME,
            signing::{Signer, Verifier},
        },
    },
    controller::Controller,
    link::FRAME_MAX,
    onboard::{Activity, Fault, Onboard, Probe, Settings, Stage},
    policy::Policy,
    time::{Duration, Instant},
};
use thiserror::Error;

use crate::{
    allocation::Allocation,
    link::Silence,
    record::{FlightEvent, FlightRecord, PathSample, SlotRecord},
    scenario::Scenario,
    vehicle::{Profile, VehicleSettings},
    world::World,
};

pub use airframe::{ProfileChoice, WrongProfile};
use clock::Clock;
pub use clock::Pace;
use ground::Ground;
pub use peer::Peer;

/// How long an autopilot's first heartbeat is waited for.
pub const CONNECT_PATIENCE: Duration = Duration::from_secs(30);

/// How long after a flight parameters may take to be put back.
const RESTORE_PATIENCE: Duration = Duration::from_secs(30);

/// The ground is heard once a slot; after so many without it, and at least
/// [`GROUND_PATIENCE`], the vehicle is landed.
const GROUND_SLOTS: u32 = 10;

/// The shortest silence of the ground that counts.
const GROUND_PATIENCE: Duration = Duration::from_secs(10);

/// Which of our links signs frames.
const SIGNING_LINK: u8 = 1;

/// How far around the mission's area the geofence lies: a vehicle that far outside is landed.
const FENCE_MARGIN_M: f64 = 50.0;

/// How a mission is flown.
#[derive(Clone, Debug)]
pub struct FlightSettings {
    /// The policy's name, for the record.
    pub policy: String,
    /// How the powers of a slot are chosen.
    pub inner: Allocation,
    /// Which vehicle is at the other end: sets the limits that the guidance plans with.
    pub profile: Profile,
    /// How fast time passes.
    pub pace: Pace,
    /// Of the signals.
    pub seed: u64,
    /// Symbols drawn in a slot for the empirical MSE.
    pub symbols_per_slot: u32,
}

/// What happens while a mission is flown, for whoever shows it.
pub trait Observer {
    /// A slot is done.
    fn slot(&mut self, slot: &SlotRecord) {
        let _ = slot;
    }
    /// Something happened between the autopilot and its client.
    fn event(&mut self, event: &FlightEvent) {
        let _ = event;
    }
    /// Something that a person must do, now that the flight is over.
    fn duty(&mut self, words: &str) {
        let _ = words;
    }
    /// Something that is good to know, now that the flight is over.
    fn note(&mut self, words: &str) {
        let _ = words;
    }
    /// Whether to stop: the vehicle is then landed.
    fn wants_stop(&self) -> bool {
        false
    }
}

/// Watches nothing.
impl Observer for () {}

/// Why a mission was not flown to its end.
#[derive(Debug, Error)]
pub enum FlightError {
    /// The client's settings do not fit the mission.
    #[error("the mission cannot be flown: {0}")]
    Settings(#[from] SettingsError),
    /// The link failed.
    #[error("link: {0}")]
    Link(#[from] std::io::Error),
    /// The profile that was given is for another autopilot.
    #[error("{0}")]
    WrongProfile(#[from] WrongProfile),
    /// No autopilot at the other end.
    #[error("{0}")]
    NobodyThere(Silence),
    /// The mission was broken off.
    #[error("broken off after {slots_done} of {slots} slots: {reason}")]
    BrokenOff {
        /// Slots that were done.
        slots_done: usize,
        /// `N`.
        slots: u32,
        /// What went wrong, in words.
        reason: String,
    },
}

/// A flight that did not reach its end still leaves a record of what it did.
#[derive(Debug, Error)]
#[error("{error}")]
pub struct FailedFlight {
    /// Why.
    pub error: FlightError,
    /// What was flown of it.
    pub record: Option<Box<FlightRecord>>,
}

type HostOnboard<P> = Onboard<f64, P, USERS_MAX, SENSORS_MAX>;

/// Flies `scenario` under `policy` with the vehicle at the other end of `peer`.
///
/// # Errors
/// Settings that do not fit, a link that fails, a mission that was broken off.
pub fn fly<P: Policy<f64, USERS_MAX>>(
    scenario: &Scenario,
    policy: P,
    settings: &FlightSettings,
    mut peer: Peer,
    observer: &mut impl Observer,
) -> Result<FlightRecord, FailedFlight> {
    let mut flight =
        Flight::new(scenario, policy, settings, &peer).map_err(|error| FailedFlight {
            error,
            record: None,
        })?;
    let outcome = flight
        .run(&mut peer, observer)
        .and_then(|()| Ok(peer.finish()?));
    for words in peer.unreached() {
        observer.note(&words);
    }
    let record = flight.record(scenario, settings);
    match outcome {
        Ok(()) => Ok(record),
        Err(error) => Err(FailedFlight {
            error,
            record: Some(Box::new(record)),
        }),
    }
}

/// The client's settings for a mission.
pub fn autopilot_settings(scenario: &Scenario, profile: Profile) -> autopilot::Settings<f64> {
    let p = scenario.mission.parameters();
    let mut limits = profile.client_limits();
    if profile != Profile::Ideal {
        // The mission's own speed limit (eq:traj1) holds between way-points, too.
        limits.speed_mps = limits.speed_mps.min(p.max_speed_mps);
    }
    let around = Displacement::new(FENCE_MARGIN_M, FENCE_MARGIN_M);
    let fence = Geofence {
        low: Position::origin() - around,
        high: Position::new(p.area.east_m, p.area.north_m) + around,
        ceiling_m: p.altitude_m + FENCE_MARGIN_M,
    };
    let slot = Duration::from_secs_f64(p.slot_duration_s);
    autopilot::Settings {
        limits,
        geofence: Some(fence),
        preflight: Preflight::of(p),
        watch: Watch {
            ground: Some((slot * GROUND_SLOTS).max(GROUND_PATIENCE)),
            ..Watch::default()
        },
        ..autopilot::Settings::new(map_origin(scenario), p.start, p.altitude_m, p.max_speed_mps)
    }
}

/// The built-in vehicle for a mission: on the ground at its start.
pub fn vehicle_settings(scenario: &Scenario, profile: Profile) -> VehicleSettings {
    let start = scenario.mission.parameters().start;
    VehicleSettings {
        elevation_m: scenario.origin.elevation_m,
        ..VehicleSettings::new(profile, map_origin(scenario), start)
    }
}

/// Where the map's origin lies on Earth.
pub fn map_origin(scenario: &Scenario) -> Geodetic {
    // A scenario's origin has been checked to lie on Earth.
    Geodetic::from_degrees(scenario.origin.latitude_deg, scenario.origin.longitude_deg).unwrap_or(
        Geodetic {
            latitude_e7: 0,
            longitude_e7: 0,
        },
    )
}

/// A mission under way.
struct Flight<P> {
    onboard: HostOnboard<P>,
    ground: Ground,
    clock: Clock,
    stopwatch: Stopwatch,
    events: Vec<FlightEvent>,
    path: Vec<PathSample>,
    profile: Profile,
    profile_choice: ProfileChoice,
    /// When slot 1 began.
    started: Option<Instant>,
    /// When the flight was over.
    ended: Option<Instant>,
}

impl<P: Policy<f64, USERS_MAX>> Flight<P> {
    fn new(
        scenario: &Scenario,
        policy: P,
        settings: &FlightSettings,
        peer: &Peer,
    ) -> Result<Self, FlightError> {
        let method = settings.inner.method(&scenario.mission);
        let controller = Controller::new(scenario.mission.clone(), policy).with_method(method);
        let autopilot = Autopilot::new(autopilot::Settings {
            set_parameters: peer.sets_parameters(),
            own: peer.own(),
            ..autopilot_settings(scenario, settings.profile)
        })?;
        let mut onboard = Onboard::new(Settings::default(), controller, autopilot);
        if let Some(key) = peer.key() {
            let unix_us = peer.unix_us(Instant::ZERO);
            let signer = Signer::new(key.clone(), SIGNING_LINK, unix_us);
            onboard.sign_with(signer, Verifier::new(key.clone(), unix_us));
        }
        let world = World::new(scenario, settings.seed, settings.symbols_per_slot);
        Ok(Self {
            onboard,
            ground: Ground::new(world, method),
            clock: Clock::new(settings.pace),
            stopwatch: Stopwatch::default(),
            events: Vec::new(),
            path: Vec::new(),
            profile: settings.profile,
            profile_choice: ProfileChoice::new(
                scenario,
                (!peer.names_profile()).then_some(settings.profile),
            ),
            started: None,
            ended: None,
        })
    }

    /// Until the vehicle has landed or can no longer be flown.
    fn run(&mut self, peer: &mut Peer, observer: &mut impl Observer) -> Result<(), FlightError> {
        let mut stop_asked = false;
        self.onboard.autopilot_mut().launch(self.clock.now());
        loop {
            let now = self.clock.now();
            peer.step(now)?;
            self.onboard.set_signing_time(peer.unix_us(now));
            self.exchange(now, peer, observer)?;
            if let Some(profile) = self.profile_choice.settle(self.onboard.autopilot_mut())? {
                self.profile = profile;
            }
            self.note_path(now, peer);
            self.note_events(now, observer);
            if self.onboard.autopilot().phase().is_final() && self.is_tidy(now, observer) {
                return self.verdict();
            }
            let waited = now.since(Instant::ZERO);
            if self.onboard.autopilot().phase() == Phase::Connecting && waited > CONNECT_PATIENCE {
                return Err(FlightError::NobodyThere(Silence {
                    waited_s: waited.as_secs_f64(),
                    refused: self.onboard.status().mavlink.refused(),
                    trouble: peer.trouble(),
                }));
            }
            if !stop_asked && observer.wants_stop() {
                stop_asked = true;
                self.onboard.autopilot_mut().stop(now);
            }
            self.clock.advance(peer)?;
        }
    }

    /// Parameters that were set are put back, or it has taken too long and was said.
    fn is_tidy(&mut self, now: Instant, observer: &mut impl Observer) -> bool {
        let ended = *self.ended.get_or_insert(now);
        if self.onboard.autopilot().is_restored() {
            return true;
        }
        if now.since(ended) > RESTORE_PATIENCE {
            self.onboard.autopilot_mut().abandon_parameters();
            self.note_events(now, observer);
            return true;
        }
        false
    }

    /// Carries frames both ways until all is said.
    fn exchange(
        &mut self,
        now: Instant,
        peer: &mut Peer,
        observer: &mut impl Observer,
    ) -> Result<(), FlightError> {
        let mut mavlink = [0; MAX_FRAME];
        let mut downlink = [0; FRAME_MAX];
        loop {
            let mut quiet = true;
            while let Some(datagram) = peer.receive(now)? {
                quiet = false;
                self.onboard.receive_mavlink(now, &datagram, true);
            }
            self.onboard.poll(now, &mut self.stopwatch);
            while let Some(frame) = self.onboard.take_mavlink_frame(now, &mut mavlink) {
                quiet = false;
                peer.send(now, frame)?;
            }
            while let Some(frame) = self.onboard.take_ground_frame(&mut downlink) {
                quiet = false;
                let done = self.ground.slots().len();
                let uplink = self.ground.receive(frame, peer.true_position());
                self.onboard.receive_ground(now, &uplink);
                for slot in self.ground.slots_mut().iter_mut().skip(done) {
                    self.stopwatch.note(slot);
                    observer.slot(slot);
                }
            }
            if quiet {
                return Ok(());
            }
        }
    }

    /// The vehicle's path from the start of slot 1 to the end of slot N.
    fn note_path(&mut self, now: Instant, peer: &Peer) {
        if !matches!(self.onboard.stage(), Stage::Flying | Stage::Measuring) {
            return;
        }
        let started = *self.started.get_or_insert(now);
        let measured = self.onboard.autopilot().position();
        let place = peer
            .true_position()
            .map(|position| (position, peer.altitude_m()));
        let measured = measured.map(|sample| (sample.position, Some(sample.altitude_m)));
        if let Some((position, altitude_m)) = place.or(measured) {
            self.path.push(PathSample {
                time_s: now.since(started).as_secs_f64(),
                position,
                altitude_m: altitude_m.unwrap_or_default(),
            });
        }
    }

    fn note_events(&mut self, now: Instant, observer: &mut impl Observer) {
        while let Some(event) = self.onboard.autopilot_mut().take_next_event() {
            if let Event::Finding(left @ Finding::NotRestored { .. }) = &event {
                observer.duty(&left.to_string());
            }
            let event = FlightEvent {
                time_s: now.since(Instant::ZERO).as_secs_f64(),
                text: event.to_string(),
            };
            observer.event(&event);
            self.events.push(event);
        }
    }

    fn verdict(&self) -> Result<(), FlightError> {
        if self.onboard.stage() == Stage::Completed {
            return Ok(());
        }
        let autopilot = self.onboard.autopilot();
        let fault = self.onboard.fault().map(|fault: Fault| fault.to_string());
        let refusal = autopilot.refusal().map(|refusal| refusal.to_string());
        let cause = autopilot
            .fault()
            .map(|cause| match (cause, autopilot.obstacle()) {
                (Cause::StageTimedOut, Some(obstacle)) => format!("{cause}: {obstacle}"),
                _ => cause.to_string(),
            });
        Err(FlightError::BrokenOff {
            slots_done: self.ground.slots().len(),
            slots: self.onboard.controller().mission().slots(),
            reason: fault
                .or(refusal)
                .or(cause)
                .unwrap_or_else(|| autopilot.phase().to_string()),
        })
    }

    fn record(self, scenario: &Scenario, settings: &FlightSettings) -> FlightRecord {
        FlightRecord {
            scenario: scenario.clone(),
            policy: settings.policy.clone(),
            inner: settings.inner.to_string(),
            profile: self.profile.name().into(),
            seed: settings.seed,
            link: self.ground.link(),
            slots: self.ground.into_slots(),
            path: self.path,
            events: self.events,
        }
    }
}

/// Measures the two computations of each slot.
#[derive(Debug, Default)]
struct Stopwatch {
    begun: Option<WallInstant>,
    plan_us: Vec<f64>,
    allocate_us: Vec<f64>,
}

impl Stopwatch {
    /// Takes times that were measured elsewhere; 0 where nothing was computed.
    fn add(&mut self, plan_us: f64, allocate_us: f64) {
        self.plan_us.extend((plan_us > 0.0).then_some(plan_us));
        self.allocate_us
            .extend((allocate_us > 0.0).then_some(allocate_us));
    }

    /// Writes a slot's two times into its record.
    fn note(&self, slot: &mut SlotRecord) {
        let index = slot.slot as usize - 1;
        slot.plan_us = self.plan_us.get(index).copied().unwrap_or_default();
        slot.allocate_us = self.allocate_us.get(index).copied().unwrap_or_default();
    }
}

impl Probe for Stopwatch {
    fn begin(&mut self, _: Activity) {
        self.begun = Some(WallInstant::now());
    }

    fn end(&mut self, activity: Activity) {
        let Some(begun) = self.begun.take() else {
            return;
        };
        let micros = begun.elapsed().as_secs_f64() * 1e6;
        match activity {
            Activity::Plan => self.plan_us.push(micros),
            Activity::Allocate => self.allocate_us.push(micros),
        }
    }
}
