//! The slot problem (eq:p1): the powers, coefficients and normalizing factor that give the
//! served user the highest rate while the average stays accurate.
//!
//! ```text
//! maximise R   subject to   MSE <= Gamma,  |b_j|^2 <= p_b^max,  0 <= p <= p^max,  eta >= 0
//! ```
//!
//! [`exact`] solves it in closed form and is the default; [`alternating`] is the paper's own
//! algorithm; [`bounded`] gives guarantees for gains within bounds; [`Method`] also has the paper's
//! comparison schemes. All of them work on a [`SensorField`]: the sensors of a position, sorted and
//! summed once.
//!
//! The result of a solve is a value: a slot in which no choice meets `Gamma` is
//! [`Status::Infeasible`], with the least MSE that is possible. Errors are for input that is not a
//! slot problem.

pub mod alternating;
pub mod bounded;
pub mod exact;
mod level;
mod scheme;

use core::fmt;

use serde::{Deserialize, Serialize};

pub use level::{PrefixSum, SensorField, Workspace};

use crate::{
    mission::Mission,
    scalar::Scalar,
    units::{PowerGain, Watt},
};

/// The limits of a slot, which do not depend on the channel: the mission's powers, noise and
/// threshold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SlotLimits<T> {
    /// `p_b^max`.
    pub sensor_power_max: Watt<T>,
    /// `p^max`.
    pub user_power_max: Watt<T>,
    /// `sigma^2`, above 0.
    pub noise_power: Watt<T>,
    /// `Gamma`, above 0 and below `1/J`.
    pub mse_threshold: T,
}

impl<T: Scalar> SlotLimits<T> {
    /// Returns the limits of a mission.
    pub fn of_mission<const M: usize, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let p = mission.parameters();
        Self {
            sensor_power_max: p.sensor_power_max,
            user_power_max: p.user_power_max,
            noise_power: p.noise_power,
            mse_threshold: p.mse_threshold,
        }
    }

    /// Returns `kappa = J (1 - J Gamma)`: with the best `eta`, `MSE <= Gamma` is `A^2 >= kappa (q +
    /// E)`.
    pub fn kappa(&self, sensors: usize) -> T {
        let sensors = T::count(sensors);
        sensors * (T::one() - sensors * self.mse_threshold)
    }

    /// Returns the same limits with `Gamma` a few units in the last place lower. Solutions aim at
    /// these, so that rounding does not take the MSE over `Gamma`. This costs less than 1e-5 of the
    /// rate in single precision.
    fn aim(&self) -> Self {
        let margin = T::EPSILON * T::of(8.0);
        Self {
            mse_threshold: self.mse_threshold * (T::one() - margin),
            ..*self
        }
    }

    /// Returns the largest coefficient `b` with `b^2 <= p_b^max`, exactly: the square of the
    /// rounded square root may exceed `p_b^max`.
    pub fn coefficient_max(&self) -> T {
        let root = self.sensor_power_max.0.sqrt();
        // The fused operation rounds once, after the sum: the sign is that of the exact difference.
        if root.mul_add(root, -self.sensor_power_max.0) > T::zero() {
            root.next_below()
        } else {
            root
        }
    }

    fn check(&self, sensors: usize) -> Result<(), SlotError<T>> {
        let not_negative = |field, value: T| {
            if value.finite() && value >= T::zero() {
                return Ok(());
            }
            let expected = "a finite power of at least 0 W";
            Err(SlotError::OutOfRange {
                field,
                value,
                expected,
            })
        };
        not_negative("sensor_power_max", self.sensor_power_max.0)?;
        not_negative("user_power_max", self.user_power_max.0)?;
        if !(self.noise_power.0.finite() && self.noise_power.0 > T::zero()) {
            return Err(SlotError::OutOfRange {
                field: "noise_power",
                value: self.noise_power.0,
                expected: "a finite power above 0 W",
            });
        }
        if sensors == 0 {
            return Err(SlotError::NoSensors);
        }
        let threshold = self.mse_threshold;
        if !(threshold.finite() && threshold > T::zero() && self.kappa(sensors) > T::zero()) {
            return Err(SlotError::OutOfRange {
                field: "mse_threshold",
                value: threshold,
                expected: "above 0 and below 1/J: from there on an all-zero estimate is accurate enough and no sensor would transmit",
            });
        }
        Ok(())
    }
}

/// What limits the rate of an optimal slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
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
    /// An iteration that converged ([`alternating`]): all constraints hold, the rate may be below
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
    /// Gains were known within bounds only ([`bounded`]): all constraints hold for every gain
    /// within the bounds.
    Guaranteed {
        /// What limits the rate.
        limited_by: LimitedBy,
    },
}

impl<T> Status<T> {
    /// Returns whether the average meets `Gamma`.
    pub fn is_feasible(&self) -> bool {
        !matches!(self, Status::Infeasible { .. })
    }

    /// Returns what limits the rate; `None` where the channels do not allow `Gamma`.
    pub fn limited_by(&self) -> LimitedBy {
        match *self {
            Status::Optimal { limited_by }
            | Status::Converged { limited_by }
            | Status::IterationLimit { limited_by }
            | Status::Guaranteed { limited_by } => limited_by,
            Status::Infeasible { .. } => LimitedBy::None,
        }
    }
}

