// SPDX-License-Identifier: MIT OR Apache-2.0
//! The limits of a vehicle's motion, which the controller plans with and the guidance keeps.

use serde::{Deserialize, Serialize};

use crate::scalar::Scalar;

/// The limits of the vehicle. Infinite for the paper's kinematics.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MotionLimits<T> {
    /// Largest horizontal speed, m/s.
    pub speed_mps: T,
    /// Largest horizontal acceleration, m/s^2.
    pub acceleration_mps2: T,
    /// Largest change of acceleration, m/s^3.
    pub jerk_mps3: T,
}

impl<T: Scalar> MotionLimits<T> {
    /// Returns no limits but the mission's own: every waypoint is reached at the slot's end.
    pub fn ideal() -> Self {
        let infinity = T::of(f64::INFINITY);
        Self {
            speed_mps: infinity,
            acceleration_mps2: infinity,
            jerk_mps3: infinity,
        }
    }

    /// Returns whether only the mission limits the vehicle.
    pub fn is_ideal(&self) -> bool {
        !self.acceleration_mps2.finite()
    }

    /// Returns whether each limit is above zero (infinity included).
    pub fn is_valid(&self) -> bool {
        [self.speed_mps, self.acceleration_mps2, self.jerk_mps3]
            .iter()
            .all(|&limit| limit > T::zero())
    }
}
