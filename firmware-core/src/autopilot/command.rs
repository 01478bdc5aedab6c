//! Acknowledged commands, one at a time: sent, repeated, given up.
//!
//! Each command is repeated with a rising `confirmation` until its COMMAND_ACK is received. Whether
//! the command had its effect is decided elsewhere from the autopilot's *state* (mode, armed,
//! altitude), because an autopilot may accept a command and then not carry it out.

use core::fmt;

use mavlink::MessageData;
use mavlink::dialects::common::{
    COMMAND_ACK_DATA, COMMAND_LONG_DATA, CURRENT_MODE_DATA, ESTIMATOR_STATUS_DATA,
    EXTENDED_SYS_STATE_DATA, GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA,
    MavCmd, MavResult, SYS_STATUS_DATA,
};

use super::profile::{Firmware, Mode};
use super::wire::{Address, ekf_status_report};
use crate::time::{Duration, Instant};

/// A command to an autopilot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Send a message at this interval from now on.
    MessageInterval {
        /// Id of the message.
        message: u32,
        /// The interval.
        interval: Duration,
    },
    /// Send a message once.
    Message {
        /// Id of the message.
        message: u32,
    },
    /// Change the flight mode.
    SetMode(Mode),
    /// Let the motors turn.
    Arm,
    /// Stop the motors; refused in flight.
    Disarm,
    /// Rise to this height above the place of take-off, metres.
    TakeOff {
        /// Height, m.
        altitude_m: f32,
    },
    /// Land here.
    Land,
    /// Return to the place of take-off and land.
    Return,
    /// Fly the uploaded mission.
    StartMission,
}

impl Request {
    /// Returns the command's name for messages and logs.
    pub fn name(&self) -> &'static str {
        match self {
            Self::MessageInterval { .. } => "SET_MESSAGE_INTERVAL",
            Self::Message { .. } => "REQUEST_MESSAGE",
            Self::SetMode(_) => "DO_SET_MODE",
            Self::Arm => "arm",
            Self::Disarm => "disarm",
            Self::TakeOff { .. } => "NAV_TAKEOFF",
            Self::Land => "NAV_LAND",
            Self::Return => "NAV_RETURN_TO_LAUNCH",
            Self::StartMission => "MISSION_START",
        }
    }

    /// Returns whether the command can move the vehicle or its motors.
    pub fn moves(&self) -> bool {
        !matches!(self, Self::MessageInterval { .. } | Self::Message { .. })
    }

    fn command(&self) -> MavCmd {
        match self {
            Self::MessageInterval { .. } => MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            Self::Message { .. } => MavCmd::MAV_CMD_REQUEST_MESSAGE,
            Self::SetMode(_) => MavCmd::MAV_CMD_DO_SET_MODE,
            Self::Arm | Self::Disarm => MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
            Self::TakeOff { .. } => MavCmd::MAV_CMD_NAV_TAKEOFF,
            Self::Land => MavCmd::MAV_CMD_NAV_LAND,
            Self::Return => MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH,
            Self::StartMission => MavCmd::MAV_CMD_MISSION_START,
        }
    }

    /// Returns parameters 1 to 7. Unused ones are zero, never NaN: a NaN has crashed an autopilot.
    fn parameters(&self, firmware: Firmware) -> [f32; 7] {
        let mut p = [0.0; 7];
        match *self {
            Self::MessageInterval { message, interval } => {
                p[0] = message as f32;
                p[1] = interval.as_micros() as f32;
            }
            Self::Message { message } => p[0] = message as f32,
            Self::SetMode(mode) => {
                p[0] = 1.0; // the custom mode is what counts
                (p[1], p[2]) = firmware.mode_parameters(mode);
            }
            Self::Arm => p[0] = 1.0,
            Self::TakeOff { altitude_m } => p[6] = altitude_m,
            Self::Disarm | Self::Land | Self::Return | Self::StartMission => {}
        }
        p
    }
}

