//! Missions that another program has planned, as files: waypoints, and the served users where the file
//! names them.
//!
//! * `.csv`: a header and a row per slot. The columns `east_m` and `north_m` hold the position at the
//!   slot's end; `planned_east_m` and `planned_north_m`, as in a run's `slots.csv`, count as well. The
//!   optional column `user` or `served_user` holds the number of the served user, from 0; an empty
//!   field serves the user who is best among those who are left. Other columns are ignored.
//! * `.plan`: a mission of QGroundControl. Its waypoints (command 16) are the positions at the ends of
//!   the slots; every other item is ignored.
//!
//! Where no user is named, the optimal fair assignment for the path is served.

use std::path::Path;

use firmware_core::{
    Position,
    autopilot::frames::{Geodetic, MapFrame},
};
use scenario::{HostMission, Scenario};
use serde_json::Value;

use crate::search::Plan;

/// MAV_CMD_NAV_WAYPOINT.
const WAYPOINT: u64 = 16;
/// Names of the columns: those of a run's `slots.csv` come last.
const EAST: [&str; 2] = ["east_m", "planned_east_m"];
const NORTH: [&str; 2] = ["north_m", "planned_north_m"];
const USER: [&str; 2] = ["user", "served_user"];

/// Returns the plan in the content of a `.csv` or `.plan` file, for the mission of a scenario.
///
/// # Errors
/// The file has another number of slots than the mission, or a row that means nothing: one line that
/// names row, column, value and what would be right.
pub fn read(path: &Path, content: &[u8], scenario: &Scenario) -> Result<Plan, String> {
    let is_csv = path.extension().is_some_and(|extension| extension == "csv");
    let (waypoints, users) = if is_csv {
        read_csv(content, &scenario.mission)?
    } else {
        (read_ground_control(content, scenario)?, None)
    };
    let (got, slots) = (waypoints.len(), scenario.mission.slots() as usize);
    if got != slots {
        return Err(format!(
            "has {got} waypoints, but the mission has {slots} slots: one waypoint for each is needed"
        ));
    }
    let mut plan = Plan::assigned(&scenario.mission, waypoints);
    if let Some(users) = users {
        // Where the file leaves a slot open, the assignment fills it.
        for (assigned, named) in plan.users.iter_mut().zip(users) {
            *assigned = named.unwrap_or(*assigned);
        }
    }
    Ok(plan)
}

/// Waypoints, and the served users if there is a column of them.
type Rows = (Vec<Position<f64>>, Option<Vec<Option<usize>>>);

fn read_csv(content: &[u8], mission: &HostMission) -> Result<Rows, String> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(content);
    let header = reader.headers().map_err(|error| error.to_string())?.clone();
    let column = |names: [&str; 2]| {
        let find = |name| header.iter().position(|column| column == name);
        names.into_iter().find_map(find)
    };
    let needed = |names: [&str; 2]| {
        column(names).ok_or_else(|| {
            format!(
                "has no column {} (or {}): east_m, north_m and optionally user are read",
                names[0], names[1]
            )
        })
    };
    let (east, north, user) = (needed(EAST)?, needed(NORTH)?, column(USER));
    let (mut waypoints, mut users) = (Vec::new(), user.map(|_| Vec::new()));
    for (index, row) in reader.records().enumerate() {
        let row = row.map_err(|error| error.to_string())?;
        let slot = index + 1;
        let place = |column: usize| {
            let text = row.get(column).unwrap_or_default();
            let number = text.parse().ok().filter(|number: &f64| number.is_finite());
            number.ok_or_else(|| {
                let name = &header[column];
                format!("slot {slot}: {name} is {text:?}; it must be a number of metres")
            })
        };
        waypoints.push(Position::new(place(east)?, place(north)?));
        if let Some((column, users)) = user.zip(users.as_mut()) {
            users.push(read_user(
                row.get(column).unwrap_or_default(),
                slot,
                mission,
            )?);
        }
    }
    Ok((waypoints, users))
}

fn read_user(text: &str, slot: usize, mission: &HostMission) -> Result<Option<usize>, String> {
    if text.is_empty() {
        return Ok(None);
    }
    let count = mission.user_count();
    let user = text.parse().ok().filter(|&user: &usize| user < count);
    user.map(Some).ok_or_else(|| {
        format!(
            "slot {slot}: the user is {text:?}; it must be a number from 0 to {}",
            count - 1
        )
    })
}

