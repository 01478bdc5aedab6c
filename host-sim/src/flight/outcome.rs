//! How a flight ends when it does not end well.

use firmware_core::autopilot::SettingsError;
use link::NoHeartbeat;
use thiserror::Error;

use super::airframe::WrongProfile;
use crate::record::FlightRecord;

/// Why a mission was not flown to its end.
#[derive(Debug, Error)]
pub enum FlightError {
    /// A fixed power is above the mission's limit.
    #[error("{0}")]
    Allocation(String),
    /// The client's settings do not fit the mission.
    #[error("the mission cannot be flown: {0}")]
    Settings(#[from] SettingsError),
    /// The link failed.
    #[error("link: {0}")]
    Link(#[from] std::io::Error),
    /// The profile that was given is for another autopilot.
    #[error("{0}")]
    WrongProfile(#[from] WrongProfile),
    /// No autopilot at the other end.
    #[error("{0}")]
    NobodyThere(NoHeartbeat),
    /// The mission was broken off.
    #[error("broken off after {slots_done} of {slots} slots: {reason}")]
    BrokenOff {
        /// Slots that were done.
        slots_done: usize,
        /// `N`.
        slots: u32,
        /// What went wrong, in words.
        reason: String,
    },
    /// A person did not wait for the end.
    #[error("ended by a second ctrl-C after {slots_done} of {slots} slots, {state}")]
    Ended {
        /// Slots that were done.
        slots_done: usize,
        /// `N`.
        slots: u32,
        /// What was under way, in words.
        state: String,
    },
    /// The journal of an earlier run is about another vehicle.
    #[error(
        "{journal} holds parameters of another vehicle ({vehicle}) that were not put back; restore \
         them with host-sim doctor --restore, or choose another --out"
    )]
    WrongJournal {
        /// The file.
        journal: String,
        /// The vehicle it is about.
        vehicle: String,
    },
}

/// A flight that did not reach its end still leaves a record of what it did.
#[derive(Debug, Error)]
#[error("{error}")]
pub struct FailedFlight {
    /// Why.
    pub error: FlightError,
    /// What was flown of it; `None` if no vehicle was ever connected.
    pub record: Option<Box<FlightRecord>>,
}

/// A flight's outcome with the record that it leaves, if a vehicle was `connected`.
pub(super) fn outcome_with_record(
    outcome: Result<(), FlightError>,
    connected: bool,
    record: FlightRecord,
) -> Result<FlightRecord, FailedFlight> {
    match outcome {
        Ok(()) => Ok(FlightRecord {
            completed: true,
            ended: "landed".into(),
            ..record
        }),
        Err(error) => {
            let ended = match &error {
                FlightError::BrokenOff { reason, .. } => reason.clone(),
                other => other.to_string(),
            };
            let record = FlightRecord { ended, ..record };
            Err(FailedFlight {
                error,
                record: connected.then(|| Box::new(record)),
            })
        }
    }
}
