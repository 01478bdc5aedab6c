//! The errors that end a flight.

use firmware_core::autopilot::SettingsError;
use link::NoHeartbeat;
use thiserror::Error;

use super::airframe::WrongProfile;
use crate::record::FlightRecord;

/// The reason why a mission was not flown to its end.
#[derive(Debug, Error)]
pub enum FlightError {
    /// A fixed power is above the mission's limit.
    #[error("{0}")]
    Allocation(String),
    /// An event moves a node that moves by itself.
    #[error("events: {0}")]
    Events(String),
    /// The client's settings do not fit the mission.
    #[error("the mission cannot be flown: {0}")]
    Settings(#[from] SettingsError),
    /// The link failed.
    #[error("link: {0}")]
    Link(#[from] std::io::Error),
    /// The specified profile is for another autopilot.
    #[error("{0}")]
    WrongProfile(#[from] WrongProfile),
    /// There is no autopilot at the other end.
    #[error("{0}")]
    NoVehicle(NoHeartbeat),
    /// The mission was aborted.
    #[error("aborted after {slots_done} of {slots} slots: {reason}")]
    Aborted {
        /// The number of finished slots.
        slots_done: usize,
        /// `N`.
        slots: u32,
        /// The cause, in words.
        reason: String,
    },
    /// The user did not wait for the end.
    #[error("ended by a second ctrl-C after {slots_done} of {slots} slots, {state}")]
    Ended {
        /// The number of finished slots.
        slots_done: usize,
        /// `N`.
        slots: u32,
        /// The state of the flight, in words.
        state: String,
    },
    /// The journal of an earlier run belongs to another vehicle.
    #[error(
        "{journal} holds parameters of another vehicle ({vehicle}) that were not restored; restore \
         them with host-sim doctor --restore, or choose another --out"
    )]
    WrongJournal {
        /// The file.
        journal: String,
        /// The vehicle that the journal belongs to.
        vehicle: String,
    },
}

/// A flight that did not reach its end, with the record of what was flown.
#[derive(Debug, Error)]
#[error("{error}")]
pub struct FailedFlight {
    /// The reason.
    pub error: FlightError,
    /// The record of the flight; `None` if no vehicle was ever connected.
    pub record: Option<Box<FlightRecord>>,
}

/// An error before the vehicle was reached.
impl From<FlightError> for FailedFlight {
    fn from(error: FlightError) -> Self {
        Self {
            error,
            record: None,
        }
    }
}

/// Returns the outcome of a flight, with its record if a vehicle was `connected`.
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
                FlightError::Aborted { reason, .. } => reason.clone(),
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
