// SPDX-License-Identifier: MIT OR Apache-2.0
//! Time as an argument.
//!
//! Nothing in this crate owns a clock: the caller passes the present [`Instant`]. On a
//! microcontroller it comes from a timer, in a simulation it is a counter. In a simulation that
//! runs X times faster than real time it advances X times faster, so that every time-out runs in
//! the vehicle's own time.

use core::ops::{Add, AddAssign, Div, Mul, Sub};

use serde::{Deserialize, Serialize};

/// A moment: microseconds since an arbitrary start, which is the same for all instants of a run.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Instant {
    micros: u64,
}

/// A span of time, never negative, in whole microseconds.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Duration {
    micros: u64,
}

/// The end of a slot, on the vehicle's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tick {
    /// The time, on the vehicle's clock.
    pub time: Instant,
    /// How much later the position became known, in vehicle time.
    pub lateness: Duration,
    /// No sample was received in time: the position is extrapolated from the last one with its
    /// velocity.
    pub extrapolated: bool,
    /// The estimated rate of the vehicle's clock, in its seconds per second of ours.
    pub clock_rate: f32,
}

impl Instant {
    /// The start of the run.
    pub const ZERO: Self = Self { micros: 0 };

    /// Creates the moment `micros` microseconds after the start.
    pub const fn from_micros(micros: u64) -> Self {
        Self { micros }
    }

    /// Returns the microseconds since the start.
    pub const fn as_micros(self) -> u64 {
        self.micros
    }

    /// Returns the whole milliseconds since the start, modulo 2^32: the form of MAVLink's
    /// `time_boot_ms`.
    pub const fn millis_wrapping(self) -> u32 {
        (self.micros / 1_000) as u32
    }

    /// Returns how long ago `earlier` was, or zero if it lies in the future.
    pub const fn duration_since(self, earlier: Self) -> Duration {
        Duration::from_micros(self.micros.saturating_sub(earlier.micros))
    }

    /// Returns the moment `span` before this one, or the start if that is later.
    pub const fn back(self, span: Duration) -> Self {
        Self::from_micros(self.micros.saturating_sub(span.micros))
    }
}

impl Duration {
    /// A span of length zero.
    pub const ZERO: Self = Self { micros: 0 };

    /// Creates a span from microseconds.
    pub const fn from_micros(micros: u64) -> Self {
        Self { micros }
    }

    /// Creates a span from milliseconds.
    pub const fn from_millis(millis: u64) -> Self {
        Self {
            micros: millis.saturating_mul(1_000),
        }
    }

    /// Creates a span from whole seconds.
    pub const fn from_secs(seconds: u64) -> Self {
        Self {
            micros: seconds.saturating_mul(1_000_000),
        }
    }

    /// Creates a span from seconds, rounded to the nearest microsecond. Negative numbers and NaN
    /// give zero; a number that is too large gives the longest span.
    pub fn from_secs_f64(seconds: f64) -> Self {
        // `as` saturates and sends NaN to 0.
        Self {
            micros: libm::round(seconds * 1e6) as u64,
        }
    }

    /// Returns the span in microseconds.
    pub const fn as_micros(self) -> u64 {
        self.micros
    }

    /// Returns the span in whole milliseconds, rounded down.
    pub const fn as_millis(self) -> u64 {
        self.micros / 1_000
    }

    /// Returns the span in seconds, exact to the microsecond for spans below 285 years.
    pub fn as_secs_f64(self) -> f64 {
        self.micros as f64 * 1e-6
    }

    /// Returns whether the span is zero.
    pub const fn is_zero(self) -> bool {
        self.micros == 0
    }

    /// Returns this span less `other`, or zero if `other` is longer.
    pub const fn saturating_sub(self, other: Self) -> Self {
        Self::from_micros(self.micros.saturating_sub(other.micros))
    }
}

impl Add<Duration> for Instant {
    type Output = Self;
    fn add(self, span: Duration) -> Self {
        Self::from_micros(self.micros.saturating_add(span.micros))
    }
}

impl AddAssign<Duration> for Instant {
    fn add_assign(&mut self, span: Duration) {
        *self = *self + span;
    }
}

impl Sub for Instant {
    type Output = Duration;
    /// As [`Instant::duration_since`]: the result is never negative.
    fn sub(self, earlier: Self) -> Duration {
        self.duration_since(earlier)
    }
}

impl Add for Duration {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::from_micros(self.micros.saturating_add(other.micros))
    }
}

impl Mul<u32> for Duration {
    type Output = Self;
    fn mul(self, factor: u32) -> Self {
        Self::from_micros(self.micros.saturating_mul(u64::from(factor)))
    }
}

impl Div<u32> for Duration {
    type Output = Self;
    /// Rounds down. A division by zero counts as a division by 1.
    fn div(self, divisor: u32) -> Self {
        Self::from_micros(self.micros / u64::from(divisor.max(1)))
    }
}

/// Conversions from and to embassy-time, which count microseconds from the start of its driver.
#[cfg(feature = "embassy-time")]
mod embassy {
    use super::{Duration, Instant};

    impl From<embassy_time::Instant> for Instant {
        fn from(instant: embassy_time::Instant) -> Self {
            Self::from_micros(instant.as_micros())
        }
    }

    /// Rounds down to a tick of the driver.
    impl From<Instant> for embassy_time::Instant {
        fn from(instant: Instant) -> Self {
            Self::from_micros(instant.as_micros())
        }
    }

    impl From<embassy_time::Duration> for Duration {
        fn from(duration: embassy_time::Duration) -> Self {
            Self::from_micros(duration.as_micros())
        }
    }

    /// Rounds up to a tick of the driver, so that no time-out becomes shorter.
    impl From<Duration> for embassy_time::Duration {
        fn from(duration: Duration) -> Self {
            Self::from_micros(duration.as_micros())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arithmetic_saturates() {
        let t = Instant::from_micros(10);
        assert_eq!(t - Instant::from_micros(20), Duration::ZERO);
        assert_eq!(t.back(Duration::from_secs(1)), Instant::ZERO);
        assert_eq!(
            Instant::from_micros(u64::MAX) + Duration::from_secs(1),
            Instant::from_micros(u64::MAX)
        );
        assert_eq!(Duration::from_secs(1) / 0, Duration::from_secs(1));
    }

    #[test]
    fn seconds_round_to_the_nearest_microsecond() {
        assert_eq!(Duration::from_secs_f64(0.1).as_micros(), 100_000);
        assert_eq!(Duration::from_secs_f64(1.0).as_secs_f64(), 1.0);
        assert_eq!(Duration::from_secs_f64(f64::NAN), Duration::ZERO);
        assert_eq!(Duration::from_secs_f64(-3.0), Duration::ZERO);
        assert_eq!(Duration::from_secs_f64(f64::INFINITY).as_micros(), u64::MAX);
    }

    #[test]
    fn mavlink_milliseconds_wrap() {
        let day_50 = Instant::from_micros(50 * 86_400 * 1_000_000);
        assert_eq!(day_50.millis_wrapping(), 25_032_704);
    }
}
