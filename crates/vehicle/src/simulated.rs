//! The vehicle itself: its clock, its link, and one step of its behaviour. The parts of the
//! behaviour are in `endpoint` (received messages), `telemetry` (sent messages), `missions` and
//! `conduct` (flight).

use std::collections::VecDeque;

use firmware_core::Position;
use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::wire::signing::{self, SigningState};
use firmware_core::autopilot::wire::{Address, Decoder, Encoder, MAX_FRAME};
use firmware_core::time::{Duration, Instant};
use mavlink::dialects::common::MavMessage;
use mavlink::error::ParserError;
use nalgebra::Vector2;

use super::behavior::Behavior;
use super::body::{Body, Target};
use super::mission_store::Missions;
use super::parameters::Parameters;
use super::settings::{Faults, VehicleSettings};
use super::streams::Streams;
use super::timing::{StallingClock, Timing};
use super::wind::Wind;

/// The mode of the vehicle. The numbers used in messages come from its [`Firmware`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlightMode {
    /// A person flies by hand. Without one, the vehicle hovers.
    Manual,
    /// The vehicle stays where it is.
    Loiter,
    /// The vehicle follows setpoints: GUIDED, OFFBOARD.
    Guided,
    /// The vehicle flies its mission.
    Auto,
    /// The vehicle returns to the place of take-off.
    Return,
    /// The vehicle lands.
    Land,
}

/// A setpoint and the time when it was received.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setpoint {
    pub(super) came: Instant,
    pub(super) target: Target,
}

/// The length of one step of the body.
const STEP: Duration = Duration::from_millis(10);
/// The number of frames that wait to be fetched. Older frames are dropped.
const OUTBOX: usize = 4096;

/// The simulated vehicle.
#[derive(Debug)]
pub struct Vehicle {
    pub(super) settings: VehicleSettings,
    pub(super) firmware: Firmware,
    pub(super) decoder: Decoder,
    pub(super) encoder: Encoder,
    /// The frames to send, with the times at which they leave.
    pub(super) outbox: VecDeque<(Instant, Vec<u8>)>,
    pub(super) timing: Timing,
    pub(super) stalling: StallingClock,
    /// The vehicle's time up to which the body has been simulated. `clock` is its latest time.
    pub(super) time: Instant,
    pub(super) clock: Instant,
    pub(super) wind: Wind,
    pub(super) body: Body,
    pub(super) home: Position<f64>,
    pub(super) mode: FlightMode,
    pub(super) armed: bool,
    pub(super) armed_at: Instant,
    /// The altitude of the take-off in progress.
    pub(super) take_off_to: Option<f64>,
    pub(super) hold_altitude_m: f64,
    pub(super) setpoint: Option<Setpoint>,
    /// The previous setpoint, which is followed until the latest one takes effect.
    pub(super) previous: Option<Setpoint>,
    /// The time at which the present stream of setpoints without gaps began.
    pub(super) stream_since: Option<Instant>,
    pub(super) landed_since: Option<Instant>,
    /// The time of the last ground station heartbeat that counts for the failsafe.
    pub(super) ground_heard: Option<Instant>,
    /// ArduCopter: whether a value that is not a number reached the position controller.
    pub(super) crashed: bool,
    /// PX4: whether OFFBOARD was left because setpoints stopped.
    pub(super) sinks: bool,
    pub(super) missions: Missions,
    pub(super) parameters: Parameters,
    pub(super) streams: Streams,
    /// The faults that a test injects.
    pub faults: Faults,
}

