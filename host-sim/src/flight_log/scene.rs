//! The scene of a flight: the area, the users and the sensors, and whom the vehicle serves.

use firmware_core::Position;
use serde_json::{Value, json};

use super::{FRAME, pose};
use crate::record::{FlightRecord, SlotRecord};

/// Diameters of the nodes, metres. The areas of missions are hundreds of metres wide.
const USER_SIZE_M: f64 = 16.0;
const SENSOR_SIZE_M: f64 = 10.0;
const FONT_SIZE_M: f64 = 18.0;

/// Kinds of `foxglove.LinePrimitive`.
const LINE_STRIP: u8 = 0;
const LINE_LOOP: u8 = 1;

/// Colours: red, green, blue, opacity.
type Rgba = [f64; 4];
const USER: Rgba = [0.0, 0.45, 0.70, 1.0];
const SENSOR: Rgba = [0.0, 0.62, 0.45, 1.0];
const SERVED: Rgba = [0.84, 0.37, 0.0, 1.0];
const AREA: Rgba = [0.5, 0.5, 0.5, 1.0];
const MARK: Rgba = [0.2, 0.2, 0.2, 1.0];

/// Returns what does not change: area, start, destination, sensors, and the users as they are named in
/// `slots.csv`.
pub(super) fn ground(record: &FlightRecord, timestamp: &Value) -> Value {
    let p = record.scenario.mission.parameters();
    let (east_m, north_m) = (p.area.east_m, p.area.north_m);
    let corners = [[0.0, 0.0], [east_m, 0.0], [east_m, north_m], [0.0, north_m]];
    let corners = corners.map(|[x, y]| point(Position::new(x, y), 0.0));
    let ends = [("start", p.start), ("destination", p.destination)];
    let users = p.users.iter().enumerate();
    let entities = [
        Entity {
            lines: vec![line(LINE_LOOP, &corners, AREA)],
            texts: ends.map(|(name, place)| words(name, place)).into(),
            ..Entity::default()
        }
        .named("area", timestamp),
        Entity {
            cubes: (p.sensors.iter())
                .map(|&place| shape(place, SENSOR_SIZE_M, SENSOR))
                .collect(),
            ..Entity::default()
        }
        .named("sensors", timestamp),
        Entity {
            spheres: (p.users.iter())
                .map(|&place| shape(place, USER_SIZE_M, USER))
                .collect(),
            texts: users
                .map(|(user, &place)| words(&format!("u{user}"), place))
                .collect(),
            ..Entity::default()
        }
        .named("users", timestamp),
    ];
    json!({ "deletions": [], "entities": entities })
}

/// Returns the service of a slot: a line from the vehicle to the user. It replaces that of the slot
/// before.
pub(super) fn service(record: &FlightRecord, slot: &SlotRecord, timestamp: &Value) -> Value {
    let timeline = record.timeline();
    let mission = timeline.in_slot(slot.slot);
    let p = mission.parameters();
    let user = slot.served_user.and_then(|user| p.users.get(user));
    let mut entity = Entity::default();
    if let Some(&user) = user {
        let ends = [point(slot.flown, p.altitude_m), point(user, 0.0)];
        entity.lines = vec![line(LINE_STRIP, &ends, SERVED)];
        entity.spheres = vec![shape(user, 1.5 * USER_SIZE_M, SERVED)];
    }
    json!({ "deletions": [], "entities": [entity.named("service", timestamp)] })
}

/// The primitives of an entity that we use.
#[derive(Default)]
struct Entity {
    cubes: Vec<Value>,
    spheres: Vec<Value>,
    lines: Vec<Value>,
    texts: Vec<Value>,
}

impl Entity {
    /// Returns the entity with this identifier. It stays until another one replaces it.
    fn named(self, id: &str, timestamp: &Value) -> Value {
        json!({
            "timestamp": timestamp,
            "frame_id": FRAME,
            "id": id,
            "lifetime": { "sec": 0, "nsec": 0 },
            "frame_locked": false,
            "metadata": [],
            "arrows": [],
            "cubes": self.cubes,
            "spheres": self.spheres,
            "cylinders": [],
            "lines": self.lines,
            "triangles": [],
            "texts": self.texts,
            "models": [],
        })
    }
}

fn color([r, g, b, a]: Rgba) -> Value {
    json!({ "r": r, "g": g, "b": b, "a": a })
}

fn point(position: Position<f64>, up_m: f64) -> Value {
    json!({ "x": position.x, "y": position.y, "z": up_m })
}

fn shape(place: Position<f64>, size_m: f64, rgba: Rgba) -> Value {
    json!({
        "pose": pose(place, 0.0),
        "size": { "x": size_m, "y": size_m, "z": size_m },
        "color": color(rgba),
    })
}

fn words(text: &str, place: Position<f64>) -> Value {
    json!({
        "pose": pose(place, USER_SIZE_M),
        "billboard": true,
        "font_size": FONT_SIZE_M,
        "scale_invariant": false,
        "color": color(MARK),
        "text": text,
    })
}

fn line(kind: u8, points: &[Value], rgba: Rgba) -> Value {
    json!({
        "type": kind,
        "pose": pose(Position::origin(), 0.0),
        "thickness": 2.0,
        "scale_invariant": true,
        "points": points,
        "color": color(rgba),
        "colors": [],
        "indices": [],
    })
}
