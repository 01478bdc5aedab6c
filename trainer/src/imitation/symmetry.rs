//! Reflections of a mission: the channel depends on distances only, so a reflected plan is the plan
//! of the reflected mission.

use firmware_core::{Mission, Position, mission::Area};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use scenario::HostMission;

/// One of the eight symmetries of the axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Symmetry {
    /// East becomes west.
    pub flip_east: bool,
    /// North becomes south.
    pub flip_north: bool,
    /// East and north are exchanged, after the flips.
    pub transpose: bool,
}

impl Symmetry {
    /// Draws one of the eight.
    pub fn random(rng: &mut Pcg64Mcg) -> Self {
        Self {
            flip_east: rng.random(),
            flip_north: rng.random(),
            transpose: rng.random(),
        }
    }

    /// Returns the image of a place in an area.
    pub fn place(self, area: &Area<f64>, place: &Position<f64>) -> Position<f64> {
        let flipped = |flip: bool, x: f64, extent: f64| if flip { extent - x } else { x };
        let east = flipped(self.flip_east, place.x, area.east_m);
        let north = flipped(self.flip_north, place.y, area.north_m);
        match self.transpose {
            true => Position::new(north, east),
            false => Position::new(east, north),
        }
    }

    /// Returns the image of a displacement.
    pub fn displacement(self, [east, north]: [f32; 2]) -> [f32; 2] {
        let east = if self.flip_east { -east } else { east };
        let north = if self.flip_north { -north } else { north };
        match self.transpose {
            true => [north, east],
            false => [east, north],
        }
    }

    /// Returns the image of a mission without a gain map.
    pub fn mission(self, mission: &HostMission) -> HostMission {
        let mut parameters = mission.parameters().clone();
        let area = parameters.area;
        let image = |place: &mut Position<f64>| *place = self.place(&area, place);
        parameters.users.iter_mut().for_each(image);
        parameters.sensors.iter_mut().for_each(image);
        image(&mut parameters.start);
        image(&mut parameters.destination);
        if self.transpose {
            parameters.area = Area {
                east_m: area.north_m,
                north_m: area.east_m,
            };
        }
        // Reflections keep every condition on a mission, up to rounding at the limits.
        Mission::new(parameters).unwrap_or_else(|_| mission.clone())
    }
}
