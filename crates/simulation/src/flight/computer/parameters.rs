//! The parameters of the vehicle that the client changes for a mission: they are written to a
//! journal before they are changed, and the flight is over only when they are restored or someone
//! was told that they are not.

use std::{collections::VecDeque, mem};

use firmware_core::{
    autopilot::{Autopilot, Event, Finding, failsafe::Cause},
    time::{Duration, Instant},
};

use super::Notice;
use crate::{
    flight::{outcome::FlightError, reason},
    journal::ParameterJournal,
};

/// The longest time that restoring the parameters may take once the flight is over and the motors
/// have stopped.
const RESTORE_PATIENCE: Duration = Duration::from_secs(30);

/// The changed parameters of a vehicle.
#[derive(Debug)]
pub(super) struct ChangedParameters {
    /// `None` if the vehicle is part of this process.
    journal: Option<ParameterJournal>,
    /// The parameters that an earlier run left changed have been processed.
    journal_read: bool,
    /// The reason why the journal could not be written.
    journal_failed: Option<String>,
    /// The client may change parameters.
    may_change: bool,
    /// The vehicle ends with this process, and its parameters with it.
    is_built_in: bool,
    /// The end of the flight.
    ended: Option<Instant>,
    /// The time at which the motors were first found stopped after the flight was over.
    disarmed: Option<Instant>,
    /// Whether the message that the vehicle must be disarmed first was shown.
    wait_said: bool,
}

impl ChangedParameters {
    pub(super) fn new(
        journal: Option<ParameterJournal>,
        may_change: bool,
        is_built_in: bool,
    ) -> Self {
        Self {
            journal,
            journal_read: false,
            journal_failed: None,
            may_change,
            is_built_in,
            ended: None,
            disarmed: None,
            wait_said: false,
        }
    }

    /// Returns the reason why nothing may be changed, if the journal could not be written.
    pub(super) fn journal_failed(&self) -> Option<String> {
        self.journal_failed.clone()
    }

    /// Makes the client first restore the parameters that an earlier run left changed, and records
    /// each change. Call it before the client is asked for the message that makes the change.
    pub(super) fn keep_journal(
        &mut self,
        now: Instant,
        client: &mut Autopilot<f64>,
        notices: &mut VecDeque<Notice>,
    ) -> Result<(), FlightError> {
        let Some((journal, (address, firmware))) = self.journal.as_mut().zip(client.vehicle())
        else {
            return Ok(());
        };
        if !mem::replace(&mut self.journal_read, true) && !journal.is_empty() {
            let (names, file) = (journal.names(), journal.path().display());
            if journal.fits(address.system, firmware) {
                notices.push_back(Notice::Waiting(format!(
                    "restoring {names}, which an earlier run left changed ({file})"
                )));
                client.restore_first(&journal.changes());
            } else if self.may_change {
                return Err(FlightError::WrongJournal {
                    journal: file.to_string(),
                    vehicle: journal.vehicle(),
                });
            } else {
                notices.push_back(Notice::Note(format!(
                    "{file} holds parameters of another vehicle ({}): {names}",
                    journal.vehicle()
                )));
            }
        }
        if self.journal_failed.is_none()
            && let Err(error) =
                journal.note((address.system, firmware), client.changed_parameters())
        {
            let file = journal.path().display();
            self.journal_failed = Some(format!("{file}: {error}; nothing is changed without it"));
            client.stop(now);
        }
        Ok(())
    }

    /// Takes restored parameters out of the journal. Returns what the user must do because of an
    /// event.
    pub(super) fn note_event(&mut self, event: &Event) -> Option<Notice> {
        match (event, &mut self.journal) {
            (Event::Finding(left @ Finding::NotRestored { .. }), _) => {
                Some(Notice::Duty(left.to_string()))
            }
            (Event::Finding(Finding::Restored { name, .. }), Some(journal)) => {
                let error = journal.restored(name).err()?;
                let file = journal.path().display();
                Some(Notice::Duty(format!("{file}: {error}")))
            }
            _ => None,
        }
    }

    /// Returns whether nothing is left to do after the flight: its reason was received, and the
    /// parameters that were set are restored, or restoring them was abandoned and reported. If
    /// someone else flies the vehicle, this waits without limit, because parameters are only
    /// changed while the vehicle is disarmed.
    pub(super) fn are_finished(
        &mut self,
        now: Instant,
        client: &mut Autopilot<f64>,
        stop_asked: bool,
        notices: &mut VecDeque<Notice>,
    ) -> bool {
        let ended = *self.ended.get_or_insert(now);
        let taken = matches!(
            client.fault(),
            Some(Cause::ControlTaken(_) | Cause::Disarmed)
        );
        if taken && now.duration_since(ended) < reason::AFTER && !stop_asked {
            return false;
        }
        if client.is_restored() {
            return true;
        }
        let given_up = if self.is_built_in {
            now.duration_since(ended) > RESTORE_PATIENCE
        } else if client.is_link_dead(now) {
            true
        } else if client.is_armed() {
            self.disarmed = None;
            if !mem::replace(&mut self.wait_said, true) && !stop_asked {
                let names = client.changed_parameters().iter();
                let names: Vec<&str> = names.map(|change| change.name).collect();
                notices.push_back(Notice::Waiting(format!(
                    "waiting for the vehicle to be disarmed before restoring {}; ctrl-C ends \
                     this, and `host-sim doctor --restore` restores them later",
                    names.join(", ")
                )));
            }
            stop_asked
        } else {
            let disarmed = *self.disarmed.get_or_insert(now);
            now.duration_since(disarmed) > RESTORE_PATIENCE
        };
        if given_up {
            client.abandon_parameters();
        }
        given_up
    }

    /// Returns which file contains the parameters that were not restored, in words.
    pub(super) fn left_over(&self) -> Option<String> {
        let journal = self
            .journal
            .as_ref()
            .filter(|journal| !journal.is_empty())?;
        Some(format!(
            "{} holds the parameters that were not restored ({}): `host-sim doctor --restore \
             --journal {0}`, or the next run with the same --out, restores them",
            journal.path().display(),
            journal.names()
        ))
    }
}
