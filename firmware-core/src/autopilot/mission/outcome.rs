// SPDX-License-Identifier: MIT OR Apache-2.0
//! The outcome of an upload, and the mission that is on the autopilot after it.

use mavlink::dialects::common::MavMissionResult;
use thiserror::Error;

/// Error returned when an upload has failed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum UploadError {
    /// The autopilot stopped answering.
    #[error("no answer from the autopilot")]
    Unanswered,
    /// The autopilot refused the mission.
    #[error("the autopilot refused the mission ({0:?})")]
    Refused(MavMissionResult),
    /// An item that was read back differs from the one sent.
    #[error("item {0} read back differs from what was sent")]
    Different(u16),
    /// The autopilot has another number of items.
    #[error("{got} items read back, {sent} were sent")]
    Count {
        /// The number of items read back.
        got: u16,
        /// The number of items sent.
        sent: u16,
    },
    /// The caller cancelled the upload.
    #[error("cancelled")]
    Cancelled,
    /// The mission was uploaded, but not started.
    #[error("the mission was uploaded, but {0} failed")]
    NotStarted(&'static str),
}

/// The mission that is on the autopilot after a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// The old mission.
    Old,
    /// None: it was cleared, and the autopilot confirmed that.
    Nothing,
    /// The complete new mission.
    Whole,
    /// Unknown: the autopilot did not answer.
    Unknown,
}

/// The outcome of an upload.
pub type UploadOutcome = Result<(), (UploadError, Left)>;
