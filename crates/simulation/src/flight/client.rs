//! The settings of the computer in this process: the address and key of its MAVLink client, what it
//! may change in the vehicle, and its key on the ground link.

use firmware_core::{
    autopilot::{OwnAddress, wire::signing::LinkSigning},
    link::Credentials,
};

use crate::{journal::ParameterJournal, signing::SigningUpkeep};

/// The settings of the MAVLink client in this process.
#[derive(Debug)]
pub struct ClientSettings {
    pub(super) signing: Option<(LinkSigning, SigningUpkeep)>,
    pub(super) sets_parameters: bool,
    pub(super) airframe_speed_mps: Option<f64>,
    pub(super) journal: Option<ParameterJournal>,
    pub(super) profile_from_heartbeat: bool,
    pub(super) own: OwnAddress,
    pub(super) ground_link: Option<Credentials>,
}

impl Default for ClientSettings {
    fn default() -> Self {
        Self {
            signing: None,
            sets_parameters: false,
            airframe_speed_mps: None,
            journal: None,
            profile_from_heartbeat: false,
            own: OwnAddress::ONBOARD_COMPUTER,
            ground_link: None,
        }
    }
}

impl ClientSettings {
    /// Makes the client sign its frames and accept only frames signed with the same key.
    pub fn signed_with(mut self, signing: LinkSigning, upkeep: SigningUpkeep) -> Self {
        self.signing = Some((signing, upkeep));
        self
    }

    /// Authenticates the computer's end of the ground link with these credentials.
    pub fn with_ground_link(mut self, credentials: Credentials) -> Self {
        self.ground_link = Some(credentials);
        self
    }

    /// Sets the speed that the airframe is known to reach, m/s.
    pub fn with_airframe_speed(mut self, speed_mps: f64) -> Self {
        self.airframe_speed_mps = Some(speed_mps);
        self
    }

    /// Allows the client to set the parameters that limit the mission, for its duration.
    pub fn with_parameters_set(mut self) -> Self {
        self.sets_parameters = true;
        self
    }

    /// Sets the journal in which changed parameters are recorded until they are restored; those of
    /// an earlier run are restored first. A vehicle that is part of this process needs none.
    pub fn with_journal(mut self, journal: ParameterJournal) -> Self {
        self.journal = Some(journal);
        self
    }

    /// Makes the autopilot's heartbeat select the profile whose limits are used for planning,
    /// instead of the settings of the flight.
    pub fn with_profile_from_heartbeat(mut self) -> Self {
        self.profile_from_heartbeat = true;
        self
    }

    /// Sets the address that the client's frames carry.
    pub fn with_address(mut self, own: OwnAddress) -> Self {
        self.own = own;
        self
    }
}
