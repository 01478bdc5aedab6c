//! The built-in vehicle: a MAVLink 2 endpoint around a simulated body, without I/O.
//!
//! It takes bytes and the time and gives bytes, like the client it is flown by; whether they
//! travel through a function call, a lossy link or a socket is not its business. In simulated
//! time it is deterministic. Its clock need not run as fast as the caller's: all of its time is
//! [`VehicleSettings::clock_rate`] of the time that it is given.
//!
//! ```text
//! receive(now, bytes) ─ endpoint ─ mode, arming, setpoint ─ body ─ telemetry ─ next_frame()
//! ```

mod body;
mod conduct;
mod endpoint;
mod missions;
mod parameters;
mod profile;
mod serve;
mod telemetry;
mod timing;
mod wind;

use std::collections::VecDeque;

use firmware_core::Position;
use firmware_core::autopilot::frames::Geodetic;
use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::wire::signing::{Signer, SigningKey, Verifier};
use firmware_core::autopilot::wire::{Address, Decoder, Encoder, MAX_FRAME};
use firmware_core::time::{Duration, Instant};
use mavlink::dialects::common::MavMessage;
use nalgebra::Vector2;

pub use body::Ability;
pub use profile::{Airframe, Profile};
pub use serve::serve;
pub use timing::{Pauses, Sampling};

use body::{Body, Target};
use missions::Missions;
use parameters::Parameters;
use telemetry::Streams;
use timing::{StallingClock, Timing};
use wind::Wind;

/// What a vehicle is made with.
#[derive(Clone, Debug)]
pub struct VehicleSettings {
    /// Which vehicle.
    pub profile: Profile,
    /// Where the map's origin lies on Earth.
    pub map_origin: Geodetic,
    /// Height of the map above mean sea level, m.
    pub elevation_m: f64,
    /// Where it stands at first, on the map, m.
    pub start: Position<f64>,
    /// What its body can do.
    pub ability: Ability,
    /// Its MAVLink system id.
    pub system: u8,
    /// Until its estimator has an absolute position.
    pub ready_after: Duration,
    /// How fast its clock runs, in seconds per second of the caller's time. PX4's simulator keeps
    /// 0.99 of real time.
    pub clock_rate: f64,
    /// How regularly its samples are taken and delivered.
    pub sampling: Sampling,
    /// How often nothing comes from it for a moment.
    pub hiccups: Pauses,
    /// How often its clock stands still: a simulator on a computer that is busy.
    pub stalls: Pauses,
    /// Steady wind from the west, m/s, with gusts.
    pub wind_mps: f64,
    /// Ids of messages whose interval it does not let anybody set.
    pub refused_intervals: Vec<u32>,
    /// Of jitter, hiccups, stalls and gusts.
    pub seed: u64,
    /// From this time of its own on it sends and takes nothing any more: death without a word.
    pub die_after: Option<Duration>,
    /// Parameters that differ from the profile's defaults: name and value.
    pub parameters: Vec<(String, f32)>,
    /// Signs and requires signatures: the key, and the time at first, microseconds since 1970;
    /// [`Vehicle::set_signing_time`] moves it on.
    pub signing: Option<(SigningKey, u64)>,
}

impl VehicleSettings {
    /// A vehicle of this profile on the ground at `start`.
    pub fn new(profile: Profile, map_origin: Geodetic, start: Position<f64>) -> Self {
        Self {
            profile,
            map_origin,
            elevation_m: 0.0,
            start,
            ability: profile.ability(),
            system: 1,
            ready_after: profile.ready_after(),
            clock_rate: profile.clock_rate(),
            sampling: profile.sampling(),
            hiccups: profile.hiccups(),
            stalls: Pauses::default(),
            refused_intervals: profile.refused_intervals(),
            wind_mps: 0.0,
            seed: 1,
            die_after: None,
            parameters: Vec::new(),
            signing: None,
        }
    }
}

/// Things that go wrong on purpose, for tests.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// Heartbeats stop.
    pub no_heartbeat: bool,
    /// Position messages stop.
    pub no_position: bool,
    /// Positions are reported wrong by so much, m.
    pub position_offset_m: Vector2<f64>,
    /// Setpoints are taken and not flown.
    pub ignore_setpoints: bool,
    /// Its heartbeats say that the motors stand still.
    pub disarmed: bool,
    /// The battery's voltage falls below the autopilot's own threshold.
    pub battery_low: bool,
    /// What the battery shows, percent; `None` for full.
    pub battery_percent: Option<i8>,
}

