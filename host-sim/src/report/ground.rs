//! The background of a map: the visible region, its scale, grid, border, scale bar and north arrow.

use firmware_core::Position;

use crate::record::FlightRecord;
use figures::{
    axis::{LEFT, RIGHT, Scale, round_step},
    markup::{Element, PathData, element, label, line, rectangle},
    quantity::plain,
};
use scenario::Scenario;

/// The largest height of a map.
const HEIGHT_MAX: f64 = 560.0;

/// The projection from metres to coordinates of the drawing, with north up and one scale for both
/// axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ground {
    /// A corner of the visible region, metres.
    south_west: Position<f64>,
    /// A corner of the visible region, metres.
    north_east: Position<f64>,
    /// The upper left corner of the visible region in the drawing.
    pub(super) corner: [f64; 2],
    /// The size of the visible region in the drawing.
    pub(super) size: [f64; 2],
    units_per_m: f64,
}

impl Ground {
    /// Creates the projection for the mission's area and all waypoints and positions outside it. The
    /// drawing begins at the vertical coordinate `top`.
    pub(super) fn new(scenario: &Scenario, flight: Option<&FlightRecord>, top: f64) -> Self {
        let area = &scenario.mission.parameters().area;
        let mut south_west = Position::new(0.0, 0.0);
        let mut north_east = Position::new(area.east_m, area.north_m);
        if let Some(record) = flight {
            let slots = record.slots.iter();
            let sampled = record.path.iter().map(|sample| sample.position);
            let places = slots.flat_map(|slot| [slot.planned, slot.flown]);
            let step_m = view_step_m(&south_west, &north_east);
            for place in places.chain(sampled) {
                // A tiny distance outside the area is a rounding error and must not change the map.
                if !place.iter().all(|value| value.is_finite()) || area.contains(&place) {
                    continue;
                }
                let room = |value: f64| (value / step_m * 4.0 + 1e-3).floor() * step_m / 4.0;
                south_west = south_west.inf(&place.map(room));
                north_east = north_east.sup(&place.map(|value| -room(-value)));
            }
        }
        let extent_m = north_east - south_west;
        let units_per_m = ((RIGHT - LEFT) / extent_m.x).min(HEIGHT_MAX / extent_m.y);
        let size = [extent_m.x * units_per_m, extent_m.y * units_per_m];
        Self {
            south_west,
            north_east,
            corner: [LEFT + (RIGHT - LEFT - size[0]) / 2.0, top],
            size,
            units_per_m,
        }
    }

    /// Returns the coordinates of a position in the drawing.
    pub(super) fn of(&self, place: &Position<f64>) -> [f64; 2] {
        [
            self.corner[0] + (place.x - self.south_west.x) * self.units_per_m,
            self.corner[1] + (self.north_east.y - place.y) * self.units_per_m,
        ]
    }

    /// Draws the area with grid, axes and border.
    pub(super) fn draw(&self, scenario: &Scenario) -> Element {
        let area = &scenario.mission.parameters().area;
        let [west, top] = self.corner;
        let [width, height] = self.size;
        let [east, south] = [west + width, top + height];
        let area_corner = self.of(&Position::new(0.0, area.north_m));
        let area_size = [area.east_m, area.north_m].map(|extent| extent * self.units_per_m);
        let mut group = element("g").with(rectangle("ground", area_corner, area_size));
        let step_m = view_step_m(&self.south_west, &self.north_east);
        let ticks = |low_m: f64, high_m: f64| {
            let about = ((high_m - low_m) / step_m).max(1.0);
            Scale::linear([low_m, high_m], [0.0, 1.0]).ticks(about as usize)
        };
        // A narrow map has not enough space for all numbers side by side.
        let every = |number: usize, room: f64, size: f64| {
            let fits = |every: &usize| number.div_ceil(*every) as f64 * size < room + size;
            (1..number).find(fits).unwrap_or(number.max(1))
        };
        let easts = ticks(self.south_west.x, self.north_east.x);
        let numbered = every(easts.len(), width, 34.0);
        for (index, tick) in easts.into_iter().enumerate() {
            let [x, _] = self.of(&Position::new(tick.value, 0.0));
            group.push(line("grid", [x, top], [x, south]));
            if index % numbered == 0 {
                group.push(label("tick middle", [x, south + 16.0], tick.label));
            }
        }
        let norths = ticks(self.south_west.y, self.north_east.y);
        let numbered = every(norths.len(), height, 16.0);
        for (index, tick) in norths.into_iter().enumerate() {
            let [_, y] = self.of(&Position::new(0.0, tick.value));
            group.push(line("grid", [west, y], [east, y]));
            if index % numbered == 0 {
                group.push(label("tick end", [west - 7.0, y + 4.0], tick.label));
            }
        }
        let [title_x, title_y] = [west - 50.0, top + height / 2.0];
        group
            .with(rectangle("border", area_corner, area_size))
            .with(label(
                "axis middle",
                [west + width / 2.0, south + 33.0],
                "east (m)",
            ))
            .with(
                label("axis middle", [title_x, title_y], "north (m)")
                    .set("transform", format!("rotate(-90 {title_x} {title_y})")),
            )
    }

    /// Returns a round length of about an eighth of the visible region.
    pub(super) fn scale_bar(&self, [x, y]: [f64; 2]) -> Element {
        let length_m = round_step(60.0 / self.units_per_m);
        let end = x + length_m * self.units_per_m;
        let ticks = [[x, y - 9.0], [x, y - 4.0], [end, y - 4.0], [end, y - 9.0]];
        let length = if length_m >= 1000.0 {
            format!("{} km", plain(length_m / 1000.0))
        } else {
            format!("{} m", plain(length_m))
        };
        element("g")
            .with(PathData::through(ticks).path("ruler"))
            .with(label("tick middle", [(x + end) / 2.0, y + 13.0], length))
    }
}

/// Returns the distance between grid lines, metres.
fn view_step_m(south_west: &Position<f64>, north_east: &Position<f64>) -> f64 {
    round_step((north_east - south_west).max() / 5.5)
}

/// Draws the north arrow.
pub(super) fn north([x, y]: [f64; 2]) -> Element {
    let needle = PathData::through([
        [x, y - 17.0],
        [x + 5.0, y],
        [x, y - 3.5],
        [x - 5.0, y],
        [x, y - 17.0],
    ]);
    element("g")
        .with(needle.path("needle"))
        .with(label("tick middle", [x, y + 13.0], "N"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fixture;

    #[test]
    fn everything_flown_is_in_view() {
        let mut record = fixture::separated();
        let inside = Ground::new(&record.scenario, Some(&record), 0.0);
        assert_eq!(inside.south_west, Position::new(0.0, 0.0));
        assert_eq!(inside.north_east, Position::new(1000.0, 1000.0));
        record.slots[7].flown = Position::new(-330.0, 1210.0);
        record.slots[8].planned = Position::new(f64::NAN, 0.0);
        let wider = Ground::new(&record.scenario, Some(&record), 0.0);
        let [x, y] = wider.of(&record.slots[7].flown);
        let [west, top] = wider.corner;
        assert!(x > west && y > top, "{x}, {y}");
        assert!(wider.south_west.x > -500.0 && wider.north_east.x == 1000.0);
    }
}
