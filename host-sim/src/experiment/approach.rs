//! The approaches that the figures compare: policies with their allocation of powers, and the
//! references that they are compared with.

use environment::Allocation;
use serde::{Deserialize, Serialize};

use super::cell::{Learner, Preset};

/// The policy and allocation of a mission, or a reference that it is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Approach {
    /// SAC with the trainer's preset `tuned`.
    SacTuned,
    /// SAC with Table I's settings.
    SacTableOne,
    /// DDPG with the trainer's preset `tuned`.
    DdpgTuned,
    /// DDPG with Table I's settings.
    DdpgTableOne,
    /// The policy for any mission, which was trained on none of these missions.
    AnyMission,
    /// Straight to the destination, serving the nearest admissible user.
    StraightLine,
    /// The best known mission.
    Search,
    /// The certified upper bound of any mission.
    Bound,
    /// Hovering over the centre of all nodes, serving the nearest admissible user.
    FixedPosition,
    /// The policy of SAC, tuned; users send with full power or not at all.
    FixedUserPower,
    /// The policy of SAC, tuned; sensors send with full power.
    FixedSensorPower,
}

impl Approach {
    /// Returns the name for legends and tables.
    pub fn title(self) -> &'static str {
        match self {
            Self::SacTuned => "SAC (tuned)",
            Self::SacTableOne => "SAC (Table I)",
            Self::DdpgTuned => "DDPG (tuned)",
            Self::DdpgTableOne => "DDPG (Table I)",
            Self::AnyMission => "policy for any mission",
            Self::StraightLine => "straight line",
            Self::Search => "search",
            Self::Bound => "certified bound",
            Self::FixedPosition => "fixed position",
            Self::FixedUserPower => "fixed user power",
            Self::FixedSensorPower => "fixed sensor power",
        }
    }

    /// Returns the name without the preset, for figures of one preset.
    pub(super) fn algorithm_title(self) -> &'static str {
        match self.learner() {
            Some(Learner::Sac(_)) => "SAC",
            Some(Learner::Ddpg(_)) => "DDPG",
            None => self.title(),
        }
    }

    /// Returns SAC with a preset.
    pub fn sac(preset: Preset) -> Self {
        match preset {
            Preset::Tuned => Self::SacTuned,
            Preset::TableOne => Self::SacTableOne,
        }
    }

    /// Returns DDPG with a preset.
    pub fn ddpg(preset: Preset) -> Self {
        match preset {
            Preset::Tuned => Self::DdpgTuned,
            Preset::TableOne => Self::DdpgTableOne,
        }
    }

    /// Returns the learner of the approach, if it has one.
    pub(super) fn learner(self) -> Option<Learner> {
        match self {
            Self::SacTuned | Self::FixedUserPower | Self::FixedSensorPower => {
                Some(Learner::Sac(Preset::Tuned))
            }
            Self::SacTableOne => Some(Learner::Sac(Preset::TableOne)),
            Self::DdpgTuned => Some(Learner::Ddpg(Preset::Tuned)),
            Self::DdpgTableOne => Some(Learner::Ddpg(Preset::TableOne)),
            Self::AnyMission
            | Self::StraightLine
            | Self::Search
            | Self::Bound
            | Self::FixedPosition => None,
        }
    }

    /// Returns how the approach allocates the powers of a slot.
    pub(super) fn allocation(self) -> Allocation {
        match self {
            Self::FixedUserPower => Allocation::FixedUserPower(None),
            Self::FixedSensorPower => Allocation::FixedSensorPower(None),
            _ => Allocation::Exact,
        }
    }
}
