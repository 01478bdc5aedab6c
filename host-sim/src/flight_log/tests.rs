//! Tests of the log: what the reader of the crate `mcap` finds in it. `.ci/interop/mcap_log.py` reads a
//! log with another reader and checks every message against its schema.

use std::collections::BTreeMap;

use mcap::MessageStream;

use super::*;
use crate::report::fixture;

/// Returns the messages of each topic with their times, and checks that times never go back.
fn read(file: &[u8]) -> BTreeMap<String, Vec<(u64, Value)>> {
    let mut topics: BTreeMap<String, Vec<(u64, Value)>> = BTreeMap::new();
    let mut last = 0;
    for message in MessageStream::new(file).expect("an MCAP file") {
        let message = message.expect("a message");
        assert!(message.log_time >= last, "time goes back");
        last = message.log_time;
        let value = serde_json::from_slice(&message.data).expect("JSON");
        let topic = topics.entry(message.channel.topic.clone()).or_default();
        topic.push((message.log_time, value));
    }
    topics
}

#[test]
fn every_slot_is_in_the_log_with_all_columns() {
    let record = fixture::separated();
    let topics = read(&mcap(&record).expect("a log"));
    let slots = &topics["/slots"];
    assert_eq!(slots.len(), record.slots.len());
    let schema = Topic::Slots.schema();
    let properties = schema["properties"].as_object().expect("properties");
    for ((time_ns, row), slot) in slots.iter().zip(&record.slots) {
        assert_eq!(*time_ns, nanoseconds(f64::from(slot.slot)));
        assert_eq!(row["rate_bit_s_hz"], slot.rate);
        assert_eq!(row["flown_east_m"], slot.flown.x);
        // The schema has no column that a row lacks, other than those of uncertain worlds.
        let row = row.as_object().expect("an object");
        assert!(row.keys().all(|name| properties.contains_key(name)));
        assert_eq!(row.len(), properties.len() - 3);
    }
    assert_eq!(topics["/vehicle/path"].len(), slots.len());
    let (_, last) = topics["/vehicle/path"].last().expect("a path");
    assert_eq!(
        last["poses"].as_array().map(Vec::len),
        Some(record.path.len())
    );
}

/// Events before the first slot, slots and positions are on one clock, which begins with the epoch.
#[test]
fn all_times_are_on_one_clock() {
    let mut record = fixture::separated();
    record.times.epoch_us = 1_000_000;
    record.times.first_slot_s = 20.0;
    for time_s in &mut record.times.slots_s {
        *time_s += 20.0;
    }
    record.events.push(crate::record::FlightEvent {
        time_s: 3.5,
        text: "armed".into(),
        notable: true,
    });
    let topics = read(&mcap(&record).expect("a log"));
    let (time_ns, event) = &topics["/events"][0];
    assert_eq!(*time_ns, 4_500_000_000);
    assert_eq!(event["timestamp"], json!({ "sec": 4, "nsec": 500_000_000 }));
    assert_eq!(
        (&event["message"], &event["level"]),
        (&json!("armed"), &json!(2))
    );
    assert_eq!(topics["/vehicle/pose"][0].0, 21_000_000_000);
    assert_eq!(topics["/slots"][0].0, 22_000_000_000);
    assert_eq!(topics["/scene"][0].0, 1_000_000_000);
}

/// The origin of the map is where the scenario says, and east and north are not confused.
#[test]
fn locations_are_on_earth() {
    let mut record = fixture::separated();
    record.path[0].position = Position::new(0.0, 0.0);
    record.path[1].position = Position::new(100.0, 0.0);
    let topics = read(&mcap(&record).expect("a log"));
    let [(_, first), (_, second), ..] = &topics["/vehicle/location"][..] else {
        panic!("no locations");
    };
    let origin = &record.scenario.origin;
    let degrees = |value: &Value| value.as_f64().expect("a number");
    assert!((degrees(&first["latitude"]) - origin.latitude_deg).abs() < 1e-7);
    assert!((degrees(&first["longitude"]) - origin.longitude_deg).abs() < 1e-7);
    let altitude_m = origin.elevation_m + record.path[0].altitude_m;
    assert_eq!(degrees(&first["altitude"]), altitude_m);
    assert!((degrees(&second["latitude"]) - degrees(&first["latitude"])).abs() < 1e-9);
    assert!(degrees(&second["longitude"]) > degrees(&first["longitude"]) + 5e-4);
}
