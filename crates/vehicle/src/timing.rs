//! The vehicle's clock, and when what it sends leaves it: stalls, jitter and hiccups, as recorded.
//!
//! Frames keep their order. A regular message leaves a little after it was made, now and then
//! later. During a hiccup nothing leaves, and afterwards everything that waited does. During a
//! stall the vehicle's time stands still, as that of a simulator does whose computer is busy.

use firmware_core::time::{Duration, Instant};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// How regularly samples are taken and delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sampling {
    /// A regular message leaves up to this much after it was made.
    pub jitter: Duration,
    /// One in two hundred leaves up to this much later.
    pub rare_jitter: Duration,
    /// Samples are taken at multiples of this time, up to one multiple and a half before they
    /// are sent; zero: when they are sent.
    pub grid: Duration,
}

/// Pauses that come at random: of what is sent (hiccups), or of the vehicle's clock (stalls).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pauses {
    /// How long one lasts; zero for none.
    pub length: Duration,
    /// From one to the next, on average: half as long to half as long again.
    pub interval: Duration,
}

impl Pauses {
    /// From the beginning of one pause to that of the next.
    fn next(&self, random: &mut Pcg64Mcg) -> Duration {
        self.interval / 2 + up_to(self.interval, random)
    }
}

fn up_to(span: Duration, random: &mut Pcg64Mcg) -> Duration {
    Duration::from_secs_f64(span.as_secs_f64() * random.random::<f64>())
}

/// A clock that stands still in its stalls and never makes up for them.
#[derive(Clone, Debug)]
pub(super) struct StallingClock {
    stalls: Pauses,
    random: Pcg64Mcg,
    /// Where the next stall begins, or the one that lasts began, in the caller's time.
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

    /// The time that has passed outside of stalls; `now` never decreases.
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

/// One message of this many is a rarely late one.
const RARE: f64 = 200.0;

#[derive(Clone, Debug)]
pub(super) struct Timing {
    sampling: Sampling,
    hiccups: Pauses,
    random: Pcg64Mcg,
    /// Where the next hiccup begins.
    hiccup_at: Instant,
    /// When the last frame leaves.
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

    /// When a sample that is sent at `now` was taken.
    pub(super) fn sampled(&mut self, now: Instant) -> Instant {
        let grid = self.sampling.grid;
        if grid == Duration::ZERO {
            return now;
        }
        let before = now.back(up_to(grid / 2, &mut self.random)).as_micros();
        Instant::from_micros(before - before % grid.as_micros())
    }

    /// When a frame that was made at `now` leaves; never before the one made before it.
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
        // Four to six stalls a minute, or one more or less.
        assert!((450..=1_200).contains(&stood), "{stood} ms");
        // Each stall begins and ends between two looks.
        let lost_ms = (Instant::from_micros(60_000_000) - last).as_micros() / 1_000;
        assert!(lost_ms.abs_diff(stood.into()) <= 10, "{lost_ms} {stood}");
    }
}
