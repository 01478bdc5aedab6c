//! A flight as an MCAP file (<https://mcap.dev>), which Foxglove and other programs replay.
//!
//! | topic | schema | content |
//! |---|---|---|
//! | `/vehicle/location` | `foxglove.LocationFix` | the true position on Earth, at most 10 times a second |
//! | `/vehicle/pose` | `foxglove.PoseInFrame` | the same in the frame `map`: metres east, north and up |
//! | `/vehicle/path` | `foxglove.PosesInFrame` | the path so far, after each slot |
//! | `/scene` | `foxglove.SceneUpdate` | the area, users and sensors; after each slot a line to the served user |
//! | `/slots` | `aircomp_uav.Slot` | the row of `slots.csv` |
//! | `/events` | `foxglove.Log` | the events of the autopilot and its client |
//!
//! Messages are JSON, and their schemas are JSON Schema. Times are those of the flight, from the date
//! with which `mavlink.tlog` begins; the messages are in the order of their times. The file has one
//! metadata record, `mission`.

mod scene;
mod schema;

use std::{collections::BTreeMap, io::Cursor};

use firmware_core::Position;
use mcap::{
    WriteOptions, Writer,
    records::{MessageHeader, Metadata},
};
use serde_json::{Value, json};

use crate::{
    record::{FlightRecord, PathSample, SlotRecord},
    report::slots_csv,
};
use schema::Topic;

/// The shortest time between two positions of the vehicle, seconds. A sample every 10 ms, as the
/// record has it, would make a file of tens of megabytes.
const POSITION_INTERVAL_S: f64 = 0.1;

/// The frame of all coordinates: metres east, north and up from the origin of the map.
const FRAME: &str = "map";

/// A message at a time since the client started, nanoseconds.
struct Message {
    time_ns: u64,
    topic: Topic,
    value: Value,
}

/// A time as Foxglove's messages have it.
fn stamp(record: &FlightRecord, time_ns: u64) -> Value {
    let ns = record.times.epoch_us * 1000 + time_ns;
    json!({ "sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000 })
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds.max(0.0) * 1e9).round() as u64
}

/// Returns the contents of the file.
///
/// # Errors
/// Returns a message of one line if a record does not fit the format.
pub fn mcap(record: &FlightRecord) -> Result<Vec<u8>, String> {
    write(record).map_err(|error| error.to_string())
}

fn write(record: &FlightRecord) -> mcap::McapResult<Vec<u8>> {
    let mut file = Cursor::new(Vec::new());
    let options = WriteOptions::new()
        .compression(None)
        .profile("")
        .library(concat!("host-sim ", env!("CARGO_PKG_VERSION")));
    let mut writer = Writer::with_options(&mut file, options)?;
    let mut channels = BTreeMap::new();
    for topic in Topic::ALL {
        let schema = serde_json::to_vec(&topic.schema()).map_err(std::io::Error::from)?;
        let schema = writer.add_schema(topic.schema_name(), "jsonschema", &schema)?;
        let channel = writer.add_channel(schema, topic.name(), "json", &BTreeMap::new())?;
        channels.insert(topic, (channel, 0));
    }
    writer.write_metadata(&Metadata {
        name: "mission".into(),
        metadata: mission(record),
    })?;
    let mut messages = messages(record);
    // A stable sort: messages of one time keep the order in which they were made.
    messages.sort_by_key(|message| message.time_ns);
    for Message {
        time_ns,
        topic,
        value,
    } in messages
    {
        let Some((channel_id, sequence)) = channels.get_mut(&topic) else {
            continue;
        };
        let time = record.times.epoch_us * 1000 + time_ns;
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time: time,
            publish_time: time,
        };
        *sequence += 1;
        let data = serde_json::to_vec(&value).map_err(std::io::Error::from)?;
        writer.write_to_known_channel(&header, &data)?;
    }
    writer.finish()?;
    drop(writer);
    Ok(file.into_inner())
}

/// Returns what the flight was, in words.
fn mission(record: &FlightRecord) -> BTreeMap<String, String> {
    let entries = [
        ("scenario", record.scenario.name.clone()),
        ("scenario_digest", record.scenario.digest()),
        ("policy", record.policy.clone()),
        ("inner", record.inner.clone()),
        ("profile", record.profile.clone()),
        ("seed", record.seed.to_string()),
        ("ended", record.ended.clone()),
    ];
    entries.map(|(name, value)| (name.into(), value)).into()
}

