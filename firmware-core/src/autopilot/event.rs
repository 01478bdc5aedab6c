// SPDX-License-Identifier: MIT OR Apache-2.0
//! Events of the client, in the order in which they occurred.
//!
//! Events are data with a `Display` that describes them. The queue is bounded: when it is full the
//! oldest event is dropped and counted.

use core::fmt;

use heapless::{Deque, String};
use mavlink::dialects::common::MavResult;

use super::checks::Finding;
use super::command::{CommandOutcome, Request, result_name};
use super::failsafe::{Cause, Reaction};
use super::phase::{Obstacle, Phase};
use super::preflight::PreflightRefusal;
use super::profile::{Firmware, Mode};

/// An event of the client.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// The first heartbeat of the autopilot that is flown from now on was received.
    Connected {
        /// The system id of the autopilot.
        system: u8,
        /// The software of the autopilot.
        firmware: Firmware,
    },
    /// A new phase began.
    Phase(Phase),
    /// The checks wait for this condition.
    Waiting(Obstacle),
    /// The start is refused for a reason that does not go away by waiting.
    Refused(PreflightRefusal),
    /// The trial leg has shown that the airframe is slower than requested.
    SlowAirframe {
        /// The largest speed of the reference, m/s.
        asked_mps: f32,
        /// The largest measured speed, m/s.
        reached_mps: f32,
    },
    /// The checks have found something.
    Finding(Finding),
    /// The autopilot sent a text.
    Text {
        /// The severity, from 0 (emergency) to 7 (debug).
        severity: u8,
        /// The text.
        text: String<50>,
    },
    /// The mode changed.
    Mode {
        /// The software that defines the mode.
        firmware: Firmware,
        /// The new mode.
        mode: Mode,
    },
    /// The motors were armed or disarmed.
    Armed(bool),
    /// A command is repeated.
    Repeated {
        /// The command.
        request: Request,
        /// The number of times that it was sent before.
        attempts: u8,
        /// The last answer, if there was one.
        answer: Option<MavResult>,
    },
    /// A command was completed and not accepted.
    Failed {
        /// The command.
        request: Request,
        /// Its outcome.
        outcome: CommandOutcome,
    },
    /// A slot ended without a position sample taken after its end; the latest sample is used.
    SampleLate,
    /// A failure was detected.
    Failsafe {
        /// The failure.
        cause: Cause,
        /// The reaction to it.
        reaction: Reaction,
    },
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Connected { system, firmware } => {
                write!(f, "connected to {} (system {system})", firmware.name())
            }
            Self::Phase(phase) => write!(f, "{phase}"),
            Self::Waiting(obstacle) => write!(f, "waiting: {obstacle}"),
            Self::Refused(refusal) => write!(f, "not started: {refusal}"),
            Self::SlowAirframe {
                asked_mps,
                reached_mps,
            } => write!(
                f,
                "the airframe reached {reached_mps:.1} m/s, but {asked_mps:.1} m/s was requested"
            ),
            Self::Finding(finding) => write!(f, "{finding}"),
            Self::Text { text, .. } => write!(f, "autopilot: {text}"),
            Self::Mode { firmware, mode } => {
                write!(f, "mode {} ({})", firmware.mode_name(*mode), mode.0)
            }
            Self::Armed(true) => f.write_str("armed"),
            Self::Armed(false) => f.write_str("disarmed"),
            Self::Repeated {
                request,
                attempts,
                answer,
            } => {
                let why = answer.map_or("no answer", result_name);
                write!(f, "{request}: {why}, attempt {}", attempts + 1)
            }
            Self::Failed { request, outcome } => match outcome {
                CommandOutcome::Refused(result) => {
                    write!(f, "{request} refused: {}", result_name(*result))
                }
                _ => write!(f, "{request}: no answer, given up"),
            },
            Self::SampleLate => f.write_str("no position sample after the slot's end"),
            Self::Failsafe { cause, reaction } => write!(f, "FAILSAFE {cause}: {reaction}"),
        }
    }
}

/// The capacity of the queue.
const CAPACITY: usize = 24;

/// A bounded queue of events.
#[derive(Clone, Debug, Default)]
pub(super) struct Events {
    queue: Deque<Event, CAPACITY>,
    lost: u32,
}

impl Events {
    pub(super) fn push(&mut self, event: Event) {
        if self.queue.is_full() {
            self.queue.pop_front();
            self.lost = self.lost.saturating_add(1);
        }
        // Cannot be full: one was just taken out if it was.
        let _ = self.queue.push_back(event);
    }

    pub(super) fn take(&mut self) -> Option<Event> {
        self.queue.pop_front()
    }

    pub(super) fn lost(&self) -> u32 {
        self.lost
    }
}
