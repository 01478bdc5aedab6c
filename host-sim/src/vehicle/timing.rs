//! When what the vehicle sends leaves it: jitter and hiccups, as recorded.
//!
//! Frames keep their order. A regular message leaves a little after it was made, now and then
//! later; during a hiccup nothing leaves, and afterwards everything that waited does.

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

/// Moments in which nothing comes from the vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hiccups {
    /// How long one lasts; zero for none.
    pub length: Duration,
    /// From one to the next, on average: half as long to half as long again.
    pub interval: Duration,
}

/// One message of this many is a rarely late one.
const RARE: f64 = 200.0;

#[derive(Clone, Debug)]
pub(super) struct Timing {
    sampling: Sampling,
    hiccups: Hiccups,
    random: Pcg64Mcg,
    /// Where the next hiccup begins.
    hiccup_at: Instant,
    /// When the last frame leaves.
    last: Instant,
}

impl Timing {
    pub(super) fn new(sampling: Sampling, hiccups: Hiccups, seed: u64) -> Self {
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

    fn up_to(&mut self, span: Duration) -> Duration {
        Duration::from_secs_f64(span.as_secs_f64() * self.random.random::<f64>())
    }

    fn plan_hiccup(&mut self) {
        let interval = self.hiccups.interval;
        let later = self.up_to(interval);
        self.hiccup_at += interval / 2 + later;
    }

    /// When a sample that is sent at `now` was taken.
    pub(super) fn sampled(&mut self, now: Instant) -> Instant {
        let grid = self.sampling.grid;
        if grid == Duration::ZERO {
            return now;
        }
        let before = now.back(self.up_to(grid / 2)).micros();
        Instant::from_micros(before - before % grid.micros())
    }

    /// When a frame that was made at `now` leaves; never before the one made before it.
    pub(super) fn leaves(&mut self, now: Instant, regular: bool) -> Instant {
        let mut at = now;
        if regular {
            at += self.up_to(self.sampling.jitter);
            if self.random.random::<f64>() * RARE < 1.0 {
                at += self.up_to(self.sampling.rare_jitter);
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