impl Vehicle {
    /// Creates a vehicle on the ground.
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
        if let Some(signing) = &settings.signing {
            signing::start(&mut decoder, &mut encoder, signing.clone());
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

    /// Returns the time of the vehicle's clock, which its messages are stamped with.
    pub fn boot_time(&self) -> Instant {
        self.time
    }

    pub(super) fn behavior(&self) -> Behavior {
        Behavior::of(self.firmware)
    }

    /// Returns whether the vehicle follows the paper's kinematics: it is always where its last
    /// setpoint says.
    pub fn is_ideal(&self) -> bool {
        self.settings.profile.is_ideal()
    }

    /// Returns the true position on the map, m.
    pub fn true_position(&self) -> Position<f64> {
        self.body.position
    }

    /// Returns the true velocity, m/s.
    pub fn velocity(&self) -> Vector2<f64> {
        self.body.velocity
    }

    /// Returns the true height above the ground, m.
    pub fn altitude_m(&self) -> f64 {
        self.body.altitude_m
    }

    /// Returns whether the motors may turn.
    pub fn armed(&self) -> bool {
        self.armed
    }

    /// Returns the mode.
    pub fn mode(&self) -> FlightMode {
        self.mode
    }

    /// Returns the number of mission items that are stored.
    pub fn mission_items(&self) -> usize {
        self.missions.len()
    }

    /// Returns whether the time of [`VehicleSettings::die_after`] has been reached.
    pub fn is_dead(&self) -> bool {
        let end = self.settings.die_after;
        end.is_some_and(|after| self.clock >= Instant::ZERO + after)
    }

    /// Returns the vehicle's own time at the caller's `now`.
    pub(super) fn own_time(&mut self, now: Instant) -> Instant {
        let now = self.stalling.time(now);
        Instant::from_micros((now.as_micros() as f64 * self.settings.clock_rate).round() as u64)
    }

    /// Receives a datagram, or a piece of a byte stream, at `now`.
    pub fn receive(&mut self, now: Instant, mut bytes: &[u8]) {
        self.step(now);
        if self.is_dead() {
            return;
        }
        let now = self.clock;
        // The decoder is moved out while frames borrow from it.
        let mut decoder = std::mem::take(&mut self.decoder);
        while let Some(frame) = decoder.next_frame(&mut bytes) {
            let (sender, message) = (frame.sender(), frame.message());
            self.take(now, sender, message, &mut decoder);
        }
        self.decoder = decoder;
    }

    /// Marks the end of a datagram. A frame that is incomplete then is discarded.
    pub fn end_of_datagram(&mut self, now: Instant) {
        self.step(now);
        let now = self.clock;
        let mut decoder = std::mem::take(&mut self.decoder);
        while let Some(frame) = decoder.end_of_datagram() {
            let (sender, message) = (frame.sender(), frame.message());
            self.take(now, sender, message, &mut decoder);
        }
        self.decoder = decoder;
    }

    /// Handles the message of a frame. A message with a value outside an enumeration is ignored.
    fn take(
        &mut self,
        now: Instant,
        sender: Address,
        message: Result<MavMessage, ParserError>,
        decoder: &mut Decoder,
    ) {
        // Before the answer is signed.
        signing::synchronize(decoder, &mut self.encoder);
        if let Ok(message) = message {
            self.handle(now, sender, &message);
        }
    }

    /// Advances the time to `now`.
    pub fn step(&mut self, now: Instant) {
        if self.is_dead() {
            return;
        }
        let own = self.own_time(now).max(self.clock);
        // Real autopilots send from the loop that moves the body. The others send when they are
        // asked.
        let regular = self.behavior().samples_in_its_loop;
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

    /// Returns the next frame to send, one per datagram.
    pub fn next_frame(&mut self) -> Option<Vec<u8>> {
        let (leaves, _) = self.outbox.front()?;
        if *leaves > self.clock || self.is_dead() {
            return None;
        }
        self.outbox.pop_front().map(|(_, frame)| frame)
    }

    /// Simulates a pilot who switches the mode with the remote control.
    pub fn pilot_sets_mode(&mut self, now: Instant, mode: FlightMode) {
        self.step(now);
        self.set_mode(mode);
    }

    /// Sets the clock of signatures, microseconds since 1970. It never decreases. It is independent
    /// of simulated time, because signatures must not carry a time in the future.
    pub fn set_signing_time(&mut self, unix_us: u64) {
        signing::set_time(&mut self.decoder, &mut self.encoder, unix_us);
    }

    /// Returns the state of signatures that a restarted vehicle needs, or `None` without a key.
    pub fn signing_state(&self) -> Option<SigningState> {
        signing::state(&self.decoder, &self.encoder)
    }

    pub(super) fn send(&mut self, message: &MavMessage) {
        if self.crashed {
            return;
        }
        let mut buffer = [0; MAX_FRAME];
        let frame = self.encoder.encode(message, &mut buffer).to_vec();
        self.enqueue(frame);
    }

    /// Queues a frame. Frames of regular messages leave with jitter; see [`Streams`].
    pub(super) fn enqueue(&mut self, frame: Vec<u8>) {
        if self.outbox.len() >= OUTBOX {
            self.outbox.pop_front();
        }
        let leaves = self.timing.leaves(self.clock, self.streams.sending);
        self.outbox.push_back((leaves, frame));
    }

    pub(super) fn is_ready(&self) -> bool {
        self.time >= Instant::ZERO + self.settings.ready_after
    }

    pub(super) fn set_mode(&mut self, mode: FlightMode) {
        if self.mode != mode {
            self.mode = mode;
            self.setpoint = None;
            self.take_off_to = None;
            self.hold_altitude_m = self.body.altitude_m;
            self.landed_since = None;
            self.sinks = false;
            // If the autopilot sends heartbeats only once a second, the next one reports the
            // change.
            if !self.faults.no_heartbeat && self.firmware.sends_heartbeats_on_request() {
                self.send_heartbeat();
            }
        }
    }

    pub(super) fn step_body(&mut self) {
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
