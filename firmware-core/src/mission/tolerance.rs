// SPDX-License-Identifier: MIT OR Apache-2.0
//! The accuracy up to which constraints on positions hold.

use super::parameters::Area;
use crate::scalar::Scalar;

/// The best accuracy of a measured position, metres: MAVLink carries it in single precision, which
/// at a kilometre resolves 6e-5 m. Constraints on measured positions hold up to this value.
pub const MEASUREMENT_M: f64 = 1e-3;

/// Returns the tolerance for rounding of positions, metres: a few units in the last place of the
/// largest length involved, 4 picometres per kilometre in double and 2 mm in single precision. The
/// constraints of a mission hold up to this tolerance, however many slots it has.
pub fn rounding_m<T: Scalar>(area: &Area<T>, reach_m: T) -> T {
    area.east_m.max(area.north_m).max(reach_m) * T::EPSILON * T::of(16.0)
}
