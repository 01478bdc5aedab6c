// SPDX-License-Identifier: MIT OR Apache-2.0
//! Physical quantities as types, so that they cannot be confused at a public boundary.

use serde::{Deserialize, Serialize};

use crate::scalar::Scalar;

/// Channel **power** gain, dimensionless: the paper's `|g|^2` and `|h|^2`.
///
/// The paper prints eq:gmn as `g = 10^(-G/10)` and then uses `g` as an amplitude; this crate
/// carries powers and takes the square root where an amplitude is meant
/// (`docs/mathematics.md`, correction 1).
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PowerGain<T>(pub T);

impl<T: Scalar> PowerGain<T> {
    /// Returns the amplitude gain `sqrt(|h|^2)`.
    pub fn amplitude(self) -> T {
        self.0.sqrt()
    }

    /// Returns whether the gain is finite and not negative.
    pub fn is_valid(self) -> bool {
        // Two comparisons: asked for a finite number, the compiler looks at its bits instead, which
        // takes 26 instructions of a Cortex-M7.
        (T::zero()..=T::LARGEST).contains(&self.0)
    }

    /// Returns whether a passive channel can have this gain: it is valid and at most 1.
    pub fn is_passive(self) -> bool {
        (T::zero()..=T::one()).contains(&self.0)
    }
}

/// Power in watts.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Watt<T>(pub T);

impl<T: Scalar> Watt<T> {
    /// Converts from decibels over one milliwatt.
    pub fn from_dbm(dbm: T) -> Self {
        // 10^(x/10) = e^(x ln10 / 10)
        Watt((dbm * T::of(core::f64::consts::LN_10 / 10.0)).exp() * T::of(1e-3))
    }
}
