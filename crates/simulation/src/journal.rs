//! The parameters that a run changed in a vehicle and has not restored yet, in a file next to its
//! report.
//!
//! The file is written before the first parameter is changed and deleted when all have their former
//! values. If the run ends in between for any reason (a crash, a dead link, a user who does not
//! wait), the next run with the same `--out`, or `host-sim doctor --restore`, restores the
//! parameters.

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use firmware_core::{
    autopilot::{Autopilot, ChangedParameter, Event, Finding, Phase, profile::Firmware},
    time::Duration,
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::flight::CONNECT_PATIENCE;
use crate::session::Session;
use files::{input, output};
use link::NoHeartbeat;

/// The name of the file next to a run's report.
pub const FILE_NAME: &str = "parameters.journal.json";

/// The longest time that restoring the parameters may take once the motors have stopped.
const RESTORE_PATIENCE: Duration = Duration::from_secs(30);

/// The contents of the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Contents {
    /// The vehicle's MAVLink system id.
    system: u8,
    /// The vehicle's software, by name.
    autopilot: String,
    /// The link on which the vehicle was connected.
    link: String,
    /// The changed parameters, oldest first.
    parameters: Vec<Entry>,
}

/// A parameter that must be restored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Entry {
    name: String,
    /// The former value in readable form.
    value: String,
    /// The bits of the former value on the wire.
    bits: u32,
    /// The number of its MAV_PARAM_TYPE.
    kind: u8,
}

/// The journal of this run or of the previous one.
#[derive(Clone, Debug)]
pub struct ParameterJournal {
    path: PathBuf,
    link: String,
    contents: Contents,
}

