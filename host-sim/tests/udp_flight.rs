//! The client and `host_sim::serve` over real UDP, five times as fast as real time.

mod flight;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use firmware_core::autopilot::{Autopilot, AutopilotSettings, Leg, LegEnd, Phase};
use firmware_core::time::Instant;
use flight::{ALTITUDE_M, SLOT, SPEED_MPS, free_port, origin, start, zigzag};
use host_sim::{serve::serve, signing::SigningUpkeep};
use link::{LinkAddress, Port};
use vehicle::{Profile, Vehicle, VehicleSettings};

const SPEED: f64 = 5.0;

/// The client waits up to 250 ms of the vehicle's time for a sample of the slot's end, and receives
/// one every 50 ms: these are 50 ms and 10 ms of real time. Both ends run on this machine, so a leg
/// is late only if the machine delayed one of them; a gap of two samples shows that.
const STALL: Duration = Duration::from_millis(20);

struct RealTime {
    begin: std::time::Instant,
    /// The time of the last received message, and the longest gap since the leg began.
    heard: std::time::Instant,
    silence: Duration,
    client: Autopilot<f64>,
    port: Port,
}

impl RealTime {
    fn now(&self) -> Instant {
        Instant::from_micros((self.begin.elapsed().as_secs_f64() * SPEED * 1e6) as u64)
    }

    fn turn(&mut self) {
        let now = self.now();
        while let Some(message) = self.client.poll(now) {
            self.port.send(now, &message).unwrap();
        }
        let nap = (self.client.poll_at(now) - now).as_secs_f64() / SPEED;
        let mut nap = Duration::from_secs_f64(nap);
        while let Some((from, message)) = self.port.receive(self.now(), nap).unwrap() {
            let now = self.now();
            self.silence = self.silence.max(self.heard.elapsed());
            self.heard = std::time::Instant::now();
            self.client.receive(now, from, &message);
            nap = Duration::ZERO;
        }
    }

    fn run_until(&mut self, mut done: impl FnMut(&mut Self) -> bool) {
        let deadline = std::time::Instant::now() + Duration::from_secs(60);
        while !done(self) {
            assert!(
                std::time::Instant::now() < deadline,
                "{:?}",
                self.client.phase()
            );
            self.turn();
        }
    }

    fn fly_leg(&mut self, leg: Leg<f64>) -> LegEnd<f64> {
        self.silence = Duration::ZERO;
        self.client.fly_leg(self.now(), leg).unwrap();
        let mut ended = None;
        self.run_until(|flight| {
            ended = flight.client.leg_ended(flight.now());
            ended.is_some()
        });
        ended.unwrap()
    }
}

#[test]
fn over_udp_the_ideal_vehicle_is_at_every_waypoint_at_the_slots_end() {
    let port = free_port();
    let stop = Arc::new(AtomicBool::new(false));
    let vehicle = std::thread::spawn({
        let stop = Arc::clone(&stop);
        let listen: LinkAddress = format!("udpin:127.0.0.1:{port}").parse().unwrap();
        let settings = VehicleSettings::new(Profile::Ideal, origin(), start());
        move || {
            serve(
                listen.open()?.as_mut(),
                Vehicle::new(settings),
                SPEED,
                &stop,
                &mut SigningUpkeep::default(),
            )
        }
    });
    let settings = AutopilotSettings::new(origin(), start(), ALTITUDE_M, SPEED_MPS);
    let link: LinkAddress = format!("udpout:127.0.0.1:{port}").parse().unwrap();
    let mut flight = RealTime {
        begin: std::time::Instant::now(),
        heard: std::time::Instant::now(),
        silence: Duration::ZERO,
        port: Port::new(link.open().unwrap(), settings.own.resolve(None)),
        client: Autopilot::new(settings).unwrap(),
    };
    flight.client.launch(flight.now());
    flight.run_until(|flight| flight.client.phase() == Phase::Ready);
    let now = flight.now();
    let begin = flight
        .client
        .vehicle_time(now)
        .expect("it has said where it is");
    for (n, waypoint) in zigzag().into_iter().enumerate() {
        let end = begin + SLOT * (n as u32 + 1);
        let ended = flight.fly_leg(Leg { waypoint, end });
        // Every leg is confirmed in time at its waypoint, unless the machine stalled.
        let silence = flight.silence.max(flight.heard.elapsed());
        assert!(
            !ended.tick.extrapolated || silence >= STALL,
            "leg {n}: {ended:?} after {silence:?}"
        );
        assert!(
            ended.tick.extrapolated || ended.missed_m <= 1e-3,
            "leg {n}: {ended:?}"
        );
    }
    let land = flight.now();
    flight.client.land(land);
    flight.run_until(|flight| flight.client.phase() == Phase::Landed);
    assert_eq!(flight.client.fault(), None);
    assert_eq!(flight.port.counters().bad_checksum, 0);
    stop.store(true, Ordering::Relaxed);
    vehicle.join().unwrap().unwrap();
}
