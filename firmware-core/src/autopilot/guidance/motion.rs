//! The limits of a vehicle, and its motion at one moment.

use nalgebra::Vector2;

use crate::scalar::{Displacement, Position, Scalar};

/// The limits of the vehicle. Infinite for the paper's kinematics.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Limits<T> {
    /// Largest horizontal speed, m/s.
    pub speed_mps: T,
    /// Largest horizontal acceleration, m/s^2.
    pub acceleration_mps2: T,
    /// Largest change of acceleration, m/s^3.
    pub jerk_mps3: T,
}

impl<T: Scalar> Limits<T> {
    /// Returns no limits but the mission's own: every waypoint is reached at the slot's end.
    pub fn ideal() -> Self {
        let infinity = T::of(f64::INFINITY);
        Self {
            speed_mps: infinity,
            acceleration_mps2: infinity,
            jerk_mps3: infinity,
        }
    }

    /// Returns whether only the mission limits the vehicle.
    pub fn is_ideal(&self) -> bool {
        !self.acceleration_mps2.finite()
    }

    /// Returns whether each limit is above zero (infinity included).
    pub fn is_valid(&self) -> bool {
        [self.speed_mps, self.acceleration_mps2, self.jerk_mps3]
            .iter()
            .all(|&limit| limit > T::zero())
    }
}

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
