//! The topics of a flight's log and the JSON schemas of their messages.
//!
//! Programs recognize the messages of Foxglove by the names of their schemas. The schemas state the
//! fields that we write, with the names, types and units of
//! <https://docs.foxglove.dev/docs/sdk/schemas>; `/slots` has a schema of our own.

use serde_json::{Map, Value, json};

/// The topics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Topic {
    Location,
    Pose,
    Path,
    Scene,
    Slots,
    Events,
}

impl Topic {
    pub(super) const ALL: [Self; 6] = [
        Self::Location,
        Self::Pose,
        Self::Path,
        Self::Scene,
        Self::Slots,
        Self::Events,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Location => "/vehicle/location",
            Self::Pose => "/vehicle/pose",
            Self::Path => "/vehicle/path",
            Self::Scene => "/scene",
            Self::Slots => "/slots",
            Self::Events => "/events",
        }
    }

    pub(super) fn schema_name(self) -> &'static str {
        match self {
            Self::Location => "foxglove.LocationFix",
            Self::Pose => "foxglove.PoseInFrame",
            Self::Path => "foxglove.PosesInFrame",
            Self::Scene => "foxglove.SceneUpdate",
            Self::Slots => "aircomp_uav.Slot",
            Self::Events => "foxglove.Log",
        }
    }

    /// Returns the schema of the topic's messages.
    pub(super) fn schema(self) -> Value {
        let title = self.schema_name();
        match self {
            Self::Location => object(
                title,
                &[
                    ("timestamp", time()),
                    ("frame_id", text()),
                    ("latitude", number("degrees")),
                    ("longitude", number("degrees")),
                    ("altitude", number("m above mean sea level")),
                    ("position_covariance", covariance()),
                    ("position_covariance_type", choice(&[0, 1, 2, 3])),
                ],
            ),
            Self::Pose => object(
                title,
                &[
                    ("timestamp", time()),
                    ("frame_id", text()),
                    ("pose", pose()),
                ],
            ),
            Self::Path => object(
                title,
                &[
                    ("timestamp", time()),
                    ("frame_id", text()),
                    ("poses", list(pose())),
                ],
            ),
            Self::Scene => object(
                title,
                &[
                    ("deletions", list(deletion())),
                    ("entities", list(entity())),
                ],
            ),
            Self::Slots => slot(title),
            Self::Events => object(
                title,
                &[
                    ("timestamp", time()),
                    ("level", choice(&[0, 1, 2, 3, 4, 5])),
                    ("message", text()),
                    ("name", text()),
                    ("file", text()),
                    ("line", json!({ "type": "integer", "minimum": 0 })),
                ],
            ),
        }
    }
}

/// Returns the schema of an object, all of whose properties are required.
fn object(title: &str, properties: &[(&str, Value)]) -> Value {
    let required: Vec<&str> = properties.iter().map(|(name, _)| *name).collect();
    let properties = properties.iter().cloned();
    let properties: Map<String, Value> = properties
        .map(|(name, schema)| (name.to_owned(), schema))
        .collect();
    json!({ "title": title, "type": "object", "properties": properties, "required": required })
}

