// SPDX-License-Identifier: MIT OR Apache-2.0
//! The outcome of a command.

use mavlink::dialects::common::MavResult;

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

/// Returns the text of a result.
pub(in crate::autopilot) fn result_name(result: MavResult) -> &'static str {
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