/// Returns the name of a message that the client asks for.
fn message_name(id: u32) -> Option<&'static str> {
    Some(match id {
        CURRENT_MODE_DATA::ID => CURRENT_MODE_DATA::NAME,
        ESTIMATOR_STATUS_DATA::ID => ESTIMATOR_STATUS_DATA::NAME,
        EXTENDED_SYS_STATE_DATA::ID => EXTENDED_SYS_STATE_DATA::NAME,
        GPS_GLOBAL_ORIGIN_DATA::ID => GPS_GLOBAL_ORIGIN_DATA::NAME,
        HEARTBEAT_DATA::ID => HEARTBEAT_DATA::NAME,
        LOCAL_POSITION_NED_DATA::ID => LOCAL_POSITION_NED_DATA::NAME,
        SYS_STATUS_DATA::ID => SYS_STATUS_DATA::NAME,
        ekf_status_report::ID => ekf_status_report::NAME,
        _ => return None,
    })
}

/// Writes the command's name and, where it concerns a message, the message's name.
impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        match *self {
            Self::MessageInterval { message, .. } | Self::Message { message } => {
                match message_name(message) {
                    Some(name) => write!(f, " for {name}"),
                    None => write!(f, " for message {message}"),
                }
            }
            _ => Ok(()),
        }
    }
}

/// The outcome of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CommandOutcome {
    /// Accepted by the autopilot.
    Accepted,
    /// Refused, with its last answer.
    Refused(MavResult),
    /// No answer to any of the attempts.
    Unanswered,
}

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
pub(super) struct Pending {
    pub(super) request: Request,
    attempts: u8,
    /// The time at which it is sent next.
    due: Instant,
    last_refusal: Option<MavResult>,
    in_progress: bool,
}

/// What is to be done with a pending command at a given time.
pub(super) enum Turn {
    /// Nothing to do yet.
    Wait,
    /// Send it with this value of `confirmation`.
    Send(u8),
    /// All attempts were used.
    Over(CommandOutcome),
}

impl Pending {
    pub(super) fn new(now: Instant, request: Request) -> Self {
        Self {
            request,
            attempts: 0,
            due: now,
            last_refusal: None,
            in_progress: false,
        }
    }

    pub(super) fn due(&self) -> Instant {
        self.due
    }

    pub(super) fn was_sent(&self) -> bool {
        self.attempts > 0
    }

    pub(super) fn last_refusal(&self) -> Option<MavResult> {
        self.last_refusal
    }

    pub(super) fn turn(&self, now: Instant, patience: &Patience) -> Turn {
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

    pub(super) fn sent(&mut self, now: Instant, patience: &Patience) {
        self.attempts += 1;
        self.due = now + patience.answer;
        self.last_refusal = None;
    }

    pub(super) fn message(&self, firmware: Firmware, to: Address) -> COMMAND_LONG_DATA {
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
    pub(super) fn answer(
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

/// Returns the text of a result.
pub(super) fn result_name(result: MavResult) -> &'static str {
    match result {
        MavResult::MAV_RESULT_ACCEPTED => "accepted",
        MavResult::MAV_RESULT_TEMPORARILY_REJECTED => "temporarily rejected",
        MavResult::MAV_RESULT_DENIED => "denied",
        MavResult::MAV_RESULT_UNSUPPORTED => "unsupported",
        MavResult::MAV_RESULT_FAILED => "failed",
        MavResult::MAV_RESULT_IN_PROGRESS => "in progress",
        MavResult::MAV_RESULT_CANCELLED => "cancelled",
        _ => "not in this form",
    }
}

#[cfg(test)]
mod tests {
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

    #[test]
    fn no_parameter_is_ever_not_a_number() {
        for firmware in [Firmware::Generic, Firmware::ArduCopter, Firmware::Px4] {
            for request in [
                Request::MessageInterval {
                    message: LOCAL_POSITION_NED_DATA::ID,
                    interval: Duration::from_micros(u64::MAX),
                },
                Request::SetMode(firmware.control_mode()),
                Request::TakeOff { altitude_m: 100.0 },
                Request::Arm,
                Request::Return,
            ] {
                assert!(request.parameters(firmware).iter().all(|p| p.is_finite()));
            }
        }
        assert_eq!(
            Request::SetMode(Firmware::Px4.control_mode()).parameters(Firmware::Px4)[..3],
            [1.0, 6.0, 0.0]
        );
    }
}
