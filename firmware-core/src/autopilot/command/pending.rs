// SPDX-License-Identifier: MIT OR Apache-2.0
//! A command that was sent and not completed: when it is repeated, and when it is given up.

use mavlink::dialects::common::{COMMAND_ACK_DATA, COMMAND_LONG_DATA, MavResult};

use super::outcome::CommandOutcome;
use super::request::Request;
use crate::autopilot::profile::Firmware;
use crate::autopilot::wire::Address;
use crate::time::{Duration, Instant};

/// The time-outs and attempts of commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patience {
    /// The time without an answer after which a command is repeated.
    pub answer: Duration,
    /// The pause before a command that was temporarily refused is repeated.
    pub pause: Duration,
    /// The time that the final answer may take after "in progress".
    pub progress: Duration,
    /// The largest number of times that a command is sent.
    pub attempts: u8,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            answer: Duration::from_millis(700),
            pause: Duration::from_secs(1),
            progress: Duration::from_secs(20),
            attempts: 8,
        }
    }
}

/// A command that was not completed yet.
#[derive(Clone, Copy, Debug)]
pub(in crate::autopilot) struct Pending {
    pub(in crate::autopilot) request: Request,
    attempts: u8,
    /// The time at which it is sent next.
    due: Instant,
    last_refusal: Option<MavResult>,
    in_progress: bool,
}

/// What is to be done with a pending command at a given time.
pub(in crate::autopilot) enum Turn {
    /// Nothing to do yet.
    Wait,
    /// Send it with this value of `confirmation`.
    Send(u8),
    /// All attempts were used.
    Over(CommandOutcome),
}

impl Pending {
    pub(in crate::autopilot) fn new(now: Instant, request: Request) -> Self {
        Self {
            request,
            attempts: 0,
            due: now,
            last_refusal: None,
            in_progress: false,
        }
    }

    pub(in crate::autopilot) fn due(&self) -> Instant {
        self.due
    }

    pub(in crate::autopilot) fn was_sent(&self) -> bool {
        self.attempts > 0
    }

    pub(in crate::autopilot) fn last_refusal(&self) -> Option<MavResult> {
        self.last_refusal
    }

    pub(in crate::autopilot) fn turn(&self, now: Instant, patience: &Patience) -> Turn {
        if now < self.due {
            Turn::Wait
        } else if self.in_progress || self.attempts >= patience.attempts {
            Turn::Over(
                self.last_refusal
                    .map_or(CommandOutcome::Unanswered, CommandOutcome::Refused),
            )
        } else {
            Turn::Send(self.attempts)
        }
    }

    pub(in crate::autopilot) fn sent(&mut self, now: Instant, patience: &Patience) {
        self.attempts += 1;
        self.due = now + patience.answer;
        self.last_refusal = None;
    }

    pub(in crate::autopilot) fn message(
        &self,
        firmware: Firmware,
        to: Address,
    ) -> COMMAND_LONG_DATA {
        let [param1, param2, param3, param4, param5, param6, param7] =
            self.request.parameters(firmware);
        COMMAND_LONG_DATA {
            param1,
            param2,
            param3,
            param4,
            param5,
            param6,
            param7,
            command: self.request.command(),
            target_system: to.system,
            target_component: to.component,
            confirmation: self.attempts,
        }
    }

    /// Processes an acknowledgement. Returns `Some` when the command is completed.
    pub(in crate::autopilot) fn answer(
        &mut self,
        now: Instant,
        ack: &COMMAND_ACK_DATA,
        patience: &Patience,
    ) -> Option<CommandOutcome> {
        if ack.command != self.request.command() || self.attempts == 0 {
            return None;
        }
        match ack.result {
            MavResult::MAV_RESULT_ACCEPTED => Some(CommandOutcome::Accepted),
            MavResult::MAV_RESULT_IN_PROGRESS => {
                if !self.in_progress {
                    self.in_progress = true;
                    self.due = now + patience.progress;
                }
                None
            }
            // PX4's answer for a message whose interval cannot be set.
            MavResult::MAV_RESULT_FAILED
                if matches!(self.request, Request::MessageInterval { .. }) =>
            {
                Some(CommandOutcome::Refused(MavResult::MAV_RESULT_FAILED))
            }
            // A temporary refusal: checks that do not pass yet, a position that is not known yet.
            refusal @ (MavResult::MAV_RESULT_TEMPORARILY_REJECTED
            | MavResult::MAV_RESULT_FAILED) => {
                self.in_progress = false;
                self.last_refusal = Some(refusal);
                self.due = now + patience.pause;
                None
            }
            refusal => Some(CommandOutcome::Refused(refusal)),
        }
    }
}

