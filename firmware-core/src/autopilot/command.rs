//! One command at a time: sent, acknowledged, repeated, given up.
//!
//! Each command is repeated with a rising `confirmation` until its COMMAND_ACK comes. What the
//! acknowledgement means for the flight is judged elsewhere by the autopilot's *state* (mode,
//! armed, altitude), since an autopilot may accept what it then does not do.

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

/// What can be asked of an autopilot.
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
    /// The command's name, for people and logs.
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

    /// Whether it can move the vehicle or its motors.
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

    /// Parameters 1 to 7. Unused ones are zero, never NaN: a NaN has crashed an autopilot.
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

/// The command's name and, where it is about a message, the message's name.
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

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CommandOutcome {
    /// Accepted by the autopilot.
    Accepted,
    /// Refused, with its last answer.
    Refused(MavResult),
    /// No answer to any of the attempts.
    Unanswered,
}

/// How long to wait for answers and how often to ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patience {
    /// Without an answer for this long a command is repeated.
    pub answer: Duration,
    /// Pause before a command is repeated that was refused for now.
    pub pause: Duration,
    /// After "in progress" the final answer may take this long.
    pub progress: Duration,
    /// A command is sent at most this often.
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

/// A command under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pending {
    pub(super) request: Request,
    attempts: u8,
    /// When it is sent next (again).
    due: Instant,
    last_refusal: Option<MavResult>,
    in_progress: bool,
}

/// What came of looking at the clock.
pub(super) enum Turn {
    /// Nothing to do yet.
    Wait,
    /// Send it; the number is `confirmation`.
    Send(u8),
    /// Attempts are used up.
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

    /// Takes an acknowledgement; `Some` when the command is over.
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
            // PX4's answer for a message whose interval it does not let anybody set.
            MavResult::MAV_RESULT_FAILED
                if matches!(self.request, Request::MessageInterval { .. }) =>
            {
                Some(CommandOutcome::Refused(MavResult::MAV_RESULT_FAILED))
            }
            // "Not now": checks that do not pass yet, a position that is not there yet.
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

/// An answer in words.
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
