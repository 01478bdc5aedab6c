// SPDX-License-Identifier: MIT OR Apache-2.0
//! The motion of a vehicle at one moment.

use nalgebra::Vector2;

use crate::scalar::{Displacement, Position, Scalar};

/// Position, velocity and acceleration at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<T: Scalar> {
    /// Place on the map, m.
    pub position: Position<T>,
    /// Velocity over ground, m/s.
    pub velocity: Displacement<T>,
    /// Acceleration, m/s^2.
    pub acceleration: Displacement<T>,
}

impl<T: Scalar> Motion<T> {
    /// Returns the motion of a vehicle at rest.
    pub fn at_rest(position: Position<T>) -> Self {
        Self {
            position,
            velocity: Vector2::zeros(),
            acceleration: Vector2::zeros(),
        }
    }

    /// Returns the motion after `seconds` in which the acceleration fades to zero.
    pub(super) fn faded(&self, seconds: T) -> Self {
        let gained = self.acceleration * (seconds * T::of(0.5));
        let moved = (self.velocity + self.acceleration * (seconds * T::of(1.0 / 3.0))) * seconds;
        Self {
            position: self.position + moved,
            velocity: self.velocity + gained,
            acceleration: Vector2::zeros(),
        }
    }

    /// Returns whether every number is finite.
    pub fn is_finite(&self) -> bool {
        let finite = |v: &Vector2<T>| v.x.finite() && v.y.finite();
        finite(&self.position.coords) && finite(&self.velocity) && finite(&self.acceleration)
    }
}
