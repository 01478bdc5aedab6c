//! What the environment reports about a step and about an episode.

use firmware_core::shield::Intervention;

use crate::action::UserSet;

/// The parts of a step's reward, for logs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reward {
    /// `r^c`, bit/s/Hz.
    pub rate: f64,
    /// `r^d`, metres times slots (or `R_f`).
    pub trajectory: f64,
    /// The total, `lambda_1 (r^c + p_m + shaping) + lambda_2 r^d`, where the price `p_m` and the
    /// shaping term are 0 unless the environment was built with them.
    pub total: f64,
}

/// The result of flying one slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The reward and its parts.
    pub reward: Reward,
    /// `R_n`, bit/s/Hz, whether or not it was rewarded.
    pub rate: f64,
    /// `MSE_n`.
    pub mse: f64,
    /// Whether the slot met the MSE threshold `Gamma`.
    pub feasible: bool,
    /// What the shield changed.
    pub intervention: Intervention,
    /// Whether this was slot `N`.
    pub last: bool,
}

/// A step together with what a learner needs to know about the state that follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepResult {
    /// The step itself.
    pub step: Step,
    /// The users that may be served next.
    pub admissible: UserSet,
    /// Whether the displacement's entropy counts in the state that follows; see
    /// [`Environment::entropy_mask`](crate::Environment::entropy_mask).
    pub entropy_mask: bool,
}

/// Sums over an episode, and how it ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Episode {
    /// Sum of rewards.
    pub reward: f64,
    /// Sum of `lambda_1 r^c`.
    pub rate_reward: f64,
    /// Sum of `lambda_2 r^d`.
    pub trajectory_reward: f64,
    /// Sum of `R_n`, bit/s/Hz.
    pub sum_rate: f64,
    /// Number of slots that missed `Gamma`.
    pub mse_violations: u32,
    /// Number of slots in which the shield changed the action.
    pub interventions: u32,
    /// Whether it ended within one slot of the destination.
    pub arrived: bool,
    /// Whether every user had its quota.
    pub fair: bool,
}