/// What the vehicle is doing. Numbers for the wire come from its [`Firmware`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlightMode {
    /// A person flies by hand; without one it hovers.
    Manual,
    /// Stays where it is.
    Loiter,
    /// Follows setpoints: GUIDED, OFFBOARD.
    Guided,
    /// Flies its mission.
    Auto,
    /// Returns to where it took off.
    Return,
    /// Lands.
    Land,
}

/// A setpoint and when it came.
#[derive(Clone, Copy, Debug)]
struct Setpoint {
    came: Instant,
    target: Target,
}

/// One step of the body.
const STEP: Duration = Duration::from_millis(10);
/// Frames that nobody fetched; older ones go.
const OUTBOX: usize = 4096;

/// The vehicle.
#[derive(Debug)]
pub struct Vehicle {
    settings: VehicleSettings,
    firmware: Firmware,
    decoder: Decoder,
    encoder: Encoder,
    /// Frames and when they leave.
    outbox: VecDeque<(Instant, Vec<u8>)>,
    timing: Timing,
    stalling: StallingClock,
    /// The vehicle's time up to which the body has moved, and the latest.
    time: Instant,
    clock: Instant,
    wind: Wind,
    body: Body,
    home: Position<f64>,
    mode: FlightMode,
    armed: bool,
    armed_at: Instant,
    /// A take-off under way, to this altitude.
    take_off_to: Option<f64>,
    hold_altitude_m: f64,
    setpoint: Option<Setpoint>,
    /// The one before it, which is flown until the latest has its effect.
    previous: Option<Setpoint>,
    /// Since when setpoints have flowed without a gap.
    stream_since: Option<Instant>,
    landed_since: Option<Instant>,
    /// The last heartbeat of the ground station that counts for the failsafe.
    ground_heard: Option<Instant>,
    /// ArduCopter: a number that is not one reached the position controller.
    crashed: bool,
    /// PX4: left OFFBOARD because setpoints stopped.
    sinks: bool,
    missions: Missions,
    parameters: Parameters,
    streams: Streams,
    /// Set from outside to make things go wrong.
    pub faults: Faults,
}

impl Vehicle {
    /// A vehicle on the ground.
    pub fn new(settings: VehicleSettings) -> Self {
        let firmware = settings.profile.firmware();
        let address = Address {
            system: settings.system,
            component: 1,
        };
        let mut parameters = Parameters::of(settings.profile);
        for (name, value) in &settings.parameters {
            parameters.set(name, *value);
        }
        let (mut decoder, mut encoder) = (Decoder::new(), Encoder::new(address));
        if let Some((key, epoch_us)) = &settings.signing {
            encoder.sign_with(Signer::new(key.clone(), 0, *epoch_us));
            decoder.require_signatures(Verifier::new(key.clone(), *epoch_us));
        }
        Self {
            firmware,
            decoder,
            encoder,
            outbox: VecDeque::new(),
            timing: Timing::new(settings.sampling, settings.hiccups, settings.seed),
            stalling: StallingClock::new(settings.stalls, settings.seed),
            time: Instant::ZERO,
            clock: Instant::ZERO,
            wind: Wind::new(settings.wind_mps, settings.seed),
            body: Body::on_ground(settings.start, settings.profile),
            home: settings.start,
            mode: FlightMode::Manual,
            armed: false,
            armed_at: Instant::ZERO,
            take_off_to: None,
            hold_altitude_m: 0.0,
            setpoint: None,
            previous: None,
            stream_since: None,
            landed_since: None,
            ground_heard: None,
            crashed: false,
            sinks: false,
            missions: Missions::default(),
            parameters,
            streams: Streams::of(settings.profile),
            faults: Faults::default(),
            settings,
        }
    }

    /// Its clock: the time that its messages are stamped with.
    pub fn boot_time(&self) -> Instant {
        self.time
    }

    /// Whether it follows the paper's kinematics: it is where its last setpoint says.
    pub fn is_ideal(&self) -> bool {
        self.settings.profile == Profile::Ideal
    }

    /// Where it really is, on the map, m.
    pub fn true_position(&self) -> Position<f64> {
        self.body.position
    }

    /// Its real velocity, m/s.
    pub fn velocity(&self) -> Vector2<f64> {
        self.body.velocity
    }

    /// Its real height above the ground, m.
    pub fn altitude_m(&self) -> f64 {
        self.body.altitude_m
    }

    /// Whether its motors may turn.
    pub fn armed(&self) -> bool {
        self.armed
    }

    /// What it is doing.
    pub fn mode(&self) -> FlightMode {
        self.mode
    }

    /// How many mission items it has stored.
    pub fn mission_items(&self) -> usize {
        self.missions.len()
    }

    /// Whether the moment of [`VehicleSettings::die_after`] has come.
    pub fn is_dead(&self) -> bool {
        let end = self.settings.die_after;
        end.is_some_and(|after| self.clock >= Instant::ZERO + after)
    }

