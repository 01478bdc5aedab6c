//! The command-line options that select a scenario. They are the same in every command that flies,
//! bounds or trains.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::Scenario;

/// A scenario, by file or by name, and the parameters to change in it.
#[derive(Clone, Debug, PartialEq, Args)]
pub struct ScenarioChoice {
    /// The mission: a TOML file, or the name of a shipped scenario (separated, mixed)
    #[arg(long, default_value = "separated", value_name = "FILE")]
    pub scenario: PathBuf,
    /// The parameters to change.
    #[command(flatten)]
    pub changes: Changes,
}

/// The parameters that the paper's figures vary, where they differ from the file's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Args)]
pub struct Changes {
    /// MSE threshold (Gamma), in place of the scenario's
    #[arg(long, value_name = "GAMMA")]
    pub mse_threshold: Option<f64>,
    /// Noise power in dBm, in place of the scenario's
    #[arg(long, value_name = "DBM", allow_negative_numbers = true)]
    pub noise_dbm: Option<f64>,
    /// Number of slots (N), in place of the scenario's
    #[arg(long, value_name = "N")]
    pub slots: Option<u32>,
}

impl ScenarioChoice {
    /// Selects a scenario without changes.
    pub fn unchanged(scenario: PathBuf) -> Self {
        let changes = Changes::default();
        Self { scenario, changes }
    }

    /// Loads the scenario and applies the changes. All changes are made before the scenario is
    /// checked, because a threshold and a number of slots may only be valid together.
    ///
    /// # Errors
    /// Returns one line: the error of [`Scenario::load`], or the requested changes and what is
    /// wrong with them.
    pub fn load(&self) -> Result<Scenario, String> {
        let scenario = Scenario::named(&self.scenario)?;
        if self.changes == Changes::default() {
            return Ok(scenario);
        }
        scenario.changed(&self.changes).map_err(|problem| {
            let (file, options) = (self.scenario.display(), self.changes.options());
            format!("{file} with {options}: {problem}")
        })
    }
}

impl Changes {
    /// Formats the changes as command-line options.
    fn options(&self) -> String {
        let threshold = self.mse_threshold.map(|x| format!("--mse-threshold {x}"));
        let noise = self.noise_dbm.map(|x| format!("--noise-dbm {x}"));
        let slots = self.slots.map(|x| format!("--slots {x}"));
        let typed: Vec<_> = [threshold, noise, slots].into_iter().flatten().collect();
        typed.join(" ")
    }
}

impl Scenario {
    /// Loads what `--scenario` names: a shipped scenario or a file.
    ///
    /// # Errors
    /// Returns the error of [`Scenario::load`], in one line.
    pub fn named(name: &Path) -> Result<Self, String> {
        match name.to_str().and_then(Self::shipped) {
            Some(shipped) => Ok(shipped),
            None => Self::load(name).map_err(|error| match name.exists() {
                true => error.to_string(),
                false => format!("{error}; the shipped scenarios are separated, mixed and slow"),
            }),
        }
    }

    /// Returns a copy of the scenario with these changes.
    ///
    /// # Errors
    /// Returns the errors of [`Scenario::parse`].
    pub fn changed(&self, changes: &Changes) -> Result<Self, String> {
        let mut file = self.file.clone();
        let replace = |value: &mut f64, change: Option<f64>| *value = change.unwrap_or(*value);
        replace(&mut file.aircomp.mse_threshold, changes.mse_threshold);
        replace(&mut file.radio.noise_dbm, changes.noise_dbm);
        file.mission.slots = changes.slots.unwrap_or(file.mission.slots);
        let mut scenario = self.with_file(file)?;
        scenario.sensing = self.sensing.clone();
        scenario.sensing.check_measurements(&scenario.mission)?;
        Ok(scenario)
    }

    /// Returns a copy of the scenario with another threshold `Gamma`.
    ///
    /// # Errors
    /// Returns the errors of [`Scenario::parse`].
    pub fn with_mse_threshold(&self, mse_threshold: f64) -> Result<Self, String> {
        self.changed(&Changes {
            mse_threshold: Some(mse_threshold),
            ..Changes::default()
        })
    }

    /// Returns a copy of the scenario with another noise power, dBm.
    ///
    /// # Errors
    /// Returns the errors of [`Scenario::parse`].
    pub fn with_noise_dbm(&self, noise_dbm: f64) -> Result<Self, String> {
        self.changed(&Changes {
            noise_dbm: Some(noise_dbm),
            ..Changes::default()
        })
    }

    /// Returns a copy of the scenario with another number of slots.
    ///
    /// # Errors
    /// Returns the errors of [`Scenario::parse`].
    pub fn with_slots(&self, slots: u32) -> Result<Self, String> {
        self.changed(&Changes {
            slots: Some(slots),
            ..Changes::default()
        })
    }
}
