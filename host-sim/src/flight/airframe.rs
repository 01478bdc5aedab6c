//! Which profile's limits the client plans with: the one that was given, or that of the autopilot
//! that answers.

use firmware_core::autopilot::{Autopilot, guidance::Limits, profile::Firmware};
use thiserror::Error;

use super::settings::autopilot_settings;
use scenario::Scenario;
use vehicle::Profile;

/// The profile that was given is for another autopilot than the one that answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "--profile {given} is for {}, but {} answers: without --profile its heartbeat decides",
    given.firmware().name(),
    heard.name()
)]
pub struct WrongProfile {
    /// What was given.
    pub given: Profile,
    /// What the heartbeat says.
    pub heard: Firmware,
}

/// A profile that was given, or the one that the heartbeat names, with the limits of each.
#[derive(Clone, Debug)]
pub struct ProfileChoice {
    given: Option<Profile>,
    limits: Vec<(Profile, Limits<f64>)>,
    settled: Option<Profile>,
}

impl ProfileChoice {
    /// For a mission. Without a given profile the heartbeat decides.
    pub fn new(scenario: &Scenario, given: Option<Profile>) -> Self {
        let limits = |profile| (profile, autopilot_settings(scenario, profile).limits);
        Self {
            given,
            limits: Profile::ALL.into_iter().map(limits).collect(),
            settled: None,
        }
    }

    /// The profile of an autopilot that is flown without one being given. The heartbeat of the
    /// built-in vehicle does not tell its airframe: the slower one's limits hold for both.
    pub fn of(firmware: Firmware) -> Profile {
        match firmware {
            Firmware::Generic => Profile::Multirotor,
            Firmware::ArduCopter => Profile::ArduCopter,
            Firmware::Px4 => Profile::Px4,
        }
    }

    /// As soon as the client has heard its autopilot, gives it the limits of the profile. Returns
    /// the profile, once.
    ///
    /// # Errors
    /// The profile that was given is for another autopilot.
    pub fn settle(&mut self, client: &mut Autopilot<f64>) -> Result<Option<Profile>, WrongProfile> {
        let Some((_, heard)) = client.vehicle().filter(|_| self.settled.is_none()) else {
            return Ok(None);
        };
        let profile = self.given.unwrap_or_else(|| Self::of(heard));
        if profile.firmware() != heard {
            let given = profile;
            return Err(WrongProfile { given, heard });
        }
        self.settled = Some(profile);
        if let Some((_, limits)) = self.limits.iter().find(|(known, _)| *known == profile) {
            // A profile's limits are above zero.
            let _ = client.set_limits(*limits);
        }
        Ok(Some(profile))
    }
}