    /// The vehicle's own time at the caller's `now`.
    fn own_time(&mut self, now: Instant) -> Instant {
        let now = self.stalling.time(now);
        Instant::from_micros((now.as_micros() as f64 * self.settings.clock_rate).round() as u64)
    }

    /// Takes a datagram, or a piece of a byte stream, that came at `now`.
    pub fn receive(&mut self, now: Instant, mut bytes: &[u8]) {
        self.step(now);
        if self.is_dead() {
            return;
        }
        let now = self.clock;
        // The decoder is lent out while frames borrow from it.
        let mut decoder = std::mem::take(&mut self.decoder);
        while let Some(frame) = decoder.next_frame(&mut bytes) {
            let sender = frame.sender();
            // A value outside an enumeration: such a frame means nothing to us.
            if let Ok(message) = frame.message() {
                self.handle(now, sender, &message);
            }
        }
        self.decoder = decoder;
    }

    /// The datagram is over: a frame that is not whole never will be.
    pub fn end_of_datagram(&mut self, now: Instant) {
        self.step(now);
        let now = self.clock;
        let mut decoder = std::mem::take(&mut self.decoder);
        while let Some(frame) = decoder.end_of_datagram() {
            if let Ok(message) = frame.message() {
                self.handle(now, frame.sender(), &message);
            }
        }
        self.decoder = decoder;
    }

    /// Lets the time pass up to `now`.
    pub fn step(&mut self, now: Instant) {
        if self.is_dead() {
            return;
        }
        let own = self.own_time(now).max(self.clock);
        // Real autopilots send from the loop that moves the body; the others when they are asked.
        let regular = self.firmware != Firmware::Generic;
        while self.time + STEP <= own {
            self.time += STEP;
            self.clock = self.time;
            self.step_body();
            if regular {
                self.transmit_due(self.time);
            }
        }
        self.clock = own;
        self.tend_mission_transfer(own);
        if !regular {
            self.transmit_due(own);
        }
    }

    /// The next frame it sends; one datagram each.
    pub fn next_frame(&mut self) -> Option<Vec<u8>> {
        let (leaves, _) = self.outbox.front()?;
        if *leaves > self.clock || self.is_dead() {
            return None;
        }
        self.outbox.pop_front().map(|(_, frame)| frame)
    }

    /// A pilot switches the mode with the remote control.
    pub fn pilot_sets_mode(&mut self, now: Instant, mode: FlightMode) {
        self.step(now);
        self.set_mode(mode);
    }

    /// Sets the clock of signatures, microseconds since 1970; it never goes back. It is no part
    /// of simulated time: signatures of today must not look like tomorrow's.
    pub fn set_signing_time(&mut self, unix_us: u64) {
        if let Some(signer) = self.encoder.signer_mut() {
            signer.set_time(unix_us);
        }
        if let Some(verifier) = self.decoder.verifier_mut() {
            verifier.set_time(unix_us);
        }
    }

    fn send(&mut self, message: &MavMessage) {
        if self.crashed {
            return;
        }
        let mut buffer = [0; MAX_FRAME];
        let frame = self.encoder.encode(message, &mut buffer).to_vec();
        self.enqueue(frame);
    }

    /// Frames of regular messages leave with jitter; see [`Streams`].
    fn enqueue(&mut self, frame: Vec<u8>) {
        if self.outbox.len() >= OUTBOX {
            self.outbox.pop_front();
        }
        let leaves = self.timing.leaves(self.clock, self.streams.sending);
        self.outbox.push_back((leaves, frame));
    }

    fn is_ready(&self) -> bool {
        self.time >= Instant::ZERO + self.settings.ready_after
    }

    fn set_mode(&mut self, mode: FlightMode) {
        if self.mode != mode {
            self.mode = mode;
            self.setpoint = None;
            self.take_off_to = None;
            self.hold_altitude_m = self.body.altitude_m;
            self.landed_since = None;
            self.sinks = false;
            // Where heartbeats come once a second, the next one tells.
            if !self.faults.no_heartbeat && self.firmware.sends_heartbeats_on_request() {
                self.send_heartbeat();
            }
        }
    }

    fn step_body(&mut self) {
        self.own_failsafes();
        self.fly_mission();
        let demand = self.demand();
        let ability = self.ability();
        let air = self.wind.step(STEP.as_secs_f64());
        self.body.step(STEP.as_secs_f64(), &demand, &ability, &air);
        if let Some(altitude_m) = self.take_off_to
            && (self.body.altitude_m - altitude_m).abs() < 0.3
        {
            self.take_off_to = None;
            self.hold_altitude_m = altitude_m;
        }
        self.stop_motors_on_ground();
    }
}
