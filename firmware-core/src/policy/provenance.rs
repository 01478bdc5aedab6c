//! What a trained policy carries besides its weights: what it was trained for and by what.

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::{mission::Mission, scalar::Scalar};

/// Travels in every policy file, `.onnx` (as metadata) and `.policy`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// `M`.
    pub users: u32,
    /// `V_max`, m/s.
    pub max_speed_mps: f32,
    /// `delta`, s.
    pub slot_duration_s: f32,
    /// Extent of `Lambda` to the east and north, m.
    pub area_m: [f32; 2],
    /// Which algorithm trained it.
    pub algorithm: String<16>,
    /// The training scenario's name.
    pub scenario: String<64>,
    /// SHA-256 of the training scenario's mission, hexadecimal.
    pub scenario_digest: String<64>,
    /// Episodes of training until this policy.
    pub episodes: u32,
    /// The seed of the training run.
    pub seed: u64,
}

/// A policy that is not for this mission.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the policy is for {what} = {policy}, but the mission has {mission}")]
pub struct PolicyMismatch {
    /// What differs.
    pub what: &'static str,
    /// The policy's value.
    pub policy: f64,
    /// The mission's.
    pub mission: f64,
}

impl Provenance {
    /// Whether the policy can fly a mission: same users, speed, slot and area. Channels, powers,
    /// threshold and places may differ; how well it then does is another matter.
    ///
    /// # Errors
    /// The first thing that differs, with both values.
    pub fn check<T: Scalar, const M: usize, const J: usize>(
        &self,
        mission: &Mission<T, M, J>,
    ) -> Result<(), PolicyMismatch> {
        let p = mission.parameters();
        let pairs = [
            ("users", f64::from(self.users), p.users.len() as f64),
            (
                "max_speed_mps",
                self.max_speed_mps.into(),
                p.max_speed_mps.to_f64(),
            ),
            (
                "slot_duration_s",
                self.slot_duration_s.into(),
                p.slot_duration_s.to_f64(),
            ),
            ("area_m[0]", self.area_m[0].into(), p.area.east_m.to_f64()),
            ("area_m[1]", self.area_m[1].into(), p.area.north_m.to_f64()),
        ];
        for (what, policy, mission) in pairs {
            // The policy holds single precision. A NaN is a misfit, too.
            let same = libm::fabs(policy - mission) <= 1e-6 * libm::fabs(mission);
            if !same {
                return Err(PolicyMismatch {
                    what,
                    policy,
                    mission,
                });
            }
        }
        Ok(())
    }
}
