// SPDX-License-Identifier: MIT OR Apache-2.0
//! The relation between the vehicle's clock and ours.
//!
//! Every position carries the vehicle's own time since boot. Legs are scheduled in that time,
//! because no other clock can be reproduced from a log: slot `n` ends at `t_0 + n delta` of the
//! vehicle's clock, whenever messages are received. [`VehicleClock`] maps our time to it.
//!
//! # Model
//!
//! A message that was stamped `v` on the vehicle is received at `o = offset + v / rate + delay` of
//! our time, where `delay >= 0` is different for every message. The two clocks may differ in rate
//! by several per cent (a simulation that does not keep up, or `--speed`), and a link may hold
//! messages back for a moment. Therefore:
//!
//! * of each `BUCKET` of our time, only the message with the smallest delay is used;
//! * the rate is the median of the slopes between such messages `SLOPE` buckets apart: a few late
//!   buckets have no effect;
//! * the offset is that of the message with the smallest delay in the last `RECENT` buckets;
//! * a simulation that stalls loses time for good (ArduCopter's: all but 100 ms of a stall): where
//!   the messages of three `BURST`s or more, over `STALL_WINDOW` or longer, are all later than
//!   that by more than `STALL`, earlier messages are no longer used. A *link* that paused
//!   delivers what it held back in one burst, whose last message is not late.
//!
//! The published mapping follows the estimate smoothly once a flight depends on it: it is corrected
//! by at most `SLEW` of the time that passes, unless it is off by more than `STEP`. A mapping
//! that is ahead is corrected sooner (`SLEW_AHEAD`): setpoints that are ahead of the vehicle's
//! clock make the vehicle fly too far in a slot.
//!
//! Worst case: `BUCKETS` points, one selection a second, `BURSTS` comparisons a
//! message. Its size on a 64-bit host:
//!
//! ```
//! # use firmware_core::autopilot::clock::VehicleClock;
//! # let about = |bytes: usize, size: usize| assert!(size.abs_diff(bytes) <= bytes / 20, "{size}");
//! about(870, size_of::<VehicleClock>());
//! ```

use crate::sort::insertion_sort;
use crate::time::{Duration, Instant};

/// The length of a bucket, in our time.
const BUCKET: Duration = Duration::from_secs(1);
/// The number of buckets that the estimate is made from.
const BUCKETS: usize = 32;
/// The number of buckets from which on the rate is estimated; until then the clocks count as
/// equally fast.
const BUCKETS_FOR_RATE: usize = 6;
/// The distance, in buckets, of the messages whose slopes are compared.
const SLOPE: usize = 4;
/// The number of buckets that the offset is taken from.
const RECENT: usize = 3;
/// Messages that are received within this time of each other are one burst, of which only the
/// message with the smallest delay is used.
const BURST: Duration = Duration::from_millis(5);
/// The time for which messages must be late after a stall until it is accepted.
const STALL_WINDOW: Duration = Duration::from_millis(60);
/// The smallest number of bursts that must be late.
const STALL_BURSTS: usize = 3;
/// The smallest lateness, microseconds.
const STALL: f64 = 40_000.0;
/// The number of bursts that are kept: as many as fit [`STALL_WINDOW`].
const BURSTS: usize = STALL_BURSTS + (STALL_WINDOW.as_micros() / BURST.as_micros()) as usize;
/// The largest rate of correction, as a fraction of the time that passes.
const SLEW: f64 = 0.05;
/// The same where the mapping is ahead of the vehicle's clock.
const SLEW_AHEAD: f64 = 0.3;
/// The smallest error at which a mapping is set at once, microseconds.
const STEP: f64 = 80_000.0;
/// The time in which a deviation would be corrected if [`SLEW`] allowed it, microseconds.
const CORRECTION: f64 = 1e6;
/// The same where the mapping is ahead of the vehicle's clock.
const CORRECTION_AHEAD: f64 = 0.25e6;
/// Estimates of the rate outside this range are discarded.
const RATES: core::ops::RangeInclusive<f64> = 0.5..=2.0;

/// A message: when it was stamped on the vehicle and when it was received, microseconds of either
/// clock.
#[derive(Clone, Copy, Debug)]
struct Stamp {
    vehicle_us: u64,
    ours_us: u64,
}

