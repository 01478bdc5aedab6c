//! What a program does for MAVLink signing while it runs: it sets the clock of the signatures, and
//! saves their time and replay state in a file, so that replayed frames are refused after a restart.

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use files::{input, output};
use firmware_core::autopilot::wire::signing::SigningState;

/// The time between two saves. The specification asks for a minute.
const SAVED_EVERY: Duration = Duration::from_secs(1);

/// The clock of signatures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SigningClock {
    /// That of the system or of the simulation.
    #[default]
    System,
    /// None, as on a board: the time is that of the saved state and of received frames.
    Unknown,
}

/// Error returned when a state cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("state of signatures {path}: {problem}")]
pub struct StateError {
    path: String,
    problem: String,
}

/// The clock and the file of signatures. By default the system's clock, and no file.
#[derive(Debug, Default)]
pub struct SigningUpkeep {
    clock: SigningClock,
    file: Option<StateFile>,
}

#[derive(Debug)]
struct StateFile {
    path: PathBuf,
    saved_at: Option<Instant>,
    /// The state that is not saved yet.
    unsaved: Option<SigningState>,
    /// The last save failed with this error.
    failed: Option<io::Error>,
}

impl SigningUpkeep {
    /// Creates the upkeep with a clock and no file.
    pub fn new(clock: SigningClock) -> Self {
        Self { clock, file: None }
    }

    /// Saves into this file from now on, and returns the state that it contains already.
    ///
    /// # Errors
    /// Returns an error if the file exists and cannot be read or contains something else.
    pub fn keep_in(&mut self, path: &Path) -> Result<SigningState, StateError> {
        let failed = |problem: String| StateError {
            path: path.display().to_string(),
            problem,
        };
        let state = match fs::exists(path) {
            Ok(false) => SigningState::default(),
            Ok(true) => {
                let bytes = input::read(path).map_err(|error| failed(error.to_string()))?;
                serde_json::from_slice(&bytes).map_err(|error| failed(error.to_string()))?
            }
            Err(error) => return Err(failed(error.to_string())),
        };
        self.file = Some(StateFile {
            path: path.to_owned(),
            saved_at: None,
            unsaved: None,
            failed: None,
        });
        Ok(state)
    }

    /// Returns the date for the signatures, microseconds since 1970, given that of the clock.
    pub fn date(&self, unix_us: u64) -> Option<u64> {
        (self.clock == SigningClock::System).then_some(unix_us)
    }

    /// Notes the present state, and saves it if the last save is long enough ago. A save that fails
    /// is tried again the next time.
    pub fn note(&mut self, state: impl FnOnce() -> Option<SigningState>) {
        let Some(file) = &mut self.file else {
            return;
        };
        file.unsaved = state();
        if file
            .saved_at
            .is_none_or(|saved| saved.elapsed() >= SAVED_EVERY)
        {
            file.save();
        }
    }

    /// Returns the error of the last save if it failed, once.
    pub fn take_error(&mut self) -> Option<StateError> {
        let file = self.file.as_mut()?;
        let error = file.failed.take()?;
        Some(StateError {
            path: file.path.display().to_string(),
            problem: error.to_string(),
        })
    }

    /// Saves the last state.
    ///
    /// # Errors
    /// Returns an error if the file cannot be written.
    pub fn finish(mut self) -> Result<(), StateError> {
        if let Some(file) = &mut self.file {
            file.save();
        }
        self.take_error().map_or(Ok(()), Err)
    }
}

impl StateFile {
    fn save(&mut self) {
        let Some(state) = &self.unsaved else {
            return;
        };
        let text = serde_json::to_vec(state).map_err(io::Error::from);
        let written = text.and_then(|text| output::write(&self.path, &text));
        self.saved_at = Some(Instant::now());
        self.failed = written.err();
        if self.failed.is_none() {
            self.unsaved = None;
        }
    }
}

impl Drop for StateFile {
    /// A program that ends early saves as well.
    fn drop(&mut self) {
        self.save();
    }
}

#[cfg(test)]
mod tests {
    use firmware_core::autopilot::wire::signing::SigningTime;

    use super::*;

    fn state(units: u64) -> SigningState {
        SigningState::at(SigningTime::from_units(units).unwrap())
    }

    #[test]
    fn the_state_survives_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.json");
        let mut upkeep = SigningUpkeep::default();
        assert_eq!(upkeep.keep_in(&path).unwrap(), SigningState::default());
        for units in [7, 8] {
            upkeep.note(|| Some(state(units)));
        }
        // A crash at this moment: only the first state is on the disk, the second is not due.
        let crashed = fs::read(&path).unwrap();
        assert_eq!(
            serde_json::from_slice::<SigningState>(&crashed).unwrap(),
            state(7)
        );
        upkeep.finish().unwrap();
        let mut restarted = SigningUpkeep::new(SigningClock::Unknown);
        assert_eq!(restarted.keep_in(&path).unwrap(), state(8));
        assert_eq!(restarted.date(5), None);
        assert_eq!(SigningUpkeep::default().date(5), Some(5));
    }

    #[test]
    fn a_state_that_is_none_is_refused_and_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.json");
        let too_late = format!(r#"{{"time":{},"streams":[]}}"#, u64::MAX);
        for content in ["", "{}", too_late.as_str()] {
            fs::write(&path, content).unwrap();
            let mut upkeep = SigningUpkeep::default();
            let error = upkeep.keep_in(&path).unwrap_err().to_string();
            assert!(error.contains("state.json"), "{error}");
            drop(upkeep);
            assert_eq!(fs::read_to_string(&path).unwrap(), content);
        }
    }
}
