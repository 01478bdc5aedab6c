//! The client and `vehicle::serve` over real UDP, five times as fast as real time.

mod flight;

use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use firmware_core::autopilot::{Autopilot, Leg, LegEnd, Phase, Settings};
use firmware_core::time::Instant;
use flight::{ALTITUDE_M, SLOT, SPEED_MPS, origin, start, zigzag};
use host_sim::link::{LinkAddress, Port};
use host_sim::vehicle::{Profile, Vehicle, VehicleSettings, serve};

const SPEED: f64 = 5.0;

struct RealTime {
    begin: std::time::Instant,
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
    // A free port; given back just before the vehicle takes it.
    let port = UdpSocket::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
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
            )
        }
    });
    let settings = Settings::new(origin(), start(), ALTITUDE_M, SPEED_MPS);
    let link: LinkAddress = format!("udpout:127.0.0.1:{port}").parse().unwrap();
    let mut flight = RealTime {
        begin: std::time::Instant::now(),
        port: Port::new(link.open().unwrap(), settings.own),
        client: Autopilot::new(settings).unwrap(),
    };
    flight.client.launch(flight.now());
    flight.run_until(|flight| flight.client.phase() == Phase::Ready);
    let begin = flight.now();
    let mut late = 0;
    for (n, waypoint) in zigzag().into_iter().enumerate() {
        let end = begin + SLOT * (n as u32 + 1);
        let ended = flight.fly_leg(Leg { waypoint, end });
        // A machine that stalls for 50 ms makes a leg late; what it says then is that.
        late += usize::from(ended.late);
        assert!(ended.late || ended.missed_m <= 1e-3, "leg {n}: {ended:?}");
    }
    assert!(late <= 2, "{late} legs were not confirmed in time");
    let land = flight.now();
    flight.client.land(land);
    flight.run_until(|flight| flight.client.phase() == Phase::Landed);
    assert_eq!(flight.client.fault(), None);
    assert_eq!(flight.port.counters().bad_checksum, 0);
    stop.store(true, Ordering::Relaxed);
    vehicle.join().unwrap().unwrap();
}