impl Stamp {
    /// Returns when the vehicle's clock showed zero, in our time, if it ran at `rate`.
    fn offset_us(&self, rate: f64) -> f64 {
        self.ours_us as f64 - self.vehicle_us as f64 / rate
    }
}

/// Maps our time to the vehicle's. See the module's documentation.
#[derive(Clone, Debug)]
pub struct VehicleClock {
    /// The least delayed message of each bucket, oldest first.
    buckets: heapless::Deque<Stamp, BUCKETS>,
    /// The least delayed messages of the latest bursts, oldest first.
    bursts: heapless::Deque<Stamp, BURSTS>,
    /// When the latest message was received.
    latest_us: u64,
    /// The time of the last stall, in our time; earlier messages are not used.
    stalled_us: u64,
    /// When the newest bucket began, in our time.
    bucket_since: Instant,
    /// The estimated rate, in seconds of the vehicle per second of ours.
    rate: f64,
    /// The published mapping.
    published: Option<Published>,
}

#[derive(Clone, Copy, Debug)]
struct Published {
    ours_us: u64,
    vehicle_us: f64,
    rate: f64,
}

impl Published {
    fn vehicle_us(&self, ours_us: u64) -> f64 {
        let passed = if ours_us >= self.ours_us {
            (ours_us - self.ours_us) as f64
        } else {
            -((self.ours_us - ours_us) as f64)
        };
        self.vehicle_us + passed * self.rate
    }
}

impl Default for VehicleClock {
    fn default() -> Self {
        Self {
            buckets: heapless::Deque::new(),
            bursts: heapless::Deque::new(),
            latest_us: 0,
            stalled_us: 0,
            bucket_since: Instant::ZERO,
            rate: 1.0,
            published: None,
        }
    }
}

impl VehicleClock {
    /// Processes a message that was stamped `vehicle` by the vehicle and received at `now`. With
    /// `smooth` the published mapping does not jump.
    pub fn observe(&mut self, now: Instant, vehicle: Instant, smooth: bool) {
        let stamp = Stamp {
            vehicle_us: vehicle.as_micros(),
            ours_us: now.as_micros(),
        };
        let opens = self.buckets.is_empty() || now - self.bucket_since >= BUCKET;
        if opens {
            self.bucket_since = now;
            if self.buckets.is_full() {
                self.buckets.pop_front();
            }
            // Cannot be full: one was just taken out if it was.
            let _ = self.buckets.push_back(stamp);
            self.estimate_rate();
        } else if let Some(newest) = self.buckets.back_mut()
            && stamp.offset_us(self.rate) < newest.offset_us(self.rate)
        {
            *newest = stamp;
        }
        self.look_for_stall(stamp);
        self.publish(now, smooth);
    }

    /// Adds a message to the latest bursts, and discards earlier messages if they show a stall.
    fn look_for_stall(&mut self, stamp: Stamp) {
        let rate = self.rate;
        let continues = stamp.ours_us.saturating_sub(self.latest_us) < BURST.as_micros();
        self.latest_us = stamp.ours_us;
        match self.bursts.back_mut() {
            Some(burst) if continues => {
                if stamp.offset_us(rate) < burst.offset_us(rate) {
                    *burst = stamp;
                }
            }
            _ => {
                if self.bursts.is_full() {
                    self.bursts.pop_front();
                }
                // Cannot be full: one was just taken out if it was.
                let _ = self.bursts.push_back(stamp);
            }
        }
        let window_us = stamp.ours_us.saturating_sub(STALL_WINDOW.as_micros());
        let is_before = |burst: &Stamp| burst.ours_us <= window_us;
        while self.bursts.len() > STALL_BURSTS && self.bursts.iter().nth(1).is_some_and(is_before) {
            self.bursts.pop_front();
        }
        let shown = self.bursts.len() >= STALL_BURSTS && self.bursts.front().is_some_and(is_before);
        let least = self
            .bursts
            .iter()
            .min_by(|a, b| a.offset_us(rate).total_cmp(&b.offset_us(rate)));
        if let Some(&least) = least
            && shown
            && least.offset_us(rate) > self.offset_us() + STALL
        {
            self.stalled_us = least.ours_us;
            if let Some(newest) = self.buckets.back_mut() {
                *newest = least;
            }
        }
    }

