// SPDX-License-Identifier: MIT OR Apache-2.0
//! The origin of a trained policy: the mission that it was trained for, and the training run.

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::{mission::Mission, scalar::Scalar};

/// The keys that `metadata_props` of an ONNX policy must have: the version of the contract, the
/// provenance, and the test vector.
pub const REQUIRED_METADATA: [&str; 13] = [
    "format_version",
    "users",
    "max_speed_mps",
    "slot_duration_s",
    "area_m",
    "algorithm",
    "scenario",
    "scenario_digest",
    "episodes",
    "seed",
    "test_observation",
    "test_displacement",
    "test_user_scores",
];

/// Part of every policy file, `.onnx` (as metadata) and `.policy`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// `M`, the number of users.
    pub users: u32,
    /// `V_max`, m/s.
    pub max_speed_mps: f32,
    /// `delta`, s.
    pub slot_duration_s: f32,
    /// Extent of `Lambda` to the east and north, m.
    pub area_m: [f32; 2],
    /// The training algorithm.
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

/// Error returned when a policy is not for the mission.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the policy is for {what} = {policy}, but the mission has {mission}")]
pub struct PolicyMismatch {
    /// The name of the value that differs.
    pub what: &'static str,
    /// The policy's value.
    pub policy: f64,
    /// The mission's value.
    pub mission: f64,
}

impl Provenance {
    /// Checks whether the policy can fly a mission with the same users, speed, slot and area.
    /// Channels, powers, threshold and positions may differ, which can reduce the policy's
    /// performance.
    ///
    /// # Errors
    /// Returns the first value that differs, with the policy's and the mission's value.
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
            // The policy holds single precision. A NaN is a mismatch, too.
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
