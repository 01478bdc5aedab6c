//! What the client has to say, in the order it happened.
//!
//! Events are data with a `Display` that puts them into words; the queue is bounded, and when
//! nobody takes them the oldest go, counted.

use core::fmt;

use heapless::{Deque, String};
use mavlink::dialects::common::MavResult;

use super::checks::Finding;
use super::command::{CommandOutcome, Request, result_name};
use super::failsafe::{Cause, Reaction};
use super::preflight::PreflightRefusal;
use super::profile::{Firmware, Mode};
use super::{Obstacle, Phase};

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The first heartbeat of the autopilot that is flown from now on.
    Connected {
        /// Its system id.
        system: u8,
        /// Its software.
        firmware: Firmware,
    },
    /// A new phase began.
    Phase(Phase),
    /// What the checks wait for.
    Waiting(Obstacle),
    /// The start is refused: what does not fit cannot be cured by waiting.
    Refused(PreflightRefusal),
    /// The trial leg has shown that the airframe is slower than it was told to fly.
    SlowAirframe {
        /// The largest speed of the reference, m/s.
        asked_mps: f32,
        /// The largest that was measured, m/s.
        reached_mps: f32,
    },
    /// What the checks found.
    Finding(Finding),
    /// The autopilot says something itself.
    Text {
        /// 0 emergency to 7 debug.
        severity: u8,
        /// Its words.
        text: String<50>,
    },
    /// The mode changed.
    Mode {
        /// Whose modes.
        firmware: Firmware,
        /// The new one.
        mode: Mode,
    },
    /// Motors on or off.
    Armed(bool),
    /// A command is sent once more.
    Repeated {
        /// Which.
        request: Request,
        /// How often it was sent before.
        attempts: u8,
        /// The last answer, if there was one.
        answer: Option<MavResult>,
    },
    /// A command is over and was not accepted.
    Failed {
        /// Which.
        request: Request,
        /// How it ended.
        outcome: CommandOutcome,
    },
    /// A slot ended without a position sample taken after its end; the latest one counts.
    SampleLate,
    /// Something went wrong, and this is done about it.
    Failsafe {
        /// What.
        cause: Cause,
        /// What is done.
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
                "the airframe reached {reached_mps:.1} m/s where {asked_mps:.1} m/s were asked for"
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

/// Room for events that were not taken yet.
const CAPACITY: usize = 24;

/// The queue.
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
