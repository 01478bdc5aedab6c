// SPDX-License-Identifier: MIT OR Apache-2.0
//! The accuracy up to which constraints on positions hold.

use super::parameters::Area;
use crate::scalar::Scalar;

/// The best accuracy of a measured position, metres: MAVLink carries it in single precision, which
/// at a kilometre resolves 6e-5 m. Constraints on measured positions hold up to this value.
pub const MEASUREMENT_M: f64 = 1e-3;

/// Returns the tolerance for rounding of positions, metres: a few units in the last place of the
/// largest length involved, 1.4 picometres per kilometre in double and 0.72 mm in single precision. The
/// constraints of a mission hold up to this tolerance, however many slots it has.
pub fn rounding_m<T: Scalar>(area: &Area<T>, reach_m: T) -> T {
    area.east_m.max(area.north_m).max(reach_m) * T::EPSILON * T::of(6.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An audit of measured positions, which allows [`MEASUREMENT_M`], never sees the rounding of a
    /// controller in single precision on a map of a kilometre.
    #[test]
    fn rounding_on_a_kilometre_is_below_the_accuracy_of_a_measurement() {
        let area = Area {
            east_m: 1000.0_f32,
            north_m: 1000.0,
        };
        let rounding_m = f64::from(rounding_m(&area, 30.0));
        // Distances and the reach are rounded, too.
        assert!(rounding_m + 2e-4 < MEASUREMENT_M, "{rounding_m}");
    }
}
