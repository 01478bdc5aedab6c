//! Runs the vehicle as a separate process.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration as WallDuration;

use firmware_core::time::{Duration, Instant};

use link::{Link, tlog::wall_clock_us};
use vehicle::Vehicle;

use crate::signing::SigningUpkeep;

/// The longest step of the vehicle's time: if the machine was late, the telemetry of every part of
/// the missed time is sent, as a vehicle that was not late would send it.
const STEP: Duration = Duration::from_millis(10);

/// Runs a vehicle at the other end of `link`, `speed` times as fast as real time, until `stop` is
/// set. After the vehicle's death the link stays open, and nothing is read or sent. Answers as soon
/// as a datagram is received; advances the vehicle at least every 2 ms. `upkeep` is that of the
/// vehicle's signatures.
pub fn serve(
    link: &mut dyn Link,
    mut vehicle: Vehicle,
    speed: f64,
    stop: &AtomicBool,
    upkeep: &mut SigningUpkeep,
) -> io::Result<()> {
    if !(speed.is_finite() && speed > 0.0) {
        let message = format!("speed is {speed}; it must be a number above 0");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
    }
    let begin = std::time::Instant::now();
    let nap = WallDuration::from_secs_f64((0.01 / speed).clamp(2e-4, 2e-3));
    let mut piece = Vec::new();
    let mut now = Instant::ZERO;
    while !stop.load(Ordering::Relaxed) {
        if vehicle.is_dead() {
            std::thread::sleep(nap);
            continue;
        }
        let came = link.receive(&mut piece, nap)?;
        if let Some(unix_us) = upkeep.date(wall_clock_us()) {
            vehicle.set_signing_time(unix_us);
        }
        let clock = Instant::ZERO + Duration::from_secs_f64(begin.elapsed().as_secs_f64() * speed);
        while now < clock {
            now = clock.min(now + STEP);
            vehicle.step(now);
            send_all(&mut vehicle, link)?;
        }
        if came {
            vehicle.receive(now, &piece);
            if link.is_datagram() {
                vehicle.end_of_datagram(now);
            }
            send_all(&mut vehicle, link)?;
        }
        upkeep.note(|| vehicle.signing_state());
    }
    Ok(())
}

fn send_all(vehicle: &mut Vehicle, link: &mut dyn Link) -> io::Result<()> {
    while let Some(frame) = vehicle.next_frame() {
        link.send(&frame)?;
    }
    Ok(())
}