fn list(items: Value) -> Value {
    json!({ "type": "array", "items": items })
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn number(unit: &str) -> Value {
    json!({ "type": "number", "description": unit })
}

fn truth() -> Value {
    json!({ "type": "boolean" })
}

fn choice(values: &[u8]) -> Value {
    let constants: Vec<Value> = values
        .iter()
        .map(|value| json!({ "const": value }))
        .collect();
    json!({ "oneOf": constants })
}

fn time() -> Value {
    seconds("time", json!({ "type": "integer", "minimum": 0 }))
}

fn duration() -> Value {
    seconds("duration", json!({ "type": "integer" }))
}

fn seconds(title: &str, sec: Value) -> Value {
    let nsec = json!({ "type": "integer", "minimum": 0, "maximum": 999_999_999 });
    object(title, &[("sec", sec), ("nsec", nsec)])
}

fn covariance() -> Value {
    json!({ "type": "array", "items": { "type": "number" }, "minItems": 9, "maxItems": 9 })
}

fn vector(title: &str) -> Value {
    let component = || number("m");
    object(
        title,
        &[("x", component()), ("y", component()), ("z", component())],
    )
}

fn pose() -> Value {
    let part = || json!({ "type": "number" });
    let orientation = [("x", part()), ("y", part()), ("z", part()), ("w", part())];
    object(
        "foxglove.Pose",
        &[
            ("position", vector("foxglove.Vector3")),
            ("orientation", object("foxglove.Quaternion", &orientation)),
        ],
    )
}

fn color() -> Value {
    let part = || json!({ "type": "number", "minimum": 0, "maximum": 1 });
    let parts = [("r", part()), ("g", part()), ("b", part()), ("a", part())];
    object("foxglove.Color", &parts)
}

fn deletion() -> Value {
    object(
        "foxglove.SceneEntityDeletion",
        &[
            ("timestamp", time()),
            ("type", choice(&[0, 1])),
            ("id", text()),
        ],
    )
}

/// A visual element. Of the lists of primitives, those that we leave empty may hold any object.
fn entity() -> Value {
    let shape = |title: &str| {
        list(object(
            title,
            &[
                ("pose", pose()),
                ("size", vector("foxglove.Vector3")),
                ("color", color()),
            ],
        ))
    };
    let pair = [("key", text()), ("value", text())];
    let other = || list(json!({ "type": "object" }));
    object(
        "foxglove.SceneEntity",
        &[
            ("timestamp", time()),
            ("frame_id", text()),
            ("id", text()),
            ("lifetime", duration()),
            ("frame_locked", truth()),
            ("metadata", list(object("foxglove.KeyValuePair", &pair))),
            ("arrows", other()),
            ("cubes", shape("foxglove.CubePrimitive")),
            ("spheres", shape("foxglove.SpherePrimitive")),
            ("cylinders", other()),
            ("lines", list(line())),
            ("triangles", other()),
            ("texts", list(words())),
            ("models", other()),
        ],
    )
}

fn line() -> Value {
    let index = json!({ "type": "integer", "minimum": 0 });
    object(
        "foxglove.LinePrimitive",
        &[
            ("type", choice(&[0, 1, 2])),
            ("pose", pose()),
            ("thickness", number("m")),
            ("scale_invariant", truth()),
            ("points", list(vector("foxglove.Point3"))),
            ("color", color()),
            ("colors", list(color())),
            ("indices", list(index)),
        ],
    )
}

fn words() -> Value {
    object(
        "foxglove.TextPrimitive",
        &[
            ("pose", pose()),
            ("billboard", truth()),
            ("font_size", number("m")),
            ("scale_invariant", truth()),
            ("color", color()),
            ("text", text()),
        ],
    )
}

/// The quantities of a slot: the columns of `slots.csv`, their types and their units. A number is `null`
/// if it is not finite.
const SLOT: [(&str, &str, &str); 26] = [
    ("slot", "integer", "n, from 1"),
    ("planned_east_m", "number", "m, the waypoint"),
    ("planned_north_m", "number", "m, the waypoint"),
    (
        "flown_east_m",
        "number",
        "m, the true position at the end of the slot",
    ),
    (
        "flown_north_m",
        "number",
        "m, the true position at the end of the slot",
    ),
    (
        "vehicle_time_s",
        "number",
        "s, the end of the slot on the vehicle's clock",
    ),
    ("extrapolated", "boolean", "the position was extrapolated"),
    (
        "served_user",
        "integer",
        "from 0; null if no user was received",
    ),
    ("user_power_w", "number", "W"),
    ("sensor_power_mean_w", "number", "W, mean over the sensors"),
    ("normalizing_factor", "number", "1/sqrt(W), eta"),
    ("rate_bit_s_hz", "number", "bit/s/Hz, R_n"),
    ("mse", "number", "MSE_n at the true channels"),
    ("mse_threshold", "number", "Gamma"),
    ("limited_by", "string", "accuracy, power or none"),
    ("feasible", "boolean", "Gamma could be met"),
    (
        "shield",
        "string",
        "what the shield changed, separated by +",
    ),
    ("channel_source", "string", "measured or predicted"),
    (
        "age_slots",
        "integer",
        "slots, the age of the channel state",
    ),
    ("empirical_mse", "number", "MSE of the drawn signals"),
    ("symbols", "integer", "number of drawn signals"),
    (
        "true_value",
        "number",
        "the function of the measurements, in the scenario's unit",
    ),
    (
        "estimate",
        "number",
        "its estimate over the air, in the scenario's unit",
    ),
    (
        "error",
        "number",
        "estimate less true value, in the scenario's unit",
    ),
    (
        "plan_us",
        "number",
        "microseconds of processor time to plan",
    ),
    (
        "allocate_us",
        "number",
        "microseconds of processor time to allocate",
    ),
];

/// The quantities that a slot has in addition if the scenario has a table `[uncertainty]`.
const KNOWLEDGE: [(&str, &str, &str); 3] = [
    (
        "perfect_rate_bit_s_hz",
        "number",
        "bit/s/Hz, if all channels were known exactly",
    ),
    (
        "empirical_mse_standard_error",
        "number",
        "standard error of empirical_mse",
    ),
    (
        "at_error_floor",
        "boolean",
        "the estimates were too poor for Gamma",
    ),
];

fn slot(title: &str) -> Value {
    let property = |&(name, kind, meaning): &(&str, &str, &str)| {
        let may_be_missing = kind == "number" || name == "served_user";
        let kind = if may_be_missing {
            json!([kind, "null"])
        } else {
            json!(kind)
        };
        (
            name.to_owned(),
            json!({ "type": kind, "description": meaning }),
        )
    };
    let properties: Map<String, Value> = SLOT.iter().chain(&KNOWLEDGE).map(property).collect();
    let required: Vec<&str> = SLOT.iter().map(|(name, ..)| *name).collect();
    json!({
        "title": title,
        "description": "A slot of a flight: the row of slots.csv",
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": false,
    })
}
