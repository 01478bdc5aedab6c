//! Quantities that must not be mistaken for one another at a public boundary.

use serde::{Deserialize, Serialize};

use crate::scalar::Scalar;

/// Channel **power** gain, dimensionless: the paper's `|g|^2` and `|h|^2`.
///
/// The paper prints eq:gmn as `g = 10^(-G/10)` and then uses `g` as an amplitude; this crate
/// carries powers and takes the square root where an amplitude is meant
/// (`docs/mathematics.md`, correction 1).
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PowerGain<T>(pub T);

impl<T: Scalar> PowerGain<T> {
    /// The amplitude gain `sqrt(|h|^2)`.
    pub fn amplitude(self) -> T {
        self.0.sqrt()
    }

    /// A gain that physics allows: finite and not negative.
    pub fn is_valid(self) -> bool {
        self.0.finite() && self.0 >= T::zero()
    }

    /// A gain that a channel can have: no more arrives than was sent.
    pub fn is_passive(self) -> bool {
        self.is_valid() && self.0 <= T::one()
    }
}

/// Power in watts.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Watt<T>(pub T);

impl<T: Scalar> Watt<T> {
    /// From decibels over one milliwatt.
    pub fn from_dbm(dbm: T) -> Self {
        // 10^(x/10) = e^(x ln10 / 10)
        Watt((dbm * T::of(core::f64::consts::LN_10 / 10.0)).exp() * T::of(1e-3))
    }
}
