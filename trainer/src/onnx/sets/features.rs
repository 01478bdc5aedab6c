//! The features of an observation, as [`firmware_core::policy::sets::features`] computes them.

use firmware_core::policy::sets::{
    MISSION_COLUMN_NAMES, PLACES, SENSOR_COLUMN_NAMES, USER_COLUMN_NAMES,
    features::{DIFFERENCE_FACTOR, DISTANCE_UNIT_M, RATE_LIMIT_MIN},
};

use super::operators::Operators;

/// The axis of columns: every value has three axes.
const COLUMNS: i64 = 2;

/// An input with named columns.
#[derive(Clone, Copy)]
struct Columns<'a> {
    value: &'a str,
    names: &'a [&'a str],
}

impl Columns<'_> {
    /// Returns one column.
    fn column(&self, g: &mut Operators, name: &str) -> String {
        self.columns(g, name, 1)
    }

    /// Returns `count` columns from the one that is named on.
    fn columns(&self, g: &mut Operators, name: &str, count: usize) -> String {
        let found = self.names.iter().position(|&column| column == name);
        let begin = found.expect("a column of the observation") as i64;
        g.slice(self.value, COLUMNS, begin, begin + count as i64)
    }
}

fn mission_columns(value: &str) -> Columns<'_> {
    let names = &MISSION_COLUMN_NAMES;
    Columns { value, names }
}

/// Returns the features of the mission, \[1, 1, 69\], from `mission`, \[1, 1, 44\].
pub(super) fn mission(g: &mut Operators, mission: &str) -> String {
    let columns = mission_columns(mission);
    let offset = columns.columns(g, "destination_east_m", 2);
    let reach = columns.column(g, "reach_m");
    let (slots, left) = (columns.column(g, "slots"), columns.column(g, "slots_left"));
    let sensors = columns.column(g, "sensors");
    let limit = columns.column(g, "slot_rate_limit");
    let left_or_one = g.with_number("Max", &left, 1.0);

    let [place, distance] = place(g, &offset);
    let range = g.apply("Mul", &[&reach, &left_or_one]);
    let way = g.apply("Div", &[&distance, &range]);
    let threshold = columns.column(g, "mse_threshold");
    let owed = columns.column(g, "slots_owed");
    let free = g.apply("Sub", &[&left, &owed]);
    let free = g.apply("Div", &[&free, &left_or_one]);
    let mut parts = vec![
        place,
        g.clip(&way),
        g.divide_at_least(&left, &slots, 1.0),
        scaled(g, &left, 50.0),
        scaled(g, &reach, 30.0),
        g.apply("Mul", &[&sensors, &threshold]),
        g.with_number("Div", &sensors, 64.0),
    ];
    let users = columns.column(g, "users");
    parts.push(g.with_number("Div", &users, 16.0));
    parts.push(scaled(g, &limit, 2.0));
    parts.push(g.clip(&free));
    let quota = columns.column(g, "quota_slots");
    parts.push(scaled(g, &quota, 8.0));
    let altitude = columns.column(g, "altitude_m");
    parts.push(scaled(g, &altitude, 100.0));

    let vehicle = columns.columns(g, "vehicle_east_m", 2);
    let area = columns.columns(g, "area_east_m", 2);
    let beyond = g.apply("Sub", &[&area, &vehicle]);
    let five_reaches = g.with_number("Mul", &reach, 5.0);
    for distance in [vehicle, beyond] {
        let ratio = g.apply("Div", &[&distance, &five_reaches]);
        parts.push(g.apply("Tanh", &[&ratio]));
    }
    let noise = columns.column(g, "noise_dbm");
    let powers = columns.columns(g, "user_power_max_dbm", 2);
    let ratio = g.apply("Sub", &[&powers, &noise]);
    let ratio = g.with_number("Sub", &ratio, 110.0);
    parts.push(scaled(g, &ratio, 10.0));
    let best = columns.columns(g, "best_rate_here", PLACES);
    parts.extend(rates(g, &best, &limit));
    joined(g, &parts)
}

