// SPDX-License-Identifier: MIT OR Apache-2.0
//! The choice of a solver: [`ExactSolver`] at compile time, or a [`Method`] at run time.

use serde::{Deserialize, Serialize};

use super::{alternating, error::SlotError, level::SensorField, solution::Solution};
use crate::{
    scalar::Scalar,
    units::{PowerGain, Watt},
};

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

/// A solver of slot problems.
pub trait SlotSolver<T: Scalar> {
    /// Solves a slot with a user of gain `|g|^2` served, or nobody (`None`). The worst case is that
    /// of the method.
    ///
    /// # Errors
    /// Returns an error if a gain is NaN, infinite or negative.
    fn solve(
        &self,
        field: &SensorField<'_, T>,
        user: Option<PowerGain<T>>,
    ) -> Result<Solution<T>, SlotError<T>>;
}

/// The global optimum in closed form. A program with this solver alone does not contain the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExactSolver;

impl<T: Scalar> SlotSolver<T> for ExactSolver {
    fn solve(
        &self,
        field: &SensorField<'_, T>,
        user: Option<PowerGain<T>>,
    ) -> Result<Solution<T>, SlotError<T>> {
        field.solve(user)
    }
}

impl<T: Scalar> Method<T> {
    /// Solves a slot: see [`SlotSolver::solve`].
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

impl<T: Scalar> SlotSolver<T> for Method<T> {
    fn solve(
        &self,
        field: &SensorField<'_, T>,
        user: Option<PowerGain<T>>,
    ) -> Result<Solution<T>, SlotError<T>> {
        Self::solve(self, field, user)
    }
}
