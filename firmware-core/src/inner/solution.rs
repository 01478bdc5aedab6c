// SPDX-License-Identifier: MIT OR Apache-2.0
//! The solution of a slot problem and its status.

use serde::{Deserialize, Serialize};

use super::{
    level::{Level, SensorField},
    limits::SlotLimits,
};
use crate::{
    scalar::Scalar,
    uncertainty::SensorUncertainty,
    units::{PowerGain, Watt},
};

/// What limits the rate of an optimal slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LimitedBy {
    /// The accuracy of the average: more user power would exceed `Gamma`.
    Accuracy,
    /// The user's power: it transmits at `p^max`.
    Power,
    /// Nothing: nobody is served, or the user cannot be heard, and the slot is used for the least
    /// MSE.
    None,
}

/// The status of a slot's solution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Status<T> {
    /// The global optimum of eq:p1.
    Optimal {
        /// What limits the rate.
        limited_by: LimitedBy,
    },
    /// No choice meets `Gamma`. The user is silent and the average has the MSE below.
    Infeasible {
        /// The smallest MSE that these channels allow.
        least_mse: T,
    },
    /// An iteration that converged ([`alternating`](super::alternating)): all constraints hold, the rate may be below
    /// the optimum.
    Converged {
        /// What limits the rate.
        limited_by: LimitedBy,
    },
    /// An iteration that reached its limit: all constraints hold, the rate may be below the
    /// optimum.
    IterationLimit {
        /// What limits the rate.
        limited_by: LimitedBy,
    },
    /// Gains were known within bounds only ([`bounded`](super::bounded)): all constraints hold for every gain
    /// within the bounds.
    Guaranteed {
        /// What limits the rate.
        limited_by: LimitedBy,
    },
    /// No choice meets `Gamma`, and none would with any power at any position: the channels are not
    /// known well enough ([`SensorField::error_floor`]). The user is silent and the average has the
    /// MSE below.
    ErrorFloor {
        /// The smallest MSE that these channels allow.
        least_mse: T,
    },
}

impl<T: Scalar> Status<T> {
    /// Returns the status of a slot in which `Gamma` cannot be met, with the reason: `floor` is the MSE
    /// that no power can reach.
    pub(super) fn infeasible(least_mse: T, floor: T, limits: &SlotLimits<T>) -> Self {
        // In section 10 this is W <= kappa. Exactly known channels have no floor, even where Gamma
        // is below rounding.
        if floor > T::zero() && floor >= limits.mse_threshold {
            Status::ErrorFloor { least_mse }
        } else {
            Status::Infeasible { least_mse }
        }
    }
}

impl<T> Status<T> {
    /// Returns whether the average meets `Gamma`.
    pub fn is_feasible(&self) -> bool {
        !matches!(self, Status::Infeasible { .. } | Status::ErrorFloor { .. })
    }

    /// Returns what limits the rate; `None` where the channels do not allow `Gamma`.
    pub fn limited_by(&self) -> LimitedBy {
        match *self {
            Status::Optimal { limited_by }
            | Status::Converged { limited_by }
            | Status::IterationLimit { limited_by }
            | Status::Guaranteed { limited_by } => limited_by,
            Status::Infeasible { .. } | Status::ErrorFloor { .. } => LimitedBy::None,
        }
    }
}

/// The solution of a slot problem. The coefficients follow from two numbers and the channel:
/// [`coefficient`](Self::coefficient).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Solution<T> {
    /// The status of the solution.
    pub status: Status<T>,
    /// `R`, bit/s/Hz.
    pub rate: T,
    /// `p` of the served user.
    pub user_power: Watt<T>,
    /// `eta` (eq:eta_), one over square root of watts.
    pub normalizing_factor: T,
    /// The amplitude at which the signals of strong sensors arrive, square root of watts.
    pub(super) level: T,
    pub(super) coefficient_max: T,
}

impl<T: Scalar> Solution<T> {
    /// Returns `|b_j|` of a sensor with gain `|h_j|^2`, square root of watts; at most
    /// `sqrt(p_b^max)`, exactly. A sensor that cannot be heard stays silent.
    pub fn coefficient(&self, gain: PowerGain<T>) -> T {
        self.coefficient_of_amplitude(gain.amplitude())
    }

    /// Returns `|b_j|` of a sensor with the estimated gain `|h_j|^2` whose channel is not known exactly,
    /// square root of watts; otherwise as [`coefficient`](Self::coefficient), which is for channels
    /// that are.
    pub fn uncertain_coefficient(&self, gain: PowerGain<T>, sensor: &SensorUncertainty<T>) -> T {
        self.coefficient_of_amplitude(sensor.effective_amplitude(gain.amplitude()))
    }

    /// As [`coefficient`](Self::coefficient), from `|h_j|`.
    pub fn coefficient_of_amplitude(&self, amplitude: T) -> T {
        if amplitude <= T::zero() {
            return T::zero();
        }
        (self.level / amplitude).min(self.coefficient_max)
    }
}

impl<T: Scalar> SensorField<'_, T> {
    /// Returns the status of a slot in which `Gamma` cannot be met, with the reason.
    pub(super) fn infeasible(&self, least_mse: T) -> Status<T> {
        Status::infeasible(least_mse, self.error_floor(), &self.limits)
    }

    /// Converts the normalized solution to watts: `p = q sigma^2 / |g|^2`, never above `p^max`, and
    /// `eta = A / (q + E)`, the normalizing factor of least MSE (eq:eta_). `signal` is `q`, or `(1 +
    /// eps_g) q` where channels are not known exactly.
    pub(super) fn solution(
        &self,
        status: Status<T>,
        level: &Level<T>,
        signal: T,
        user: PowerGain<T>,
    ) -> Solution<T> {
        let power_max = self.limits.user_power_max.0;
        let user_power = if signal <= T::zero() {
            T::zero()
        } else if signal >= self.normalized_budget(user) {
            power_max
        } else {
            let power = signal * (self.limits.noise_power.0 / user.0);
            match self.sorted.uncertainty() {
                None => power,
                Some(uncertainty) => power / uncertainty.user_excess(),
            }
            .min(power_max)
        };
        Solution {
            status,
            rate: self.rate_of(signal, level),
            user_power: Watt(user_power),
            normalizing_factor: level.sum / ((signal + level.energy) * self.noise_amplitude),
            level: level.c * self.noise_amplitude,
            coefficient_max: self.coefficient_max,
        }
    }
}
