//! Gains from elsewhere, for example from a ray tracer: a CSV file with the power gain of every user
//! and sensor at the points of a grid.
//!
//! ```csv
//! node,index,east_m,north_m,power_gain
//! user,0,0,0,3.1e-10
//! sensor,0,0,0,8.2e-11
//! ```
//!
//! Columns and rows of the grid need not be equally spaced, and the lines may be in any order, but
//! every node of the mission must have a gain at every point, and the grid must cover the area.

use std::path::{Path, PathBuf};

use files::input;
use firmware_core::channel::{GroundNode, gain_map::GainMap};

use crate::{HostMission, digest::sha256, node_csv};

/// The first line of a file.
const HEADER: [&str; 5] = ["node", "index", "east_m", "north_m", "power_gain"];

/// A map that was read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LoadedMap {
    /// The file, independent of the working directory.
    pub(crate) path: PathBuf,
    /// The SHA-256 of the file, hexadecimal.
    pub(crate) digest: String,
    pub(crate) map: GainMap,
}

/// The gain of one node at one point of the grid.
struct Entry {
    line: u64,
    /// The users are first, then the sensors.
    node: usize,
    east_m: f64,
    north_m: f64,
    gain: f64,
}

/// Reads the map of a mission. The memory of the map is not freed: see [`GainMap`].
///
/// # Errors
/// Returns one line that names the file, the field, the value and what is allowed.
pub(crate) fn load(path: &Path, mission: &HostMission) -> Result<LoadedMap, String> {
    let named = |problem: String| format!("radio.gain_map: {}: {problem}", path.display());
    let content = input::read(path).map_err(|error| named(error.to_string()))?;
    let map = read(&content, mission).map_err(named)?;
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    Ok(LoadedMap {
        path,
        digest: sha256(&content),
        map,
    })
}

fn read(content: &[u8], mission: &HostMission) -> Result<GainMap, String> {
    let entries = entries(content, mission)?;
    let axis = |value: fn(&Entry) -> f64| {
        let mut axis: Vec<f64> = entries.iter().map(value).collect();
        axis.sort_by(f64::total_cmp);
        axis.dedup();
        axis
    };
    let (east_m, north_m) = (axis(|entry| entry.east_m), axis(|entry| entry.north_m));
    let area = mission.parameters().area;
    for (name, axis, extent_m) in [
        ("east_m", &east_m, area.east_m),
        ("north_m", &north_m, area.north_m),
    ] {
        // Without entries, the axis covers nothing.
        let (low, high) = (
            axis.first().copied().unwrap_or(f64::NAN),
            axis.last().copied().unwrap_or(f64::NAN),
        );
        if !(axis.len() > 1 && low <= 0.0 && high >= extent_m) {
            return Err(format!(
                "{name} goes from {low} to {high} m, but must cover the area, 0 to {extent_m} m"
            ));
        }
    }
    let (columns, rows) = (east_m.len(), north_m.len());
    let (users, nodes) = (
        mission.user_count(),
        mission.user_count() + mission.sensor_count(),
    );
    let name = |node: usize| match node.checked_sub(users) {
        None => format!("user {node}"),
        Some(sensor) => format!("sensor {sensor}"),
    };
    let mut counts = vec![0; nodes];
    for entry in &entries {
        counts[entry.node] += 1;
    }
    let points = columns.saturating_mul(rows);
    if let Some(node) = counts.iter().position(|&count| count != points) {
        return Err(format!(
            "{} has {} gains, but must have one at each of the {points} points of the grid \
             ({columns} values of east_m, {rows} of north_m)",
            name(node),
            counts[node]
        ));
    }
    // As many places as entries: each is used once, or an entry is a second one.
    let mut gains = vec![f64::NAN; entries.len()];
    let place = |axis: &[f64], value: f64| axis.partition_point(|&entry| entry < value);
    for entry in &entries {
        let row = entry.node * rows + place(&north_m, entry.north_m);
        let gain = &mut gains[row * columns + place(&east_m, entry.east_m)];
        if !gain.is_nan() {
            return Err(format!(
                "line {} is a second gain of {} at east_m {}, north_m {}",
                entry.line,
                name(entry.node),
                entry.east_m,
                entry.north_m
            ));
        }
        *gain = entry.gain;
    }
    let (east_m, north_m, gains) = (east_m.leak(), north_m.leak(), gains.leak());
    GainMap::new(east_m, north_m, users, gains).ok_or_else(|| "is not a grid of gains".into())
}

/// Returns the entries of a file.
fn entries(content: &[u8], mission: &HostMission) -> Result<Vec<Entry>, String> {
    let header = HEADER.join(",");
    if content.starts_with(b"PK") || content.starts_with(b"\x93NUMPY") {
        return Err(format!(
            "is a file of NumPy, but must be CSV with the first line `{header}`; docs/formats.md has \
             a converter"
        ));
    }
    let mut reader = node_csv::reader(content, &HEADER)?;
    let mut entries = Vec::new();
    let mut record = csv::StringRecord::new();
    loop {
        let more = reader.read_record(&mut record);
        if !more.map_err(|error| error.to_string())? {
            return Ok(entries);
        }
        let line = record.position().map_or(0, csv::Position::line);
        let entry = entry(line, &record, mission);
        entries.push(entry.map_err(|problem| format!("line {line}: {problem}"))?);
    }
}

fn entry(line: u64, record: &csv::StringRecord, mission: &HostMission) -> Result<Entry, String> {
    let [node, index, east_m, north_m, power_gain] = node_csv::values(record)?;
    let node = match node_csv::node(node, index, mission)? {
        GroundNode::User(user) => user,
        GroundNode::Sensor(sensor) => mission.user_count() + sensor,
    };
    let metres = |field: &str, cell: &str| {
        let value: Option<f64> = cell.parse().ok();
        let value = value.filter(|value| value.abs() <= 1e7);
        // The two zeros are one place.
        let value = value.map(|value| value + 0.0);
        value.ok_or_else(|| format!("{field} is `{cell}`, but must be a finite number of metres"))
    };
    let gain: Option<f64> = power_gain.parse().ok();
    let gain = gain.filter(|gain| (0.0..=1.0).contains(gain));
    Ok(Entry {
        line,
        node,
        east_m: metres("east_m", east_m)?,
        north_m: metres("north_m", north_m)?,
        gain: gain.ok_or_else(|| {
            format!(
                "power_gain is `{power_gain}`, but must be a number from 0 to 1 (received over \
                 transmitted power, not decibels)"
            )
        })?,
    })
}