/// The solution of a slot problem. The coefficients follow from two numbers and the channel:
/// [`coefficient`](Self::coefficient).
#[derive(Clone, Copy, Debug, PartialEq)]
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
    level: T,
    coefficient_max: T,
}

impl<T: Scalar> Solution<T> {
    /// Returns `|b_j|` of a sensor with gain `|h_j|^2`, square root of watts; at most
    /// `sqrt(p_b^max)`, exactly. A sensor that cannot be heard stays silent.
    pub fn coefficient(&self, gain: PowerGain<T>) -> T {
        self.coefficient_of_amplitude(gain.amplitude())
    }

    /// As [`coefficient`](Self::coefficient), from `|h_j|`.
    pub fn coefficient_of_amplitude(&self, amplitude: T) -> T {
        if amplitude <= T::zero() {
            return T::zero();
        }
        (self.level / amplitude).min(self.coefficient_max)
    }
}

/// The solver that allocates a slot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method<T> {
    /// The global optimum in closed form.
    #[default]
    Exact,
    /// The paper's Alg. 1.
    Alternating(alternating::AlternatingSettings<T>),
    /// Users transmit with this power or not at all; the rest is optimal.
    FixedUserPower(Watt<T>),
    /// Sensors transmit with this power; the rest is optimal.
    FixedSensorPower(Watt<T>),
}

impl<T: Scalar> Method<T> {
    /// Solves a slot with a user of gain `|g|^2` served, or nobody (`None`). The worst case is that
    /// of the method.
    ///
    /// # Errors
    /// Returns an error if a gain is NaN, infinite or negative.
    pub fn solve(
        &self,
        field: &SensorField<'_, T>,
        user: Option<PowerGain<T>>,
    ) -> Result<Solution<T>, SlotError<T>> {
        match self {
            Method::Exact => field.solve(user),
            Method::Alternating(settings) => {
                let report = field.alternate(user, settings, |_| {})?;
                Ok(report.solution)
            }
            Method::FixedUserPower(power) => field.with_fixed_user_power(user, *power),
            Method::FixedSensorPower(power) => field.with_fixed_sensor_power(user, *power),
        }
    }
}

impl<T: Scalar> SensorField<'_, T> {
    /// Converts the normalized solution to watts: `p = q sigma^2 / |g|^2`, never above `p^max`.
    fn solution(
        &self,
        status: Status<T>,
        level: &level::Level<T>,
        signal: T,
        user: PowerGain<T>,
    ) -> Solution<T> {
        let power_max = self.limits.user_power_max.0;
        let user_power = if signal <= T::zero() {
            T::zero()
        } else if signal >= self.normalized_budget(user) {
            power_max
        } else {
            (signal * (self.limits.noise_power.0 / user.0)).min(power_max)
        };
        Solution {
            status,
            rate: exact::rate_of_sinr(signal / level.energy),
            user_power: Watt(user_power),
            normalizing_factor: level.sum / ((signal + level.energy) * self.noise_amplitude),
            level: level.c * self.noise_amplitude,
            coefficient_max: self.coefficient_max,
        }
    }
}

/// Error returned for input that is not a slot problem.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SlotError<T: fmt::Display> {
    /// There are no sensors to average.
    #[error("sensor_gain is empty, but at least one sensor must be averaged")]
    NoSensors,
    /// A sensor's gain is NaN, infinite or negative.
    #[error("sensor_gain[{index}] is {value}, but must be a finite power gain of at least 0")]
    SensorGain {
        /// Which sensor.
        index: usize,
        /// Its gain.
        value: T,
    },
    /// The user's gain is NaN, infinite or negative.
    #[error("user_gain is {value}, but must be a finite power gain of at least 0")]
    UserGain {
        /// The gain.
        value: T,
    },
    /// A limit is out of its range.
    #[error("{field} is {value}, but must be {expected}")]
    OutOfRange {
        /// The name of the limit.
        field: &'static str,
        /// Its value.
        value: T,
        /// The valid range.
        expected: &'static str,
    },
    /// The workspace is too small.
    #[error("{sensors} sensors do not fit into room for {capacity}")]
    TooManySensors {
        /// `J`, the number of sensors.
        sensors: usize,
        /// The capacity of the workspace.
        capacity: usize,
    },
}

impl<T: Scalar> SlotError<T> {
    /// Returns the gain of the user to serve, 0 for nobody, or an error if the gain is invalid.
    fn check_user(user: Option<PowerGain<T>>) -> Result<PowerGain<T>, Self> {
        match user {
            Some(gain) if !gain.is_valid() => Err(Self::UserGain { value: gain.0 }),
            Some(gain) => Ok(gain),
            None => Ok(PowerGain(T::zero())),
        }
    }
}

/// Checks the gains of all sensors.
fn check_gains<T: Scalar>(
    mut sensor_gains: impl Iterator<Item = PowerGain<T>>,
) -> Result<(), SlotError<T>> {
    let mut numbered = (0..).zip(sensor_gains.by_ref());
    match numbered.find(|(_, gain)| !gain.is_valid()) {
        Some((index, gain)) => Err(SlotError::SensorGain {
            index,
            value: gain.0,
        }),
        None => Ok(()),
    }
}
