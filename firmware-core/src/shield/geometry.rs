// SPDX-License-Identifier: MIT OR Apache-2.0
//! Discs and rectangles on the map.

use crate::scalar::{Displacement, Position, Scalar};

/// A disc on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Disc<T: Scalar> {
    pub(super) center: Position<T>,
    pub(super) radius_m: T,
}

impl<T: Scalar> Disc<T> {
    /// Returns the point of the border in the direction of `place`, or the centre if the two
    /// coincide.
    pub(super) fn border_towards(&self, place: &Position<T>) -> Position<T> {
        let offset = place - self.center;
        let distance = offset.norm();
        if distance <= T::zero() {
            return self.center;
        }
        self.center + offset * (self.radius_m / distance)
    }

    /// Visits the points where the border meets the line on which coordinate `axis` equals `value`.
    pub(super) fn meet_line(&self, axis: usize, value: T, mut visit: impl FnMut(Position<T>)) {
        let offset = value - self.center[axis];
        let square = self.radius_m * self.radius_m - offset * offset;
        if square < T::zero() {
            return;
        }
        let half_chord = square.sqrt();
        for along in [-half_chord, half_chord] {
            let mut place = self.center;
            place[axis] = value;
            place[1 - axis] += along;
            visit(place);
        }
    }

    /// Visits the points where two borders meet. The nearest points of almost tangent circles count
    /// too, so that discs which touch up to rounding still have a common point.
    pub(super) fn meet_disc(&self, other: &Self, mut visit: impl FnMut(Position<T>)) {
        // Computed from the smaller disc: from the larger one, rounding of the foot would be
        // magnified by the ratio of the radii.
        let (small, large) = if self.radius_m <= other.radius_m {
            (self, other)
        } else {
            (other, self)
        };
        let axis = large.center - small.center;
        let distance = axis.norm();
        if distance <= T::zero() {
            return;
        }
        let direction = axis / distance;
        // Distance along the axis of the common chord, in the form that does not cancel.
        let along = (distance
            - (large.radius_m - small.radius_m) * ((large.radius_m + small.radius_m) / distance))
            / T::of(2.0);
        let along = along.max(-small.radius_m).min(small.radius_m);
        let half_chord = ((small.radius_m - along) * (small.radius_m + along)).sqrt();
        let foot = small.center + direction * along;
        let normal = Displacement::new(-direction.y, direction.x);
        visit(foot);
        visit(foot + normal * half_chord);
        visit(foot - normal * half_chord);
    }
}

/// An axis-aligned rectangle on the map, its border included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rectangle<T: Scalar> {
    pub(super) south_west: Position<T>,
    pub(super) north_east: Position<T>,
}

impl<T: Scalar> Rectangle<T> {
    pub(super) fn contains(&self, place: &Position<T>) -> bool {
        self.clamp(place) == *place
    }

    pub(super) fn clamp(&self, place: &Position<T>) -> Position<T> {
        Position::new(
            place.x.max(self.south_west.x).min(self.north_east.x),
            place.y.max(self.south_west.y).min(self.north_east.y),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line meets a border in two points, in one where it touches, or not at all.
    #[test]
    fn lines_meet_where_they_cross() {
        let disc = Disc {
            center: Position::new(10.0, 20.0),
            radius_m: 5.0,
        };
        let meet = |axis: usize, value: f64| {
            let mut points = std::vec::Vec::new();
            disc.meet_line(axis, value, |place| points.push((place.x, place.y)));
            points
        };
        assert_eq!(meet(0, 13.0), [(13.0, 16.0), (13.0, 24.0)]);
        assert_eq!(meet(1, 16.0), [(7.0, 16.0), (13.0, 16.0)]);
        assert_eq!(meet(0, 15.0), [(15.0, 20.0); 2]);
        assert_eq!(meet(0, 15.5), []);
        assert_eq!(meet(1, 14.5), []);
    }
}
