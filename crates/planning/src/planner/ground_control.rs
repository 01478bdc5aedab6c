//! Writes plans as files of QGroundControl (`.plan`, JSON), which can display them on its map and
//! upload them. The items are those that `host-sim upload` would send.

use firmware_core::{
    Position,
    autopilot::{
        frames::MapFrame,
        mission::{Ending, MissionPlan},
        profile::Firmware,
        wire::Address,
    },
};
use serde_json::{Value, json};

use scenario::Scenario;

/// MAV_AUTOPILOT_ARDUPILOTMEGA and MAV_AUTOPILOT_PX4.
const ARDUPILOT: u8 = 3;
const PX4: u8 = 12;
/// MAV_TYPE_QUADROTOR.
const QUADROTOR: u8 = 2;
/// The `AltitudeMode` of QGroundControl for altitudes relative to the place of take-off.
const RELATIVE_ALTITUDE: u8 = 1;

/// Returns the text of a `.plan` file: take-off, speed, the waypoints, and landing at the last one.
/// Returns `None` if the path has no waypoints, or more than the 65 000 that can be numbered in a
/// mission.
pub fn plan_file(scenario: &Scenario, waypoints: &[Position<f64>]) -> Option<String> {
    let p = scenario.mission.parameters();
    let map = MapFrame::<f64>::new(scenario.map_origin());
    let mission = MissionPlan {
        // PX4's missions have no item for the home position. QGroundControl adds it for ArduPilot.
        firmware: Firmware::Px4,
        map,
        waypoints,
        altitude_m: p.altitude_m,
        speed_mps: p.max_speed_mps,
        ending: Ending::Land,
    };
    if waypoints.is_empty() || waypoints.len() > 65_000 {
        return None;
    }
    let to = Address {
        system: 1,
        component: 1,
    };
    let items: Vec<Value> = (0..mission.count())
        .filter_map(|sequence| mission.item(sequence, to))
        .map(|item| {
            let place = [degrees(item.x), degrees(item.y), f64::from(item.z)];
            let parameters = [item.param1, item.param2, item.param3, item.param4];
            let numbers: Vec<f64> = parameters.into_iter().map(f64::from).chain(place).collect();
            json!({
                "type": "SimpleItem",
                "AMSLAltAboveTerrain": null,
                "Altitude": item.z,
                "AltitudeMode": RELATIVE_ALTITUDE,
                "autoContinue": true,
                "command": item.command as u32,
                "doJumpId": item.seq + 1,
                "frame": item.frame as u32,
                "params": numbers,
            })
        })
        .collect();
    let home = map.to_geodetic(p.start);
    let plan = json!({
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": { "version": 2, "circles": [], "polygons": [] },
        "rallyPoints": { "version": 2, "points": [] },
        "mission": {
            "version": 2,
            "firmwareType": match mission.firmware {
                Firmware::Px4 => PX4,
                Firmware::Generic | Firmware::ArduCopter => ARDUPILOT,
            },
            "vehicleType": QUADROTOR,
            "cruiseSpeed": p.max_speed_mps,
            "hoverSpeed": p.max_speed_mps,
            "globalPlanAltitudeMode": RELATIVE_ALTITUDE,
            "plannedHomePosition": [
                degrees(home.latitude_e7),
                degrees(home.longitude_e7),
                scenario.origin.elevation_m,
            ],
            "items": items,
        },
    });
    serde_json::to_string_pretty(&plan)
        .ok()
        .map(|text| text + "\n")
}

fn degrees(degrees_e7: i32) -> f64 {
    f64::from(degrees_e7) / 1e7
}
