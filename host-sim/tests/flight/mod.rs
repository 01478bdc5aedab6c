//! A client and a vehicle that exchange only bytes, in simulated time.
// Each test binary is a separate crate and uses only a part of this module.
#![allow(dead_code, unreachable_pub)]

use firmware_core::Position;
use firmware_core::autopilot::frames::Geodetic;
use firmware_core::autopilot::wire::{Decoder, Encoder, MAX_FRAME};
use firmware_core::autopilot::{Autopilot, AutopilotSettings, Leg, LegEnd, Phase};
use firmware_core::time::{Duration, Instant};
use link::lossy::{Channel, Faults};
use mavlink::dialects::common::MavMessage;
use vehicle::{Profile, Vehicle, VehicleSettings};

pub const TICK: Duration = Duration::from_millis(10);
pub const SLOT: Duration = Duration::from_secs(1);
pub const ALTITUDE_M: f64 = 100.0;
pub const SPEED_MPS: f64 = 30.0;

pub fn origin() -> Geodetic {
    Geodetic::from_degrees(47.3977, 8.5456).unwrap()
}

pub fn start() -> Position<f64> {
    Position::new(50.0, 80.0)
}

/// Returns a UDP port that was free a moment ago, for the vehicle to use.
pub fn free_port() -> u16 {
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.local_addr().unwrap().port()
}

pub struct Flight {
    pub now: Instant,
    pub client: Autopilot<f64>,
    pub encoder: Encoder,
    pub decoder: Decoder,
    pub vehicle: Vehicle,
    pub log: Vec<String>,
    /// All messages that the client sent, whether or not they were received.
    pub sent: Vec<(Instant, MavMessage)>,
    pub up: Channel,
    pub down: Channel,
    /// The messages of the client that are never delivered.
    pub swallowed: fn(&MavMessage) -> bool,
}

impl Flight {
    pub fn new(settings: AutopilotSettings<f64>, vehicle: VehicleSettings) -> Self {
        Self {
            now: Instant::ZERO,
            encoder: Encoder::new(settings.own.resolve(None)),
            client: Autopilot::new(settings).unwrap(),
            decoder: Decoder::in_order(),
            vehicle: Vehicle::new(vehicle),
            log: Vec::new(),
            sent: Vec::new(),
            up: Channel::new(Faults::default(), 0),
            down: Channel::new(Faults::default(), 0),
            swallowed: |_| false,
        }
    }

    /// Makes the link worse in both directions.
    pub fn degrade(&mut self, faults: &Faults, seed: u64) {
        self.up = Channel::new(faults.clone(), seed);
        self.down = Channel::new(faults.clone(), !seed);
    }

    /// Passes messages in both directions until none are pending.
    pub fn exchange(&mut self) {
        let mut buffer = [0; MAX_FRAME];
        loop {
            let mut quiet = true;
            while let Some(message) = self.client.poll(self.now) {
                self.encoder.send_as(self.client.own());
                let bytes = self.encoder.encode(&message, &mut buffer);
                if !(self.swallowed)(&message) {
                    self.up.push(self.now, bytes);
                }
                self.sent.push((self.now, message));
                quiet = false;
            }
            while let Some(frame) = self.up.pop(self.now) {
                self.vehicle.receive(self.now, &frame);
                self.vehicle.end_of_datagram(self.now);
            }
            self.vehicle.step(self.now);
            while let Some(frame) = self.vehicle.next_frame() {
                self.down.push(self.now, &frame);
            }
            while let Some(frame) = self.down.pop(self.now) {
                let mut bytes = &frame[..];
                while let Some(frame) = self.decoder.next_frame(&mut bytes) {
                    let message = frame.message().expect("our own frames are readable");
                    self.client.receive(self.now, frame.sender(), &message);
                    quiet = false;
                }
                while self.decoder.end_of_datagram().is_some() {}
            }
            while let Some(event) = self.client.take_next_event() {
                let seconds = self.now.as_micros() as f64 * 1e-6;
                self.log.push(format!("{seconds:9.3} {event}"));
            }
            if quiet {
                return;
            }
        }
    }

    pub fn run_until(&mut self, limit: Duration, mut done: impl FnMut(&mut Self) -> bool) {
        let end = self.now + limit;
        self.exchange();
        while !done(self) {
            let phase = self.client.phase();
            let log = self.log.join("\n");
            assert!(self.now < end, "{phase:?} for too long:\n{log}");
            self.now += TICK;
            self.exchange();
        }
    }

    pub fn run_until_phase(&mut self, phase: Phase, limit: Duration) {
        self.run_until(limit, |flight| flight.client.phase() == phase);
    }

    pub fn run_for(&mut self, span: Duration) {
        let end = self.now + span;
        self.run_until(span * 2, |flight| flight.now >= end);
    }

    pub fn fly_leg(&mut self, waypoint: Position<f64>, end: Instant) -> LegEnd<f64> {
        let leg = Leg { waypoint, end };
        if let Err(refused) = self.client.fly_leg(self.now, leg) {
            panic!("{refused}:\n{}", self.log.join("\n"));
        }
        let mut ended = None;
        self.run_until(SLOT * 2, |flight| {
            ended = flight.client.leg_ended(flight.now);
            ended.is_some()
        });
        ended.unwrap()
    }
}

/// Returns the client's settings for a profile.
pub fn settings(profile: Profile) -> AutopilotSettings<f64> {
    AutopilotSettings {
        limits: profile.client_limits(),
        ..AutopilotSettings::new(origin(), start(), ALTITUDE_M, SPEED_MPS)
    }
}

/// Returns the vehicle's settings for a profile.
pub fn vehicle(profile: Profile) -> VehicleSettings {
    VehicleSettings::new(profile, origin(), start())
}

/// Returns a flight that holds at the start, ready for legs.
pub fn ready(
    profile: Profile,
    change: impl FnOnce(&mut AutopilotSettings<f64>, &mut VehicleSettings),
) -> Flight {
    let (mut settings, mut vehicle) = (settings(profile), vehicle(profile));
    change(&mut settings, &mut vehicle);
    let mut flight = Flight::new(settings, vehicle);
    flight.client.launch(flight.now);
    flight.run_until_phase(Phase::Ready, Duration::from_secs(300));
    flight
}

/// Returns waypoints with corners, each within 30 m of the previous one.
pub fn zigzag() -> Vec<Position<f64>> {
    let mut place = start();
    (0..10)
        .map(|n| {
            let angle = 0.4 + f64::from(n) * 1.1;
            place.x += 29.9 * angle.cos();
            place.y += 29.9 * angle.sin();
            place
        })
        .collect()
}
