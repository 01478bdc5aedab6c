//! The onboard computer that a board creates from an order.

use heapless::String;

use super::{
    order::{MissionOrder, OrderError, PolicyKind},
    protocol::BoardReport,
};
use crate::{
    Mission, SENSORS_MAX, USERS_MAX,
    autopilot::{Autopilot, AutopilotSettings, failsafe::Watch, preflight::Preflight},
    controller::Controller,
    mission::MissionChange,
    onboard::{Onboard, OnboardSettings},
    policy::{Action, Observation, Policy, StraightLine, mlp::Mlp},
};

/// A mission in the board's precision.
pub type BoardMission = Mission<f32, USERS_MAX, SENSORS_MAX>;

/// The onboard computer of a board with its policy in flash.
pub type BoardComputer<B> = Onboard<f32, BoardPolicy<B>, USERS_MAX, SENSORS_MAX>;

/// The policies of a board.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // no allocator
pub enum BoardPolicy<B> {
    /// A trained policy in flash.
    Trained(Mlp<B>),
    /// The rule-based policy.
    StraightLine(StraightLine<f32, USERS_MAX>),
}

impl<B: AsRef<[u8]>> Policy<f32, USERS_MAX> for BoardPolicy<B> {
    fn decide(&mut self, observation: &Observation<'_, f32>) -> Action<f32, USERS_MAX> {
        match self {
            Self::Trained(policy) => policy.decide(observation),
            Self::StraightLine(policy) => policy.decide(observation),
        }
    }

    /// A trained policy cannot use a change.
    fn revise(&mut self, change: &MissionChange<f32>, slots_begun: u32) {
        match self {
            Self::Trained(policy) => Policy::<f32, USERS_MAX>::revise(policy, change, slots_begun),
            Self::StraightLine(policy) => policy.revise(change, slots_begun),
        }
    }
}

impl<B: AsRef<[u8]>> BoardPolicy<B> {
    /// Returns the digest of the mission that the policy was trained for, or `None` if it is a rule.
    pub fn scenario_digest(&self) -> Option<&String<64>> {
        match self {
            Self::Trained(policy) => Some(&policy.provenance().scenario_digest),
            Self::StraightLine(_) => None,
        }
    }
}

/// Returns the report of a board whose order was accepted.
pub fn ready<B: AsRef<[u8]>>(computer: &BoardComputer<B>) -> BoardReport {
    let policy = computer.controller().policy();
    BoardReport::Ready {
        scenario_digest: policy.scenario_digest().cloned(),
    }
}

impl MissionOrder {
    /// Creates the onboard computer that flies this order; `trained` is the policy of the board, if
    /// it has one.
    ///
    /// # Errors
    /// Returns an error if the mission is invalid, if the policy is for another mission, or if the
    /// autopilot settings are invalid.
    pub fn build<B: AsRef<[u8]> + Clone>(
        &self,
        trained: Option<&Mlp<B>>,
    ) -> Result<BoardComputer<B>, OrderError> {
        let mission = BoardMission::new(self.mission.clone())?;
        let policy = match self.policy_kind {
            PolicyKind::Trained => {
                let trained = trained.ok_or(OrderError::NoPolicy)?;
                trained.provenance().check(&mission)?;
                BoardPolicy::Trained(trained.clone())
            }
            PolicyKind::StraightLine => BoardPolicy::StraightLine(StraightLine::new(&mission)),
        };
        let p = &self.mission;
        let flight = AutopilotSettings {
            limits: self.limits,
            geofence: self.geofence,
            watch: Watch {
                ground: self.ground_patience,
                ..Watch::default()
            },
            preflight: Preflight::of(p),
            ..AutopilotSettings::new(self.map_origin, p.start, p.altitude_m, p.max_speed_mps)
        };
        let autopilot = Autopilot::new(flight)?;
        let controller = Controller::new(mission, policy);
        Ok(Onboard::new(
            OnboardSettings::default(),
            controller,
            autopilot,
        ))
    }
}
