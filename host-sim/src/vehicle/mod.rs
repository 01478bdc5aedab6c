//! The built-in vehicle: a MAVLink 2 endpoint around a simulated body, without I/O.
//!
//! It takes bytes and the time and gives bytes, like the client it is flown by; whether they
//! travel through a function call, a lossy link or a socket is not its business. In simulated
//! time it is deterministic.
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
pub use profile::Profile;
pub use serve::serve;

use body::{Body, Target};
use missions::Missions;
use parameters::Parameters;
use telemetry::Streams;

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
    outbox: VecDeque<Vec<u8>>,
    time: Instant,
    body: Body,
    home: Position<f64>,
    mode: FlightMode,
    armed: bool,
    armed_at: Instant,
    /// A take-off under way, to this altitude.
    take_off_to: Option<f64>,
    hold_altitude_m: f64,
    setpoint: Option<Setpoint>,
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
            time: Instant::ZERO,
            body: Body::on_ground(settings.start, settings.profile == Profile::Ideal),
            home: settings.start,
            mode: FlightMode::Manual,
            armed: false,
            armed_at: Instant::ZERO,
            take_off_to: None,
            hold_altitude_m: 0.0,
            setpoint: None,
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

    /// Takes a datagram, or a piece of a byte stream, that came at `now`.
    pub fn receive(&mut self, now: Instant, mut bytes: &[u8]) {
        self.step(now);
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
        while self.time + STEP <= now {
            self.time += STEP;
            self.step_body();
        }
        self.tend_mission_transfer(now);
        self.transmit_due(now);
    }

    /// The next frame it sends; one datagram each.
    pub fn next_frame(&mut self) -> Option<Vec<u8>> {
        self.outbox.pop_front()
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

    fn enqueue(&mut self, frame: Vec<u8>) {
        if self.outbox.len() >= OUTBOX {
            self.outbox.pop_front();
        }
        self.outbox.push_back(frame);
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
            // Autopilots tell at once when the mode changes.
            if !self.faults.no_heartbeat {
                self.send_heartbeat();
            }
        }
    }

    fn step_body(&mut self) {
        self.own_failsafes();
        self.fly_mission();
        let demand = self.demand();
        let ability = self.ability();
        self.body.step(STEP.as_secs_f64(), &demand, &ability);
        if let Some(altitude_m) = self.take_off_to
            && (self.body.altitude_m - altitude_m).abs() < 0.3
        {
            self.take_off_to = None;
            self.hold_altitude_m = altitude_m;
        }
        self.stop_motors_on_ground();
    }
}
