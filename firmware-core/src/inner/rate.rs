// SPDX-License-Identifier: MIT OR Apache-2.0
//! The rate of a user.

use crate::scalar::Scalar;

/// Returns `log2(1 + sinr)`, also accurate for small `sinr`.
pub(super) fn rate_of_sinr<T: Scalar>(sinr: T) -> T {
    sinr.ln_1p() * T::of(core::f64::consts::LOG2_E)
}