/// Returns all messages.
fn messages(record: &FlightRecord) -> Vec<Message> {
    let mut messages = vec![Message {
        time_ns: 0,
        topic: Topic::Scene,
        value: scene::ground(record, &stamp(record, 0)),
    }];
    for event in &record.events {
        let time_ns = nanoseconds(event.time_s);
        messages.push(Message {
            time_ns,
            topic: Topic::Events,
            value: json!({
                "timestamp": stamp(record, time_ns),
                "level": if event.notable { LOG_INFO } else { LOG_DEBUG },
                "message": event.text,
                "name": "host-sim",
                "file": "",
                "line": 0,
            }),
        });
    }
    let path = positions(record);
    for (time_ns, sample) in &path {
        let timestamp = stamp(record, *time_ns);
        messages.push(Message {
            time_ns: *time_ns,
            topic: Topic::Location,
            value: location(record, sample, &timestamp),
        });
        messages.push(Message {
            time_ns: *time_ns,
            topic: Topic::Pose,
            value: json!({
                "timestamp": timestamp,
                "frame_id": FRAME,
                "pose": pose(sample.position, sample.altitude_m),
            }),
        });
    }
    for (slot, &time_s) in record.slots.iter().zip(&record.times.slots_s) {
        let time_ns = nanoseconds(time_s);
        let timestamp = stamp(record, time_ns);
        messages.push(Message {
            time_ns,
            topic: Topic::Slots,
            value: slot_row(record, slot),
        });
        messages.push(Message {
            time_ns,
            topic: Topic::Scene,
            value: scene::service(record, slot, &timestamp),
        });
        let flown = path.iter().take_while(|(time, _)| *time <= time_ns);
        let poses: Vec<Value> = flown
            .map(|(_, sample)| pose(sample.position, sample.altitude_m))
            .collect();
        messages.push(Message {
            time_ns,
            topic: Topic::Path,
            value: json!({ "timestamp": timestamp, "frame_id": FRAME, "poses": poses }),
        });
    }
    messages
}

/// Levels of `foxglove.Log`.
const LOG_DEBUG: u8 = 1;
const LOG_INFO: u8 = 2;

/// Returns the samples of the path that are written, with their times since the client started.
fn positions(record: &FlightRecord) -> Vec<(u64, PathSample)> {
    let mut kept: Vec<(u64, PathSample)> = Vec::new();
    let mut last_s = f64::NEG_INFINITY;
    for (index, sample) in record.path.iter().enumerate() {
        let is_last = index + 1 == record.path.len();
        // The times are multiples of 10 ms, up to rounding.
        if sample.time_s - last_s >= POSITION_INTERVAL_S - 1e-6 || is_last {
            last_s = sample.time_s;
            let time_s = record.times.first_slot_s + sample.time_s;
            kept.push((nanoseconds(time_s), *sample));
        }
    }
    kept
}

fn location(record: &FlightRecord, sample: &PathSample, timestamp: &Value) -> Value {
    let place = record.scenario.map_origin().offset(sample.position.coords);
    json!({
        "timestamp": timestamp,
        "frame_id": FRAME,
        "latitude": f64::from(place.latitude_e7) / 1e7,
        "longitude": f64::from(place.longitude_e7) / 1e7,
        "altitude": record.scenario.origin.elevation_m + sample.altitude_m,
        // The position is the simulated vehicle's true one.
        "position_covariance": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        "position_covariance_type": COVARIANCE_UNKNOWN,
    })
}

/// `UNKNOWN` of `foxglove.PositionCovarianceType`.
const COVARIANCE_UNKNOWN: u8 = 0;

/// Returns a position as a pose without rotation.
fn pose(position: Position<f64>, up_m: f64) -> Value {
    json!({
        "position": { "x": position.x, "y": position.y, "z": up_m },
        "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
    })
}

/// Returns the row of a slot with the names of `slots.csv`. A number that is not finite is `null`.
fn slot_row(record: &FlightRecord, slot: &SlotRecord) -> Value {
    let mut row = json!(slots_csv::row(record, slot));
    if let Some(knowledge) = slots_csv::knowledge(record, slot)
        && let (Value::Object(row), Value::Object(knowledge)) = (&mut row, json!(knowledge))
    {
        row.extend(knowledge);
    }
    row
}

#[cfg(test)]
mod tests;