impl ParameterJournal {
    /// Opens the journal in this file; it is empty if there is no file. `link` is stored with the
    /// changes from now on.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read or is not a journal; the message names the file.
    pub fn open(path: &Path, link: &str) -> io::Result<Self> {
        let named =
            |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
        let contents = match input::read(path) {
            Ok(bytes) => serde_json::from_slice(&bytes)
                .map_err(|error| named(io::Error::new(io::ErrorKind::InvalidData, error)))?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Contents::default(),
            Err(error) => return Err(named(error)),
        };
        Ok(Self {
            path: path.to_owned(),
            link: link.to_owned(),
            contents,
        })
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns whether there is nothing to restore.
    pub fn is_empty(&self) -> bool {
        self.contents.parameters.is_empty()
    }

    /// Returns the names of the parameters to restore, separated by commas.
    pub fn names(&self) -> String {
        let names = self.contents.parameters.iter();
        names
            .map(|entry| entry.name.as_str())
            .collect::<Vec<_>>()
            .join(", ")
    }

    /// Returns a description of the vehicle that the parameters belong to.
    pub fn vehicle(&self) -> String {
        let contents = &self.contents;
        let (autopilot, system) = (&contents.autopilot, contents.system);
        format!("{autopilot}, system {system}, at {}", contents.link)
    }

    /// Returns whether the parameters belong to this vehicle. An empty journal fits every vehicle.
    pub fn fits(&self, system: u8, firmware: Firmware) -> bool {
        let contents = &self.contents;
        self.is_empty() || (contents.system == system && contents.autopilot == firmware.name())
    }

    /// Returns the parameters to restore, oldest first. Parameters that the client does not know
    /// are left out.
    pub fn changes(&self) -> Vec<ChangedParameter> {
        let entries = self.contents.parameters.iter();
        entries
            .filter_map(|entry| ChangedParameter::noted(&entry.name, entry.bits, entry.kind))
            .collect()
    }

    /// Stores parameters that are about to be changed, unless they are stored already. The first
    /// entry of a parameter is kept: it is the value before any change.
    ///
    /// # Errors
    /// Returns an error if the file cannot be written; the parameter must not be changed then.
    pub fn note(
        &mut self,
        (system, firmware): (u8, Firmware),
        changed: &[ChangedParameter],
    ) -> io::Result<()> {
        let contents = &mut self.contents;
        let before = contents.parameters.len();
        for change in changed {
            if contents.parameters.iter().all(|e| e.name != change.name) {
                contents.parameters.push(Entry {
                    name: change.name.into(),
                    value: change.value(firmware).to_string(),
                    bits: change.was.to_bits(),
                    kind: change.kind as u8,
                });
            }
        }
        if contents.parameters.len() == before {
            return Ok(());
        }
        contents.system = system;
        contents.autopilot = firmware.name().into();
        contents.link.clone_from(&self.link);
        self.save()
    }

    /// Removes a parameter that has been restored; the file is deleted with the last one.
    ///
    /// # Errors
    /// Returns an error if the file cannot be written or deleted.
    pub fn restored(&mut self, name: &str) -> io::Result<()> {
        let before = self.contents.parameters.len();
        self.contents.parameters.retain(|entry| entry.name != name);
        match self.contents.parameters.len() {
            after if after == before => Ok(()),
            0 => fs::remove_file(&self.path),
            _ => self.save(),
        }
    }

    /// Writes the file in such a way that a crash leaves either the old file or the new one.
    fn save(&self) -> io::Result<()> {
        let mut json = serde_json::to_vec_pretty(&self.contents)?;
        json.push(b'\n');
        output::write(&self.path, &json)
    }
}

/// The reason why parameters were not restored.
#[derive(Debug, Error)]
pub enum FailedRestore {
    /// The link failed, or the journal could not be written.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// No autopilot was received.
    #[error("{0}")]
    NoHeartbeat(NoHeartbeat),
    /// Another vehicle answered.
    #[error("{journal} belongs to another vehicle ({vehicle}); nothing was changed")]
    WrongVehicle {
        /// The file.
        journal: String,
        /// The vehicle that the file belongs to.
        vehicle: String,
    },
    /// Some parameters still have the values that the run set.
    #[error("not restored: {names}; they remain in {journal}")]
    Left {
        /// Their names.
        names: String,
        /// The file.
        journal: String,
    },
}

/// Restores the parameters in `journal` as soon as the vehicle is disarmed, however long that
/// takes, and reports meanwhile what it waits for. Also ends when `stop` is set or the link is
/// dead.
///
/// # Errors
/// Returns the reason if parameters were not restored; they stay in the journal.
pub fn restore(
    session: &mut Session,
    client: &mut Autopilot<f64>,
    journal: &mut ParameterJournal,
    stop: &AtomicBool,
    mut say: impl FnMut(&str),
) -> Result<(), FailedRestore> {
    let begin = session.now();
    while client.vehicle().is_none() {
        if session.now() - begin >= CONNECT_PATIENCE || stop.load(Ordering::Relaxed) {
            return Err(FailedRestore::NoHeartbeat(session.silence(begin)));
        }
        session.turn(client, |_, _, _| {})?;
    }
    let file = journal.path().display().to_string();
    if let Some((address, firmware)) = client.vehicle()
        && !journal.fits(address.system, firmware)
    {
        return Err(FailedRestore::WrongVehicle {
            journal: file,
            vehicle: journal.vehicle(),
        });
    }
    client.restore_first(&journal.changes());
    let (mut disarmed, mut said) = (None, false);
    while !client.is_restored() && !stop.load(Ordering::Relaxed) {
        let now = session.now();
        if client.is_link_dead(now) {
            break;
        }
        if client.is_armed() {
            disarmed = None;
            if !std::mem::replace(&mut said, true) {
                let names = journal.names();
                say(&format!(
                    "waiting for the vehicle to be disarmed to restore {names}"
                ));
            }
        } else if now - *disarmed.get_or_insert(now) > RESTORE_PATIENCE
            && client.phase() != Phase::Connecting
        {
            break;
        }
        session.turn(client, |_, _, _| {})?;
        while let Some(event) = client.take_next_event() {
            if let Event::Finding(finding) = &event {
                match finding {
                    Finding::Restored { name, .. } => {
                        say(&finding.to_string());
                        journal.restored(name)?;
                    }
                    Finding::NotRestored { .. } => say(&finding.to_string()),
                    _ => {}
                }
            }
        }
    }
    if journal.is_empty() {
        return Ok(());
    }
    Err(FailedRestore::Left {
        names: journal.names(),
        journal: file,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const VEHICLE: (u8, Firmware) = (1, Firmware::ArduCopter);

    fn change(name: &str, value: f32) -> ChangedParameter {
        // MAV_PARAM_TYPE_REAL32.
        ChangedParameter::noted(name, value.to_bits(), 9).unwrap()
    }

    #[test]
    fn it_keeps_the_first_value_until_all_are_restored() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        let open = || ParameterJournal::open(&path, "udpout:host:14550").unwrap();
        let mut journal = open();
        assert!(journal.is_empty() && journal.fits(7, Firmware::Px4));
        journal.note(VEHICLE, &[]).unwrap();
        assert!(!path.exists(), "nothing is changed yet");
        let speed = change("WPNAV_SPEED", 1000.0);
        journal.note(VEHICLE, &[speed]).unwrap();
        journal
            .note(VEHICLE, &[speed, change("ANGLE_MAX", 3000.0)])
            .unwrap();
        // Another run opens the same journal and changes the same parameter again.
        let mut journal = open();
        assert_eq!(journal.names(), "WPNAV_SPEED, ANGLE_MAX");
        assert!(journal.fits(1, Firmware::ArduCopter));
        assert!(!journal.fits(2, Firmware::ArduCopter) && !journal.fits(1, Firmware::Px4));
        journal
            .note(VEHICLE, &[change("WPNAV_SPEED", 3500.0)])
            .unwrap();
        assert_eq!(
            open().changes(),
            [speed, change("ANGLE_MAX", 3000.0)],
            "the value before any change counts"
        );
        journal.restored("ANGLE_MAX").unwrap();
        assert_eq!(open().changes(), [speed]);
        journal.restored("WPNAV_SPEED").unwrap();
        assert!(!path.exists());
        journal.restored("WPNAV_SPEED").unwrap();
    }

    /// PX4 sends the bytes of its integers, which may not be a number if they are read as a float.
    #[test]
    fn bits_survive() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        let mut journal = ParameterJournal::open(&path, "").unwrap();
        // -1 as MAV_PARAM_TYPE_INT32.
        let change = ChangedParameter::noted("MPC_TILTMAX_AIR", u32::MAX, 6).unwrap();
        journal.note((1, Firmware::Px4), &[change]).unwrap();
        let again = ParameterJournal::open(&path, "").unwrap().changes();
        assert_eq!(again[0].was.to_bits(), u32::MAX);
        assert!(fs::read_to_string(&path).unwrap().contains("\"-1\""));
        assert_eq!(ChangedParameter::noted("NO_SUCH_NAME", 0, 9), None);
        assert_eq!(ChangedParameter::noted("ANGLE_MAX", 0, 99), None);
    }

    #[test]
    fn a_file_that_is_no_journal_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        fs::write(&path, "{}").unwrap();
        let error = ParameterJournal::open(&path, "").unwrap_err().to_string();
        assert!(error.contains(FILE_NAME), "{error}");
    }
}