    /// Returns when the vehicle's clock showed zero, in our time, from the message with the
    /// smallest delay.
    fn offset_us(&self) -> f64 {
        let recent = self.buckets.iter().rev().take(RECENT);
        recent
            .filter(|stamp| self.stalled_us <= stamp.ours_us)
            .map(|stamp| stamp.offset_us(self.rate))
            .fold(f64::INFINITY, f64::min)
    }

    /// Returns the vehicle's clock at `now`, or `None` before the first message.
    pub fn vehicle_time(&self, now: Instant) -> Option<Instant> {
        let vehicle_us = self.published?.vehicle_us(now.as_micros());
        // `as` saturates and sends NaN to 0.
        Some(Instant::from_micros(libm::round(vehicle_us) as u64))
    }

    /// Returns when the vehicle's clock shows `vehicle`, in our time, or `None` before the first
    /// message.
    pub fn our_time(&self, vehicle: Instant) -> Option<Instant> {
        let published = self.published?;
        let ahead = (vehicle.as_micros() as f64 - published.vehicle_us) / published.rate;
        let ours = published.ours_us as f64 + ahead;
        Some(Instant::from_micros(libm::ceil(ours) as u64))
    }

    /// Returns the estimated rate, in seconds of the vehicle per second of ours.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Returns when the vehicle's clock last lost time in a stall, in our time; zero if it never
    /// did.
    pub fn last_stall(&self) -> Instant {
        Instant::from_micros(self.stalled_us)
    }

    /// Estimates the rate as the median slope between points [`SLOPE`] buckets apart.
    fn estimate_rate(&mut self) {
        // The newest bucket has only one message so far, which may be late.
        let known = self.buckets.len().saturating_sub(1);
        if known < BUCKETS_FOR_RATE {
            return;
        }
        let mut slopes: heapless::Vec<f64, BUCKETS> = heapless::Vec::new();
        let later = self.buckets.iter().take(known).skip(SLOPE);
        for (earlier, later) in self.buckets.iter().zip(later) {
            let ours = later.ours_us.saturating_sub(earlier.ours_us) as f64;
            let vehicle = later.vehicle_us.saturating_sub(earlier.vehicle_us) as f64;
            // There are no more than BUCKETS slopes.
            let _ = slopes.push(vehicle / ours.max(1.0));
        }
        insertion_sort(&mut slopes, |a, b| a < b);
        if let Some(&median) = slopes.get(slopes.len() / 2)
            && RATES.contains(&median)
        {
            self.rate = median;
        }
    }

