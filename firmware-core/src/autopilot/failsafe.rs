// SPDX-License-Identifier: MIT OR Apache-2.0
//! Failures in flight, how they are detected, and the reactions to them.
//!
//! The single table [`TABLE`] defines them; `docs/failsafes.md` prints it, and a test keeps the two
//! equal. Three rules always apply: after the pilot (or the autopilot itself) took over, nothing is
//! sent any more that could move the vehicle; after a failsafe the vehicle is never armed again;
//! while the vehicle's position is unknown, no setpoint is sent.

use core::fmt;

use super::profile::Mode;
use crate::scalar::Scalar;
use crate::time::Duration;

/// A failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Cause {
    /// No heartbeat of the autopilot was received.
    HeartbeatLost,
    /// No heartbeat was received for a long time after [`Cause::HeartbeatLost`].
    LinkDead,
    /// No position sample was received.
    PositionLost,
    /// The position changed faster than an aircraft can fly.
    PositionJumped,
    /// In several legs in a row the vehicle did not move where it was sent.
    SetpointsIgnored,
    /// The mode is no longer the one we set: the pilot, or a failsafe of the autopilot, changed it.
    ControlTaken(Mode),
    /// The motors stopped in flight.
    Disarmed,
    /// The charge of the battery is too low.
    BatteryLow,
    /// The vehicle is outside the geofence.
    FenceBreached,
    /// No channel state of the ground was taken.
    GroundSilent,
    /// The next leg was not commanded in time.
    SlotOverrun,
    /// A person asked to stop (ctrl-C).
    StopAsked,
    /// A command that is necessary for the flight was refused or never answered.
    CommandFailed,
    /// A stage of the start took too long.
    StageTimedOut,
    /// The trial leg has shown that the airframe cannot reach the destination in time.
    TooSlow,
}

/// The reaction to a failure in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Reaction {
    /// Send nothing that moves the vehicle, ever again; our heartbeat continues.
    Release,
    /// Send nothing at all, not even the heartbeat, until the autopilot is heard again; then land.
    Silence,
    /// Send NAV_LAND at the present position.
    Land,
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct FailsafeRow {
    /// The failure; the fields of its variant are placeholders.
    pub cause: Cause,
    /// The condition that is checked, and for how long.
    pub detected: &'static str,
    /// The reaction in flight.
    pub reaction: Reaction,
    /// How the flight ends.
    pub ends: &'static str,
}

/// The failsafe table.
pub static TABLE: [FailsafeRow; 15] = [
    FailsafeRow {
        cause: Cause::HeartbeatLost,
        detected: "no heartbeat of the selected autopilot for `heartbeat` (5 s; with PX4, which sends one a second, 10 s), or nothing at all for 5 s",
        reaction: Reaction::Silence,
        ends: "the autopilot's own link failsafe; if it is heard again, still in our mode: NAV_LAND",
    },
    FailsafeRow {
        cause: Cause::LinkDead,
        detected: "no heartbeat for `link_dead` (20 s) more, in flight, while landing or while starting",
        reaction: Reaction::Release,
        ends: "the flight of the client is over; the vehicle flies by its own link failsafe",
    },
    FailsafeRow {
        cause: Cause::PositionLost,
        detected: "no new position sample for `position` (1.5 s)",
        reaction: Reaction::Land,
        ends: "landed and disarmed",
    },
    FailsafeRow {
        cause: Cause::PositionJumped,
        detected: "two samples further apart than `jump_m` (60 m) plus twice the speed limit times their time",
        reaction: Reaction::Land,
        ends: "landed and disarmed",
    },
    FailsafeRow {
        cause: Cause::SetpointsIgnored,
        detected: "`ignored_legs` (6) legs in a row of which less than a tenth was flown",
        reaction: Reaction::Land,
        ends: "landed and disarmed",
    },
    FailsafeRow {
        cause: Cause::ControlTaken(Mode(0)),
        detected: "a heartbeat with another mode than the one we set",
        reaction: Reaction::Release,
        ends: "with the pilot; control is never taken back",
    },
    FailsafeRow {
        cause: Cause::Disarmed,
        detected: "a heartbeat in flight that reports disarmed motors",
        reaction: Reaction::Release,
        ends: "on the ground",
    },
    FailsafeRow {
        cause: Cause::BatteryLow,
        detected: "SYS_STATUS.battery_remaining below `battery_percent` (20 %) for `battery` (2 s)",
        reaction: Reaction::Land,
        ends: "landed and disarmed",
    },
    FailsafeRow {
        cause: Cause::FenceBreached,
        detected: "a position sample more than `fence_margin_m` (10 m) outside the geofence",
        reaction: Reaction::Land,
        ends: "landed and disarmed",
    },
    FailsafeRow {
        cause: Cause::GroundSilent,
        detected: "no channel state taken from the ground link for `ground` during the legs (off unless set; `host-sim run`: ten slots, 10 s at least)",
        reaction: Reaction::Land,
        ends: "landed and disarmed",
    },
    FailsafeRow {
        cause: Cause::SlotOverrun,
        detected: "the reference comes to rest one setpoint after a leg's end; no new leg for `overrun` (10 s)",
        reaction: Reaction::Land,
        ends: "landed and disarmed",
    },
    FailsafeRow {
        cause: Cause::StopAsked,
        detected: "ctrl-C, or a call of `stop`",
        reaction: Reaction::Land,
        ends: "landed and disarmed",
    },
    FailsafeRow {
        cause: Cause::CommandFailed,
        detected: "refused for good, or `attempts` (8) without an answer",
        reaction: Reaction::Land,
        ends: "landed and disarmed, or never taken off",
    },
    FailsafeRow {
        cause: Cause::StageTimedOut,
        detected: "a stage of the start longer than `stage` (180 s)",
        reaction: Reaction::Land,
        ends: "landed and disarmed, or never taken off",
    },
    FailsafeRow {
        cause: Cause::TooSlow,
        detected: "the speed measured in the trial leg before the first slot is lower than the straight path to the destination needs",
        reaction: Reaction::Land,
        ends: "flown back to the start, landed and disarmed",
    },
];

