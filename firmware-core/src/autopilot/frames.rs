// SPDX-License-Identifier: MIT OR Apache-2.0
//! Conversions between the map and MAVLink's frames: the only module in which north, east and down
//! appear.
//!
//! The map has x east and y north, in metres, with its origin at the scenario's latitude and
//! longitude. MAVLink's local frame has x north, y east, z down, with its origin where the
//! autopilot's estimator started, which need not be the map's: [`MapFrame`] holds the difference.
//! Geodetic coordinates are converted to metres as the autopilot itself does it (a sphere of
//! [`EARTH_RADIUS_M`], the longitude scaled by the cosine of the latitude), so that a waypoint is
//! the same place in both kinds of coordinates.

use nalgebra::Vector2;

use crate::scalar::{Displacement, Position, Scalar};

/// The radius of the sphere in ArduPilot's flat-earth formulas, metres. PX4's is 0.1 % smaller: a
/// waypoint 1 km from the origin differs by 1.1 m between the two.
pub const EARTH_RADIUS_M: f64 = 6_378_100.0;

/// Latitude and longitude in MAVLink's unit, 1e-7 degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Geodetic {
    /// North positive, 1e-7 degrees.
    pub latitude_e7: i32,
    /// East positive, 1e-7 degrees.
    pub longitude_e7: i32,
}

const METRES_PER_E7: f64 = EARTH_RADIUS_M * core::f64::consts::PI / 180.0 * 1e-7;

impl Geodetic {
    /// Converts from degrees. Returns `None` outside -90..90 and -180..180, or for NaN.
    pub fn from_degrees(latitude_deg: f64, longitude_deg: f64) -> Option<Self> {
        let inside = libm::fabs(latitude_deg) <= 90.0 && libm::fabs(longitude_deg) <= 180.0;
        inside.then(|| Self {
            latitude_e7: libm::round(latitude_deg * 1e7) as i32,
            longitude_e7: libm::round(longitude_deg * 1e7) as i32,
        })
    }

    fn metres_per_e7_east(self) -> f64 {
        let latitude = f64::from(self.latitude_e7) * 1e-7;
        METRES_PER_E7 * libm::cos(latitude.to_radians()).max(1e-6)
    }

    /// Returns the displacement from here to `other`, metres east and north.
    pub fn displacement_to<T: Scalar>(self, other: Self) -> Displacement<T> {
        let north = i64::from(other.latitude_e7) - i64::from(self.latitude_e7);
        let east = i64::from(other.longitude_e7) - i64::from(self.longitude_e7);
        Vector2::new(
            T::of(east as f64 * self.metres_per_e7_east()),
            T::of(north as f64 * METRES_PER_E7),
        )
    }

    /// Returns the place that is displaced by that many metres east and north.
    pub fn offset<T: Scalar>(self, by: Displacement<T>) -> Self {
        let east = libm::round(by.x.to_f64() / self.metres_per_e7_east());
        let north = libm::round(by.y.to_f64() / METRES_PER_E7);
        Self {
            latitude_e7: self.latitude_e7.saturating_add(north as i32),
            longitude_e7: self.longitude_e7.saturating_add(east as i32),
        }
    }
}

/// The position of the map on Earth, and of the autopilot's local frame on the map.
#[derive(Clone, Copy, Debug)]
pub struct MapFrame<T: Scalar> {
    origin: Geodetic,
    /// The local frame's origin on the map, m.
    local_origin: Displacement<T>,
}

impl<T: Scalar> MapFrame<T> {
    /// Creates a map with this origin. The local frame has the same origin until
    /// [`MapFrame::set_local_origin`] is called.
    pub fn new(origin: Geodetic) -> Self {
        Self {
            origin,
            local_origin: Vector2::zeros(),
        }
    }

    /// Returns the map's origin.
    pub fn origin(&self) -> Geodetic {
        self.origin
    }

    /// Sets the origin of the autopilot's local frame. Returns the displacement of everything that
    /// was placed on the map before.
    pub fn set_local_origin(&mut self, origin: Geodetic) -> Displacement<T> {
        let before = self.local_origin;
        self.local_origin = self.origin.displacement_to(origin);
        self.local_origin - before
    }

    /// Returns the map position of a local north, east.
    pub fn from_local(&self, north: f32, east: f32) -> Position<T> {
        Position::from(vector_from_ned(north, east) + self.local_origin)
    }

    /// Returns the local north, east of a map position.
    pub fn to_local(&self, position: Position<T>) -> (f32, f32) {
        vector_to_ned(position.coords - self.local_origin)
    }

    /// Returns the map position of a place on Earth.
    pub fn from_geodetic(&self, place: Geodetic) -> Position<T> {
        Position::from(self.origin.displacement_to(place))
    }

    /// Returns the place on Earth of a map position.
    pub fn to_geodetic(&self, position: Position<T>) -> Geodetic {
        self.origin.offset(position.coords)
    }
}

/// Converts north and east components to a map vector.
pub fn vector_from_ned<T: Scalar>(north: f32, east: f32) -> Displacement<T> {
    Vector2::new(T::of(f64::from(east)), T::of(f64::from(north)))
}

/// Converts a map vector to north and east components.
pub fn vector_to_ned<T: Scalar>(vector: Displacement<T>) -> (f32, f32) {
    (vector.y.to_f64() as f32, vector.x.to_f64() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn east_and_north_are_not_confused() {
        let frame = MapFrame::<f64>::new(Geodetic::default());
        assert_eq!(frame.from_local(3.0, 4.0), Position::new(4.0, 3.0));
        assert_eq!(frame.to_local(Position::new(4.0, 3.0)), (3.0, 4.0));
    }

    #[test]
    fn both_kinds_of_coordinates_mean_the_same_place() {
        let origin = Geodetic::from_degrees(47.3977, 8.5456).unwrap();
        let mut frame = MapFrame::<f64>::new(origin);
        // The estimator started 300 m east and 200 m south of the map's origin.
        frame.set_local_origin(origin.offset(Vector2::new(300.0, -200.0)));
        let place = Position::new(812.5, 377.25);
        let (north, east) = frame.to_local(place);
        assert!((f64::from(north) - 577.25).abs() < 0.02, "{north}");
        assert!((f64::from(east) - 512.5).abs() < 0.02, "{east}");
        let back = frame.from_geodetic(frame.to_geodetic(place));
        assert!((back - place).norm() < 0.02, "{back}");
    }

    #[test]
    fn places_off_the_earth_are_refused() {
        assert_eq!(Geodetic::from_degrees(91.0, 0.0), None);
        assert_eq!(Geodetic::from_degrees(0.0, f64::NAN), None);
    }
}
