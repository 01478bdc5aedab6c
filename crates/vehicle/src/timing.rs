//! The vehicle's clock and the times at which messages leave: stalls, jitter and hiccups, as
//! recorded.
//!
//! Frames keep their order. A regular message leaves a little after it was created, and
//! occasionally later. During a hiccup nothing leaves, and afterwards all waiting messages leave at
//! once. During a stall the vehicle's time stops, as in a simulator on a busy computer.

use firmware_core::time::{Duration, Instant};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// How regularly samples are taken and delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sampling {
    /// The largest delay between the creation of a regular message and its departure.
    pub jitter: Duration,
    /// The largest additional delay of one message in two hundred.
    pub rare_jitter: Duration,
    /// Samples are taken at multiples of this time, up to one and a half multiples before they are
    /// sent. If it is zero, they are taken when they are sent.
    pub grid: Duration,
}

/// Random pauses, either of transmission (hiccups) or of the vehicle's clock (stalls).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pauses {
    /// The length of a pause, or zero for no pauses.
    pub length: Duration,
    /// The average time from one pause to the next. It varies between half and one and a half times
    /// this value.
    pub interval: Duration,
}

impl Pauses {
    /// Draws the time from the beginning of one pause to that of the next.
    fn next(&self, random: &mut Pcg64Mcg) -> Duration {
        self.interval / 2 + up_to(self.interval, random)
    }
}

fn up_to(span: Duration, random: &mut Pcg64Mcg) -> Duration {
    Duration::from_secs_f64(span.as_secs_f64() * random.random::<f64>())
}

/// A clock that stops during stalls and never makes up for the lost time.
#[derive(Clone, Debug)]
pub(super) struct StallingClock {
    stalls: Pauses,
    random: Pcg64Mcg,
    /// The beginning of the next stall, or of the present one, in the caller's time.
    begins: Instant,
    lost: Duration,
}

impl StallingClock {
    pub(super) fn new(stalls: Pauses, seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let begins = Instant::ZERO + stalls.next(&mut random);
        Self {
            stalls,
            random,
            begins,
            lost: Duration::ZERO,
        }
    }

    /// Returns the time that has passed outside of stalls. `now` must never decrease.
    pub(super) fn time(&mut self, now: Instant) -> Instant {
        let length = self.stalls.length;
        if length == Duration::ZERO {
            return now;
        }
        while now >= self.begins + length {
            self.lost = self.lost + length;
            self.begins += self.stalls.next(&mut self.random).max(length);
        }
        now.min(self.begins).back(self.lost)
    }
}

/// One message in this number has the larger delay.
const RARE: f64 = 200.0;

#[derive(Clone, Debug)]
pub(super) struct Timing {
    sampling: Sampling,
    hiccups: Pauses,
    random: Pcg64Mcg,
    /// The beginning of the next hiccup.
    hiccup_at: Instant,
    /// The time at which the last frame leaves.
    last: Instant,
}

impl Timing {
    pub(super) fn new(sampling: Sampling, hiccups: Pauses, seed: u64) -> Self {
        let mut timing = Self {
            sampling,
            hiccups,
            random: Pcg64Mcg::seed_from_u64(seed),
            hiccup_at: Instant::ZERO,
            last: Instant::ZERO,
        };
        timing.plan_hiccup();
        timing
    }

    fn plan_hiccup(&mut self) {
        self.hiccup_at += self.hiccups.next(&mut self.random);
    }

    /// Returns the time at which a sample that is sent at `now` was taken.
    pub(super) fn sampled(&mut self, now: Instant) -> Instant {
        let grid = self.sampling.grid;
        if grid == Duration::ZERO {
            return now;
        }
        let before = now.back(up_to(grid / 2, &mut self.random)).as_micros();
        Instant::from_micros(before - before % grid.as_micros())
    }

    /// Returns the time at which a frame created at `now` leaves, never before the previous frame.
    pub(super) fn leaves(&mut self, now: Instant, regular: bool) -> Instant {
        let mut at = now;
        if regular {
            at += up_to(self.sampling.jitter, &mut self.random);
            if self.random.random::<f64>() * RARE < 1.0 {
                at += up_to(self.sampling.rare_jitter, &mut self.random);
            }
        }
        if self.hiccups.length > Duration::ZERO {
            while at >= self.hiccup_at + self.hiccups.length {
                self.plan_hiccup();
            }
            if at >= self.hiccup_at {
                at = self.hiccup_at + self.hiccups.length;
            }
        }
        self.last = self.last.max(at);
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stall_is_lost_for_good_and_time_never_goes_back() {
        let stalls = Pauses {
            length: Duration::from_millis(150),
            interval: Duration::from_secs(10),
        };
        let mut clock = StallingClock::new(stalls, 3);
        let (mut last, mut stood) = (Instant::ZERO, 0);
        for n in 1..=60_000_u64 {
            let time = clock.time(Instant::from_micros(n * 1_000));
            let passed = time - last;
            assert!(last <= time && passed <= Duration::from_millis(1), "{n}");
            stood += u32::from(passed == Duration::ZERO);
            last = time;
        }
        // Four to six stalls a minute, with a tolerance of one.
        assert!((450..=1_200).contains(&stood), "{stood} ms");
        // Each stall begins and ends between two readings of the clock.
        let lost_ms = (Instant::from_micros(60_000_000) - last).as_micros() / 1_000;
        assert!(lost_ms.abs_diff(stood.into()) <= 10, "{lost_ms} {stood}");
    }
}
