// SPDX-License-Identifier: MIT OR Apache-2.0
//! The time in a signature.

use serde::{Deserialize, Serialize};

/// 2015-01-01 00:00 UTC, microseconds since 1970.
const EPOCH_US: u64 = 1_420_070_400_000_000;
/// 2100-01-01 00:00 UTC, microseconds since 1970: no clock is right that shows a later date.
const DATES_END_US: u64 = 4_102_444_800_000_000;
/// The length of a unit, microseconds.
const UNIT_US: u64 = 10;
/// A frame may be behind the local time by this, in units: one minute.
const BEHIND: u64 = 6_000_000;

/// A time in a signature: 48 bits, in units of 10 us since 2015-01-01 00:00 UTC.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(try_from = "u64", into = "u64")]
pub struct SigningTime(u64);

/// Error returned for a number that is not a time of signatures because it has more than 48 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} is not a time of a signature, which has 48 bits")]
pub struct TimeError(pub u64);

impl SigningTime {
    /// The time of a device that knows none: the earliest.
    pub const UNKNOWN: Self = Self(0);
    /// The latest time, in 2104.
    pub const LAST: Self = Self((1 << 48) - 1);

    /// Returns the time of a date, microseconds since 1970. Returns `None` before 2015 (a clock
    /// that was not set yet) and from 2100 on, so that no clock, however wrong, can use up the times
    /// until [`LAST`](Self::LAST).
    pub const fn from_unix_us(unix_us: u64) -> Option<Self> {
        if unix_us >= EPOCH_US && unix_us < DATES_END_US {
            return Some(Self((unix_us - EPOCH_US) / UNIT_US));
        }
        None
    }

    /// Returns the time with this number of units.
    ///
    /// # Errors
    /// Returns an error if the number has more than 48 bits.
    pub const fn from_units(units: u64) -> Result<Self, TimeError> {
        if units > Self::LAST.0 {
            return Err(TimeError(units));
        }
        Ok(Self(units))
    }

    /// Returns the number of units of 10 us since 2015.
    pub const fn units(self) -> u64 {
        self.0
    }

    /// Returns the next time; [`LAST`](Self::LAST) stays what it is.
    pub(super) fn next(self) -> Self {
        Self(self.0 + 1).min(Self::LAST)
    }

    /// Returns whether a frame of this time is too old at the local time `now`.
    pub(super) fn is_stale(self, now: Self) -> bool {
        self.0 + BEHIND < now.0
    }

    /// Returns the first local time at which a frame of this time is too old.
    pub(super) fn stale_from(self) -> Self {
        Self(self.0 + BEHIND + 1).min(Self::LAST)
    }
}

impl TryFrom<u64> for SigningTime {
    type Error = TimeError;

    fn try_from(units: u64) -> Result<Self, TimeError> {
        Self::from_units(units)
    }
}

impl From<SigningTime> for u64 {
    fn from(time: SigningTime) -> Self {
        time.0
    }
}
