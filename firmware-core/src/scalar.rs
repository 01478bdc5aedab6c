// SPDX-License-Identifier: MIT OR Apache-2.0
//! The number type: `f64` on the host, `f32` on the microcontroller.
//!
//! Everything numeric in this crate is generic over [`Scalar`]. Functions beyond arithmetic are
//! those of `libm` on every platform (nalgebra's feature `libm-force`), so that the host computes
//! the same bits as the target.

use nalgebra::{Point2, RealField, Vector2};
use serde::{Serialize, de::DeserializeOwned};

/// The number type of a computation: `f32` or `f64`.
pub trait Scalar:
    RealField + Copy + Default + Serialize + DeserializeOwned + num_limits::Limits + 'static
{
    /// Returns the value of this type that is nearest to an `f64`.
    fn of(value: f64) -> Self;
    /// Returns this value as `f64`, exactly.
    fn to_f64(self) -> f64;
    /// Converts a count to a number; exact up to 2^24 for `f32`.
    fn count(n: usize) -> Self;
    /// Returns the number without its fraction; 0 for a negative number or NaN, and the largest
    /// count for one that is too large.
    fn whole(self) -> usize;
    /// Returns whether the value is neither NaN nor infinite. (This is `RealField::is_finite` under
    /// a name that does not collide.)
    fn finite(self) -> bool;
    /// Returns the next smaller representable number, for a positive finite input.
    fn next_below(self) -> Self;
    /// Compares by a total order with NaN last, for sorting without a panic.
    fn order(&self, other: &Self) -> core::cmp::Ordering;
}

mod num_limits {
    /// Precision-dependent constants.
    pub trait Limits {
        /// Distance from 1 to the next larger number.
        const EPSILON: Self;
        /// The largest finite number.
        const LARGEST: Self;
        /// `2^s + 1`, where `s` is half the number of binary digits, rounded up: with it a number is
        /// split into two halves.
        const SPLITTER: Self;
        /// Relative tolerance within which a constraint counts as kept:
        /// 1e-9 in double, 1e-5 in single precision.
        const CONSTRAINT_TOLERANCE: Self;
    }
}
pub use num_limits::Limits;

macro_rules! scalar {
    ($t:ty, $tolerance:literal, $splitter:literal) => {
        impl Limits for $t {
            const EPSILON: Self = <$t>::EPSILON;
            const LARGEST: Self = <$t>::MAX;
            const SPLITTER: Self = $splitter;
            const CONSTRAINT_TOLERANCE: Self = $tolerance;
        }
        impl Scalar for $t {
            fn of(value: f64) -> Self {
                value as $t
            }
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            fn count(n: usize) -> Self {
                n as $t
            }
            fn whole(self) -> usize {
                self as usize
            }
            fn finite(self) -> bool {
                <$t>::is_finite(self)
            }
            fn next_below(self) -> Self {
                self.next_down()
            }
            fn order(&self, other: &Self) -> core::cmp::Ordering {
                self.total_cmp(other)
            }
        }
    };
}
scalar!(f32, 1e-5, 4097.0);
scalar!(f64, 1e-9, 134_217_729.0);

/// A place on the map, metres: `x` east, `y` north (the paper's `q_n`, `u_m`, `v_j` without
/// their heights). Altitude is a parameter of the mission.
pub type Position<T> = Point2<T>;

/// A difference of two [`Position`]s, metres.
pub type Displacement<T> = Vector2<T>;
