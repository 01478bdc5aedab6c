//! The kinds of errors, their levels, and the worlds that have them.

use scenario::{Motion, MotionModel, MovingNodes, PerNode, Uncertainty};
use serde::{Deserialize, Serialize};

/// One kind of error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorKind {
    /// The relative error variance of all channel estimates.
    ChannelError,
    /// The standard deviation of the sensors' phase errors, rad.
    PhaseError,
    /// The probability that a sensor is silent in a slot.
    Silence,
    /// The probability that the channel state of a slot is lost.
    StateLoss,
    /// The largest speed of the users, m/s.
    Motion,
    /// The standard deviation of the nodes' positions in each direction, m.
    PositionError,
    /// The standard deviation of shadowing, dB.
    Shadowing,
    /// The power of the scattered paths over that of the direct one, `1 / K`.
    Fading,
}

impl ErrorKind {
    /// All kinds.
    pub const ALL: [Self; 8] = [
        Self::ChannelError,
        Self::PhaseError,
        Self::Silence,
        Self::StateLoss,
        Self::Motion,
        Self::PositionError,
        Self::Shadowing,
        Self::Fading,
    ];

    /// Returns the levels that are flown; 0 is the known world.
    pub fn levels(self) -> [f64; 4] {
        match self {
            Self::ChannelError => [0.0, 0.02, 0.05, 0.1],
            Self::PhaseError => [0.0, 0.15, 0.3, 0.45],
            Self::Silence => [0.0, 0.02, 0.05, 0.1],
            Self::StateLoss => [0.0, 0.05, 0.1, 0.2],
            Self::Motion => [0.0, 1.0, 2.5, 5.0],
            Self::PositionError => [0.0, 10.0, 30.0, 60.0],
            Self::Shadowing => [0.0, 2.0, 4.0, 8.0],
            Self::Fading => [0.0, 0.1, 0.3, 1.0],
        }
    }

    /// Returns the name of the level, with its unit.
    pub fn axis(self) -> &'static str {
        match self {
            Self::ChannelError => "relative error variance",
            Self::PhaseError => "phase error, rad",
            Self::Silence => "silence probability",
            Self::StateLoss => "probability of a lost state",
            Self::Motion => "users' largest speed, m/s",
            Self::PositionError => "position error, m",
            Self::Shadowing => "shadowing, dB",
            Self::Fading => "scattered over direct power",
        }
    }

    /// Returns whether the vehicle receives statistics of this error, so that robust and naive
    /// allocations differ.
    pub(super) fn has_statistics(self) -> bool {
        matches!(self, Self::ChannelError | Self::PhaseError)
    }

    /// Returns whether a flight depends on the seed of the world: expected MSE and achievable rate
    /// average over estimation and phase errors.
    pub(super) fn is_random(self) -> bool {
        !self.has_statistics()
    }

    /// Returns the world with this level of the error.
    pub(super) fn world(self, level: f64, seed: u64) -> Uncertainty {
        let mut world = Uncertainty {
            seed,
            ..Uncertainty::default()
        };
        if level == 0.0 {
            return world;
        }
        match self {
            Self::ChannelError => {
                world.sensor_error_variance = PerNode::All(level);
                world.user_error_variance = PerNode::All(level);
            }
            Self::PhaseError => world.sensor_phase_error_rad = PerNode::All(level),
            Self::Shadowing => world.shadowing_db = level,
            Self::Fading => world.rician_k_db = Some(-10.0 * level.log10()),
            Self::Silence => world.silence_probability = PerNode::All(level),
            Self::PositionError => world.position_error_m = level,
            Self::Motion => world.motion = Some(walking(level)),
            Self::StateLoss => world.state_loss_probability = level,
        }
        world
    }
}

/// Returns random-waypoint motion of the users with this largest speed.
pub(super) fn walking(speed_mps: f64) -> Motion {
    Motion {
        model: MotionModel::RandomWaypoint,
        nodes: MovingNodes::Users,
        speed_mps: Some(speed_mps),
        memory_s: None,
        csv: None,
        told_after_m: None,
    }
}
