//! Size and scaling of the observation.

use firmware_core::{Mission, SENSORS_MAX, Scalar, USERS_MAX, policy::STATE_EXTRA};
use serde::{Deserialize, Serialize};

/// Sizes of the learning problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dimensions {
    /// Number of users, `M`.
    pub users: usize,
    /// Length of the observation: [`state_len`](firmware_core::policy::state_len) of the users.
    pub observation: usize,
}

/// Scales the paper's state to numbers around `[-1, 1]`: `(x - offset) * scale`. It is part of the
/// exported policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Normalizer {
    /// The number that is subtracted from each component, in raw units.
    pub offset: Vec<f32>,
    /// The factor that each difference is multiplied by, in inverse raw units.
    pub scale: Vec<f32>,
}

impl Normalizer {
    /// Returns the normalizer of a mission: counts are divided by the quota, the rate by its limit
    /// `log2(1/(1 - J Gamma))`, the MSE by `Gamma`, and positions by the size of the area.
    pub fn of_mission<T: Scalar>(mission: &Mission<T, USERS_MAX, SENSORS_MAX>) -> Self {
        let p = mission.parameters();
        // The full scale of every component: [0, full] becomes [-1, 1].
        let counts = std::iter::repeat_n(f64::from(mission.quota().max(1)), mission.user_count());
        let rest: [f64; STATE_EXTRA] = [
            mission.slot_rate_limit().to_f64(),
            p.mse_threshold.to_f64(),
            p.area.east_m.to_f64(),
            p.area.north_m.to_f64(),
        ];
        let full = counts.chain(rest);
        let (offset, scale) = full
            .map(|full| ((full / 2.0) as f32, (2.0 / full) as f32))
            .unzip();
        Self { offset, scale }
    }

    /// Normalizes a raw observation in place.
    pub fn apply(&self, state: &mut [f32]) {
        for ((x, offset), scale) in state.iter_mut().zip(&self.offset).zip(&self.scale) {
            *x = (*x - offset) * scale;
        }
    }
}
