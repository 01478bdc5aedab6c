//! Selects the profile whose limits the client plans with: the specified one, or that of the
//! autopilot that answers.

use firmware_core::{
    MotionLimits,
    autopilot::{Autopilot, profile::Firmware},
};
use thiserror::Error;

use super::settings::autopilot_settings;
use scenario::Scenario;
use vehicle::Profile;

/// The error of a specified profile that is for another autopilot than the one that answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "--profile {given} is for {}, but the autopilot is {}; without --profile, its heartbeat selects \
     the profile",
    given.firmware().name(),
    heard.name()
)]
pub struct WrongProfile {
    /// The specified profile.
    pub given: Profile,
    /// The firmware according to the heartbeat.
    pub heard: Firmware,
}

/// The specified profile, or the one that the heartbeat indicates, with the limits of each.
#[derive(Clone, Debug)]
pub struct ProfileChoice {
    given: Option<Profile>,
    limits: Vec<(Profile, MotionLimits<f64>)>,
    settled: Option<Profile>,
}

impl ProfileChoice {
    /// Creates the choice for a mission. Without a specified profile the heartbeat decides.
    pub fn new(scenario: &Scenario, given: Option<Profile>) -> Self {
        let limits = |profile| (profile, autopilot_settings(scenario, profile).limits);
        Self {
            given,
            limits: Profile::ALL.into_iter().map(limits).collect(),
            settled: None,
        }
    }

    /// Returns the default profile of an autopilot. The heartbeat of the built-in vehicle does not
    /// identify its airframe: the limits of the slower one are valid for both.
    pub fn of(firmware: Firmware) -> Profile {
        match firmware {
            Firmware::Generic => Profile::Multirotor,
            Firmware::ArduCopter => Profile::ArduCopter,
            Firmware::Px4 => Profile::Px4,
        }
    }

    /// As soon as the client has received a heartbeat of its autopilot, gives it the limits of the
    /// profile. Returns the profile once.
    ///
    /// # Errors
    /// Returns an error if the specified profile is for another autopilot.
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
            // The limits of a profile are positive.
            let _ = client.set_limits(*limits);
        }
        Ok(Some(profile))
    }
}
