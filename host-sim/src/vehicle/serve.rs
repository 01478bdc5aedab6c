//! The vehicle as a process of its own.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use firmware_core::time::Instant;

use super::{Vehicle, VehicleSettings};
use crate::link::LinkAddress;

/// Runs a vehicle at `listen`, `speed` times as fast as real time, until `stop` is set.
/// Answers within the time that a datagram takes; moves on at least every 2 ms.
pub fn serve(
    listen: &LinkAddress,
    settings: VehicleSettings,
    speed: f64,
    stop: &AtomicBool,
) -> io::Result<()> {
    if !(speed.is_finite() && speed > 0.0) {
        let message = format!("speed is {speed}; it must be a number above 0");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
    }
    let mut link = listen.open()?;
    let mut vehicle = Vehicle::new(settings);
    let begin = std::time::Instant::now();
    let clock = || {
        let elapsed = begin.elapsed().as_secs_f64() * speed;
        Instant::from_micros((elapsed * 1e6) as u64)
    };
    let nap = Duration::from_secs_f64((0.01 / speed).clamp(2e-4, 2e-3));
    let mut piece = Vec::new();
    while !stop.load(Ordering::Relaxed) {
        if link.receive(&mut piece, nap)? {
            vehicle.receive(clock(), &piece);
            if link.is_datagram() {
                vehicle.end_of_datagram(clock());
            }
        }
        vehicle.step(clock());
        while let Some(frame) = vehicle.next_frame() {
            link.send(&frame)?;
        }
    }
    Ok(())
}