#[cfg(test)]
mod tests {
    use mavlink::MessageData;
    use mavlink::dialects::common::{HEARTBEAT_DATA, MavCmd};

    use super::*;

    const PATIENCE: Patience = Patience {
        answer: Duration::from_millis(500),
        pause: Duration::from_secs(1),
        progress: Duration::from_secs(5),
        attempts: 3,
    };

    fn at(millis: u64) -> Instant {
        Instant::ZERO + Duration::from_millis(millis)
    }

    fn ack(command: MavCmd, result: MavResult) -> COMMAND_ACK_DATA {
        COMMAND_ACK_DATA {
            command,
            result,
            ..COMMAND_ACK_DATA::DEFAULT
        }
    }

    #[test]
    fn an_unanswered_command_is_repeated_with_confirmation_and_given_up() {
        let mut pending = Pending::new(at(0), Request::Arm);
        for n in 0..3 {
            let now = at(u64::from(n) * 500);
            assert!(matches!(pending.turn(now, &PATIENCE), Turn::Send(c) if c == n));
            pending.sent(now, &PATIENCE);
            assert!(matches!(pending.turn(now, &PATIENCE), Turn::Wait));
        }
        assert!(matches!(
            pending.turn(at(1500), &PATIENCE),
            Turn::Over(CommandOutcome::Unanswered)
        ));
    }

    #[test]
    fn refusals_are_final_or_not() {
        let arm = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;
        let mut pending = Pending::new(at(0), Request::Arm);
        let accepted = ack(arm, MavResult::MAV_RESULT_ACCEPTED);
        assert_eq!(
            pending.answer(at(0), &accepted, &PATIENCE),
            None,
            "not asked yet"
        );
        pending.sent(at(0), &PATIENCE);
        let other = ack(MavCmd::MAV_CMD_DO_SET_MODE, MavResult::MAV_RESULT_ACCEPTED);
        assert_eq!(pending.answer(at(1), &other, &PATIENCE), None);
        let later = ack(arm, MavResult::MAV_RESULT_FAILED);
        assert_eq!(pending.answer(at(1), &later, &PATIENCE), None);
        assert!(matches!(pending.turn(at(900), &PATIENCE), Turn::Wait));
        assert!(matches!(pending.turn(at(1001), &PATIENCE), Turn::Send(1)));
        pending.sent(at(1001), &PATIENCE);
        let denied = ack(arm, MavResult::MAV_RESULT_DENIED);
        assert_eq!(
            pending.answer(at(1100), &denied, &PATIENCE),
            Some(CommandOutcome::Refused(MavResult::MAV_RESULT_DENIED))
        );
    }

    /// PX4 answers so when it is asked for its heartbeat more often: asking again changes nothing.
    #[test]
    fn a_message_interval_that_failed_is_refused_for_good() {
        let request = Request::MessageInterval {
            message: HEARTBEAT_DATA::ID,
            interval: Duration::from_millis(200),
        };
        let mut pending = Pending::new(at(0), request);
        pending.sent(at(0), &PATIENCE);
        let failed = MavResult::MAV_RESULT_FAILED;
        let answer = ack(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, failed);
        let outcome = CommandOutcome::Refused(failed);
        assert_eq!(pending.answer(at(1), &answer, &PATIENCE), Some(outcome));
        let event = crate::autopilot::Event::Failed { request, outcome };
        assert_eq!(
            std::string::ToString::to_string(&event),
            "SET_MESSAGE_INTERVAL for HEARTBEAT refused: failed"
        );
    }

    #[test]
    fn in_progress_waits_once_and_not_for_ever() {
        let arm = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;
        let mut pending = Pending::new(at(0), Request::Arm);
        pending.sent(at(0), &PATIENCE);
        let progress = ack(arm, MavResult::MAV_RESULT_IN_PROGRESS);
        assert_eq!(pending.answer(at(100), &progress, &PATIENCE), None);
        assert_eq!(pending.answer(at(4000), &progress, &PATIENCE), None);
        assert!(matches!(pending.turn(at(5000), &PATIENCE), Turn::Wait));
        assert!(matches!(
            pending.turn(at(5100), &PATIENCE),
            Turn::Over(CommandOutcome::Unanswered)
        ));
    }
}