/// Returns the features of all users, \[1, 16, 61\], from `mission` and `users`, \[1, 16, 32\].
pub(super) fn users(g: &mut Operators, mission: &str, users: &str) -> String {
    let mission = mission_columns(mission);
    let columns = Columns {
        value: users,
        names: &USER_COLUMN_NAMES,
    };
    let offset = columns.columns(g, "east_m", 2);
    let destination = mission.columns(g, "destination_east_m", 2);
    let reach = mission.column(g, "reach_m");
    let left = mission.column(g, "slots_left");
    let left = g.with_number("Max", &left, 1.0);
    let (served, quota) = (
        columns.column(g, "slots_served"),
        columns.column(g, "quota_slots"),
    );

    let [place, distance] = place(g, &offset);
    let beside = g.apply("Sub", &[&offset, &destination]);
    let range = g.apply("Mul", &[&reach, &left]);
    let way = g.apply("Div", &[&distance, &range]);
    let owed = g.apply("Sub", &[&quota, &served]);
    let owed = g.with_number("Max", &owed, 0.0);
    let owed_of_left = g.apply("Div", &[&owed, &left]);
    let served_of_quota = g.divide_at_least(&served, &quota, 1.0);
    let mut parts = vec![
        place,
        scaled(g, &beside, DISTANCE_UNIT_M),
        g.apply("Tanh", &[&way]),
        g.divide_at_least(&owed, &quota, 1.0),
        g.clip(&owed_of_left),
        columns.column(g, "admissible"),
        g.clip(&served_of_quota),
    ];
    let limit = mission.column(g, "slot_rate_limit");
    let here_and_around = columns.columns(g, "rate_here", PLACES);
    parts.extend(rates(g, &here_and_around, &limit));
    let above = columns.columns(g, "rate_above", 2);
    parts.push(rate_fractions(g, &above, &limit));
    joined(g, &parts)
}

/// Returns the features of all sensors, \[1, 64, 4\], from `sensors`, \[1, 64, 3\].
pub(super) fn sensors(g: &mut Operators, sensors: &str) -> String {
    let columns = Columns {
        value: sensors,
        names: &SENSOR_COLUMN_NAMES,
    };
    let offset = columns.columns(g, "east_m", 2);
    let [place, _] = place(g, &offset);
    let snr = columns.column(g, "received_snr_db");
    let snr = scaled(g, &snr, 20.0);
    joined(g, &[place, snr])
}

/// Returns the features of an offset, and its length in metres.
fn place(g: &mut Operators, offset: &str) -> [String; 2] {
    let squares = g.apply("Mul", &[offset, offset]);
    let sum = g.sum(&squares, COLUMNS);
    let distance = g.apply("Sqrt", &[&sum]);
    let numbers = joined(g, &[offset.into(), distance.clone()]);
    [scaled(g, &numbers, DISTANCE_UNIT_M), distance]
}

/// Returns the rates as fractions of the limit, and their differences from the first.
fn rates(g: &mut Operators, rates: &str, limit: &str) -> [String; 2] {
    let fractions = rate_fractions(g, rates, limit);
    let here = g.slice(&fractions, COLUMNS, 0, 1);
    let around = g.slice(&fractions, COLUMNS, 1, PLACES as i64);
    let differences = g.apply("Sub", &[&around, &here]);
    let differences = g.with_number("Mul", &differences, DIFFERENCE_FACTOR);
    let differences = g.clip(&differences);
    [fractions, differences]
}

/// Returns rates as fractions of the limit.
fn rate_fractions(g: &mut Operators, rates: &str, limit: &str) -> String {
    let fractions = g.divide_at_least(rates, limit, RATE_LIMIT_MIN);
    g.clip(&fractions)
}

/// Returns `clip(input / unit)`.
fn scaled(g: &mut Operators, input: &str, unit: f32) -> String {
    let quotient = g.with_number("Div", input, unit);
    g.clip(&quotient)
}

fn joined(g: &mut Operators, parts: &[String]) -> String {
    let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
    g.along("Concat", &parts, COLUMNS)
}

/// Returns the destination relative to the vehicle, \[1, 1, 2\], and the reach, \[1, 1, 1\], metres.
pub(super) fn destination_and_reach(g: &mut Operators, mission: &str) -> [String; 2] {
    let columns = mission_columns(mission);
    [
        columns.columns(g, "destination_east_m", 2),
        columns.column(g, "reach_m"),
    ]
}
