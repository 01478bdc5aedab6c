//! The time of a flight: simulated with the built-in vehicle, real with any other.

use std::{
    io,
    thread::sleep,
    time::{Duration as WallDuration, Instant as WallInstant},
};

use firmware_core::time::{Duration, Instant};

use super::{peer::Peer, settings::RealTimeFactor};

/// The longest sleep: with a small real-time factor a step takes long, and a user who asks for the
/// end must not have to wait for it.
const NAP: WallDuration = WallDuration::from_millis(200);

/// One step of simulated time.
const TICK: Duration = Duration::from_millis(10);

/// The time of a flight.
#[derive(Debug)]
pub(super) struct Clock {
    real_time_factor: RealTimeFactor,
    begun: WallInstant,
    now: Instant,
}

impl Clock {
    pub(super) fn new(real_time_factor: RealTimeFactor) -> Self {
        Self {
            real_time_factor,
            begun: WallInstant::now(),
            now: Instant::ZERO,
        }
    }

    pub(super) fn now(&self) -> Instant {
        self.now
    }

    /// Returns the time that has passed on the wall clock, multiplied by the real-time factor.
    fn wall(&self) -> Instant {
        let passed_s = self.begun.elapsed().as_secs_f64() * self.real_time_factor.factor();
        Instant::ZERO + Duration::from_secs_f64(passed_s)
    }

    /// Advances to the next poll: by one tick, or until something was received from the vehicle.
    pub(super) fn advance(&mut self, peer: &mut Peer) -> io::Result<()> {
        if peer.is_built_in() {
            let next = self.now + TICK;
            if self.real_time_factor != RealTimeFactor::Max {
                let ahead =
                    next.duration_since(self.wall()).as_secs_f64() / self.real_time_factor.factor();
                let ahead = WallDuration::from_secs_f64(ahead);
                sleep(ahead.min(NAP));
                if ahead > NAP {
                    return Ok(());
                }
            }
            self.now = next;
        } else {
            peer.wait(WallDuration::from_millis(2))?;
            self.now = self.wall();
        }
        Ok(())
    }
}