impl Cause {
    /// Returns the row of the table for this cause.
    pub fn row(&self) -> &'static FailsafeRow {
        let same = |row: &&FailsafeRow| {
            core::mem::discriminant(&row.cause) == core::mem::discriminant(self)
        };
        // Every cause has its row (verified by a test); the last one is the fallback.
        TABLE.iter().find(same).unwrap_or(&TABLE[TABLE.len() - 1])
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::HeartbeatLost => "autopilot heartbeat lost",
            Self::LinkDead => "link dead",
            Self::PositionLost => "position lost",
            Self::PositionJumped => "position jumped",
            Self::SetpointsIgnored => "setpoints ignored",
            Self::ControlTaken(_) => "control taken by the pilot or the autopilot",
            Self::Disarmed => "disarmed in flight",
            Self::BatteryLow => "battery low",
            Self::FenceBreached => "outside the geofence",
            Self::GroundSilent => "ground link silent",
            Self::SlotOverrun => "no new leg after a slot's end",
            Self::StopAsked => "stop requested",
            Self::CommandFailed => "a needed command failed",
            Self::StageTimedOut => "a stage took too long",
            Self::TooSlow => "the airframe is too slow for the mission",
        })
    }
}

impl fmt::Display for Reaction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Release => "release control",
            Self::Silence => "fall silent",
            Self::Land => "land",
        })
    }
}

/// The thresholds and time-outs of the failsafe table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Watch<T> {
    /// The longest time without a heartbeat.
    pub heartbeat: Duration,
    /// The silence after [`Watch::heartbeat`] has passed until the flight is given up.
    pub link_dead: Duration,
    /// The longest time without a position sample.
    pub position: Duration,
    /// The smallest change of position that counts as a jump, m.
    pub jump_m: T,
    /// The number of legs in a row that were not flown.
    pub ignored_legs: u8,
    /// The charge below which the battery is too low, percent.
    pub battery_percent: i8,
    /// The time for which the charge must be below that.
    pub battery: Duration,
    /// The distance outside the geofence that counts as a breach, m.
    pub fence_margin_m: T,
    /// The longest time without a channel state of the ground that was taken, from the first leg on;
    /// `None` if it is not supervised.
    pub ground: Option<Duration>,
    /// The longest time without a new leg.
    pub overrun: Duration,
    /// The longest stage of the start (checks, arming, climb, flight to the start).
    pub stage: Duration,
}

impl<T: Scalar> Default for Watch<T> {
    fn default() -> Self {
        Self {
            heartbeat: Duration::from_secs(5),
            link_dead: Duration::from_secs(20),
            position: Duration::from_millis(1500),
            jump_m: T::of(60.0),
            ignored_legs: 6,
            battery_percent: 20,
            battery: Duration::from_secs(2),
            fence_margin_m: T::of(10.0),
            ground: None,
            overrun: Duration::from_secs(10),
            stage: Duration::from_secs(180),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cause_has_one_row_of_its_own() {
        for (i, row) in TABLE.iter().enumerate() {
            let found = core::ptr::from_ref(row.cause.row());
            assert_eq!(found, core::ptr::from_ref(&TABLE[i]), "{}", row.cause);
        }
    }
}