fn read_ground_control(content: &[u8], scenario: &Scenario) -> Result<Vec<Position<f64>>, String> {
    let plan: Value = serde_json::from_slice(content).map_err(|error| error.to_string())?;
    let items = plan["mission"]["items"]
        .as_array()
        .ok_or("has no mission.items; it is not a QGroundControl mission")?;
    let map = MapFrame::<f64>::new(scenario.map_origin());
    let waypoints = items
        .iter()
        .enumerate()
        .filter(|(_, item)| item["command"].as_u64() == Some(WAYPOINT));
    waypoints
        .map(|(index, item)| {
            let degrees = |parameter: usize| item["params"][parameter].as_f64();
            let place = degrees(4).zip(degrees(5));
            let place = place.and_then(|(latitude_deg, longitude_deg)| {
                Geodetic::from_degrees(latitude_deg, longitude_deg)
            });
            place.map(|place| map.from_geodetic(place)).ok_or_else(|| {
                format!(
                    "mission.items[{index}]: params[4] and params[5] must be latitude and longitude \
                     in degrees"
                )
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::{ground_control::plan_file, plan};

    fn scenario() -> Scenario {
        Scenario::shipped("separated").expect("shipped")
    }

    fn read_text(name: &str, text: &str) -> Result<Plan, String> {
        read(Path::new(name), text.as_bytes(), &scenario())
    }

    #[test]
    fn a_mission_of_ground_control_is_read_as_it_was_written() {
        let scenario = scenario();
        let planned = plan(&scenario.mission, |_| {}).expect("a plan");
        let text = plan_file(&scenario, &planned.waypoints).expect("a file");
        let read = read_text("a.plan", &text).expect("a plan");
        assert_eq!(read.waypoints.len(), planned.waypoints.len());
        for (read, written) in read.waypoints.iter().zip(&planned.waypoints) {
            assert!((read - written).norm() < 0.02, "{read} {written}");
        }
        assert!((read.sum_rate / planned.sum_rate - 1.0).abs() < 1e-3);
    }

    #[test]
    fn users_are_those_of_the_file_where_it_names_them() {
        let row = |n: usize| {
            format!(
                "{},100.0,{}\n",
                n * 10,
                if n.is_multiple_of(2) { "7" } else { "" }
            )
        };
        let rows: String = (1..=60).map(row).collect();
        let plan = read_text("a.csv", &format!("north_m,east_m,user\n{rows}")).expect("a plan");
        assert_eq!(plan.waypoints[2], Position::new(100.0, 30.0));
        assert_eq!(plan.users.len(), 60);
        assert!(plan.users.iter().skip(1).step_by(2).all(|&user| user == 7));
        let without = read_text("a.csv", &format!("north_m,east_m,note\n{rows}")).expect("a plan");
        assert_eq!(without.users.len(), 60);
    }

    #[test]
    fn what_means_nothing_is_named() {
        let rows = |row: &str| format!("east_m,north_m,user\n{}", format!("{row}\n").repeat(60));
        for (name, text, expected) in [
            ("a.csv", "x,y\n1,2\n".into(), "has no column east_m"),
            (
                "a.csv",
                rows("1,2,15"),
                "slot 1: the user is \"15\"; it must be a number from 0 to 14",
            ),
            (
                "a.csv",
                rows("1,NaN,3"),
                "slot 1: north_m is \"NaN\"; it must be a number of metres",
            ),
            ("a.csv", rows("1,2"), "found record with 2 fields"),
            (
                "a.csv",
                "east_m,north_m\n1,2\n".into(),
                "has 1 waypoints, but the mission has 60 slots",
            ),
            ("a.plan", "{}".into(), "has no mission.items"),
            ("a.plan", "{".into(), "EOF"),
            (
                "a.plan",
                r#"{"mission":{"items":[{"command":16,"params":[0,0,0,0,91,0,9]}]}}"#.into(),
                "mission.items[0]: params[4] and params[5] must be latitude and longitude",
            ),
        ] {
            let error = read_text(name, &text).expect_err("refused");
            assert!(error.contains(expected), "{error}");
        }
    }
}