    fn publish(&mut self, now: Instant, smooth: bool) {
        let rate = self.rate;
        let ours_us = now.as_micros();
        let estimate_us = (ours_us as f64 - self.offset_us()) * rate;
        let known_us = self
            .published
            .map(|published| published.vehicle_us(ours_us));
        let (vehicle_us, rate) = match known_us {
            Some(known_us) if smooth && libm::fabs(estimate_us - known_us) <= STEP => {
                let behind_us = estimate_us - known_us;
                let correction = if behind_us < 0.0 {
                    (behind_us / CORRECTION_AHEAD).max(-SLEW_AHEAD)
                } else {
                    (behind_us / CORRECTION).min(SLEW)
                };
                (known_us, rate * (1.0 + correction))
            }
            _ => (estimate_us, rate),
        };
        self.published = Some(Published {
            ours_us,
            vehicle_us,
            rate,
        });
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn at(seconds: f64) -> Instant {
        Instant::ZERO + Duration::from_secs_f64(seconds)
    }

    fn seconds(instant: Instant) -> f64 {
        (instant - Instant::ZERO).as_secs_f64()
    }

    /// The largest error of the mapping in the second half of `seconds`, in seconds, with messages
    /// every 50 ms that are late by `delay`.
    fn worst_error_s(rate: f64, lasts_s: f64, mut delay: impl FnMut(f64) -> f64) -> f64 {
        let mut clock = VehicleClock::default();
        let (mut came, mut worst) = (0.0_f64, 0.0_f64);
        for n in 0..(lasts_s * 20.0) as u32 {
            let sent = 7.0 + f64::from(n) * 0.05;
            // In order, as a link delivers.
            came = (sent + delay(sent)).max(came + 1e-6);
            // The vehicle stamps whole milliseconds.
            let stamp = ((sent - 7.0) * rate * 1e3).floor() * 1e-3;
            clock.observe(at(came), at(stamp), sent > 20.0);
            if sent > 7.0 + lasts_s / 2.0 {
                let vehicle = clock.vehicle_time(at(came)).unwrap();
                let truth = (came - 7.0) * rate;
                worst = worst.max((seconds(vehicle) - truth).abs());
                let back = clock.our_time(vehicle).unwrap();
                assert!((seconds(back) - came).abs() < 1e-5);
            }
        }
        assert!((clock.rate() / rate - 1.0).abs() < 4e-3, "{}", clock.rate());
        worst
    }

    #[test]
    fn equal_clocks_without_delay_are_equal_to_the_microsecond() {
        let mut clock = VehicleClock::default();
        assert_eq!(clock.vehicle_time(at(1.0)), None);
        for n in 0..4_000 {
            let now = Instant::from_micros(n * 50_000);
            clock.observe(now, now, n > 200);
            let later = now + Duration::from_micros(12_345);
            assert_eq!(clock.vehicle_time(later), Some(later));
            assert_eq!(clock.our_time(later), Some(later));
        }
        assert_eq!(clock.rate(), 1.0);
    }

    /// ArduCopter's simulation makes up for at most 100 ms of a stall; the rest is lost. PX4's
    /// lost 150 ms on a busy machine. Small stalls are corrected smoothly.
    #[test]
    fn time_that_the_vehicle_lost_is_known_soon() {
        for lost_ms in [30, 60, 150, 516] {
            let mut clock = VehicleClock::default();
            for n in 0..2_000_u64 {
                let stalled_us = if n >= 1_200 { lost_ms * 1_000 } else { 0 };
                let (now, vehicle) = (n * 50_000 + stalled_us, n * 50_000);
                let (now, vehicle) = (Instant::from_micros(now), Instant::from_micros(vehicle));
                clock.observe(now, vehicle, true);
                let known = clock.vehicle_time(now).unwrap();
                let off = (known - vehicle) + (vehicle - known);
                // A small one cannot be told from messages that are late for a while.
                let known_after = if lost_ms > 50 { 10 } else { 4 * 20 };
                let settled = !(1_200..1_200 + known_after).contains(&n);
                assert!(
                    !settled || off < Duration::from_millis(20),
                    "{lost_ms} ms lost, message {n}: off by {off:?}"
                );
            }
            assert!((clock.rate() - 1.0).abs() < 1e-6, "{}", clock.rate());
        }
    }

    #[test]
    fn a_hiccup_shifts_nothing() {
        // 130 ms without a message, then all of them at once; and a whole second like that.
        for (begin, end) in [(60.0, 60.13), (60.0, 61.0)] {
            let late = |sent: f64| {
                if (begin..end).contains(&sent) {
                    end - sent
                } else {
                    0.0
                }
            };
            let worst = worst_error_s(0.99, 80.0, late);
            assert!(worst < 3e-3, "{worst}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: proptest::test_runner::RngSeed::Fixed(1),
            ..ProptestConfig::with_cases(100)
        })]

        /// Several per cent of rate, delays up to 40 ms, and every ten seconds one message that is
        /// up to a second late and holds up those behind it: right within a few milliseconds.
        #[test]
        fn offset_and_rate_are_found(rate in 0.93f64..1.07, seed: u64, most_s in 0.0f64..0.04) {
            let mut random = Pcg64Mcg::seed_from_u64(seed);
            let worst = worst_error_s(rate, 80.0, |_| {
                let late = if random.random_bool(0.005) { random.random_range(0.0..1.0) } else { 0.0 };
                late + random.random_range(0.0..=most_s)
            });
            prop_assert!(worst < 0.012, "{worst}");
        }
    }
}
