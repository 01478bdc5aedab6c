//! The settings that define the MDP.

use crate::Allocation;
use serde::{Deserialize, Serialize};

/// How the environment treats an action that the constraints forbid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Constraints {
    /// The shield projects it, as it does in flight: every episode arrives and is fair.
    #[cfg_attr(
        feature = "clap",
        value(help = "The shield projects them, as in flight: every episode arrives and is fair")
    )]
    Shielded,
    /// The paper's form: only area and speed are projected; an unfair choice earns nothing
    /// (`r^c = 0`), a missed destination costs (`r^d`).
    #[cfg_attr(
        feature = "clap",
        value(
            help = "Only area and speed are enforced; the reward accounts for fairness and arrival"
        )
    )]
    Penalty,
}

/// Reward weights, constraint handling and power allocation of an environment. The default is the
/// one that is trained with unless a setting says otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentSettings {
    /// `lambda_1`, the weight of the rate. The paper gives no value. The default is 1, so that
    /// returns are in bit/s/Hz.
    pub rate_weight: f32,
    /// `lambda_2`, the weight of the trajectory reward, per metre and slot. The paper gives no
    /// value. The default is small because arrival is certain under the shield and the term only
    /// biases the path.
    pub trajectory_weight: f32,
    /// `R_f`, the arrival reward before it is multiplied by `lambda_2`. The paper gives no value.
    pub arrival_reward: f32,
    /// How the powers of a slot are chosen: optimally, or by one of the paper's comparison
    /// schemes.
    pub allocation: Allocation,
    /// How forbidden actions are treated.
    pub constraints: Constraints,
    /// Whether the displacement's entropy counts also in states in which the shield leaves only
    /// one way to fly; see [`Environment::entropy_mask`](crate::Environment::entropy_mask).
    pub entropy_when_forced: bool,
}

impl Default for EnvironmentSettings {
    fn default() -> Self {
        Self {
            rate_weight: 1.0,
            trajectory_weight: 1e-6,
            arrival_reward: 1e6,
            allocation: Allocation::Exact,
            constraints: Constraints::Shielded,
            entropy_when_forced: true,
        }
    }
}
