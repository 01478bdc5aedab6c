//! Generates scenarios: Table I's parameters on a random layout.

use clap::ValueEnum;
use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    mission::{Environment, ExcessLoss, RadioModel},
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::{
    Scenario, Sensing, Uncertainty,
    mission_file::{
        AircompTable, MissionTable, Origin, RadioTable, ScenarioFile, SensorsTable, UsersTable,
    },
};

/// How users and sensors are placed relative to one another (the paper's Sec. VI).
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Topology {
    /// Topo.1: users in the north-west, sensors in the south-east, far apart.
    Separated,
    /// Topo.2: users and sensors over the same ground.
    Mixed,
}

/// An axis-aligned rectangle, metres: `[west, east]`, `[south, north]`.
type Rectangle = [[f64; 2]; 2];

/// Generates a scenario with the parameters of Table I, which has 15 users and 36 sensors, on a
/// layout drawn with `seed`. The vehicle flies from the south-west corner to the north-east one.
/// With other numbers of sensors, the product `J Gamma` is kept. The layout is our assumption,
/// because the paper does not print one.
///
/// # Errors
/// Returns an error if the controller cannot hold that many users or sensors.
pub fn generate(
    topology: Topology,
    seed: u64,
    users: usize,
    sensors: usize,
) -> Result<Scenario, String> {
    generate_on(topology, seed, users, sensors, &Course::default())
}

/// The ground of a mission and the way over it, where they differ from Table I's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// Number of slots, N.
    pub slots: u32,
    /// Extent of the area, east and north, m. Users and sensors are spread over it as over Table I's.
    pub area_m: [f64; 2],
    /// Start, east and north, m; near the south-west corner by default.
    pub start_m: Option<[f64; 2]>,
    /// Destination, east and north, m; near the north-east corner by default.
    pub destination_m: Option<[f64; 2]>,
}

impl Default for Course {
    fn default() -> Self {
        Self {
            slots: 60,
            area_m: [TABLE_ONE_AREA_M; 2],
            start_m: None,
            destination_m: None,
        }
    }
}

/// Side of Table I's area, m.
const TABLE_ONE_AREA_M: f64 = 1000.0;
/// The longest side of an area that users are spread over, m.
const LONGEST_SIDE_M: f64 = 1e6;

/// Returns a scenario as [`generate`] does, on another ground.
///
/// # Errors
/// As [`generate`]; an area without extent; a mission that cannot be flown, such as one whose
/// destination is out of reach.
pub fn generate_on(
    topology: Topology,
    seed: u64,
    users: usize,
    sensors: usize,
    course: &Course,
) -> Result<Scenario, String> {
    for (axis, side_m) in ["east", "north"].into_iter().zip(course.area_m) {
        if !(1.0..=LONGEST_SIDE_M).contains(&side_m) {
            return Err(format!(
                "mission.area_m: {axis} is {side_m}, but must be from 1 to {LONGEST_SIDE_M} m"
            ));
        }
    }
    // Checked before anything is drawn, because a very large number would exhaust the memory.
    for (what, count, most) in [
        ("users", users, USERS_MAX),
        ("sensors", sensors, SENSORS_MAX),
    ] {
        if count > most {
            return Err(format!(
                "{what}.positions_m has {count} entries, but the controller holds at most {most}"
            ));
        }
    }
    let (user_ground, sensor_ground): (Rectangle, Rectangle) = match topology {
        Topology::Separated => (
            [[50.0, 450.0], [550.0, 950.0]],
            [[550.0, 950.0], [50.0, 450.0]],
        ),
        Topology::Mixed => ([[150.0, 850.0]; 2], [[150.0, 850.0]; 2]),
    };
    let [east, north] = course.area_m.map(|side_m| side_m / TABLE_ONE_AREA_M);
    let scaled = |[x, y]: [f64; 2]| [x * east, y * north];
    let spread = |[across, along]: Rectangle| -> Rectangle {
        [across.map(|x| x * east), along.map(|y| y * north)]
    };
    let mut random = Pcg64::seed_from_u64(seed);
    let file = ScenarioFile {
        mission: MissionTable {
            slots: course.slots,
            slot_duration_s: 1.0,
            start_m: course.start_m.unwrap_or(scaled([50.0, 50.0])),
            destination_m: course.destination_m.unwrap_or(scaled([950.0, 950.0])),
            area_m: course.area_m,
            altitude_m: 100.0,
            max_speed_mps: 30.0,
        },
        radio: RadioTable {
            carrier_hz: 2e9,
            noise_dbm: -95.0,
            model: RadioModel::ProbabilisticLos,
            environment: Some(Environment { a: 9.613, b: 0.158 }),
            excess_loss_db: Some(ExcessLoss {
                los: 1.0,
                nlos: 20.0,
            }),
            gain_map: None,
        },
        aircomp: AircompTable {
            mse_threshold: usual_threshold(sensors),
            sensor_power_max_w: 0.05,
        },
        users: UsersTable {
            power_max_w: 0.2,
            positions_m: draw(&mut random, users, spread(user_ground)),
        },
        sensors: SensorsTable {
            positions_m: draw(&mut random, sensors, spread(sensor_ground)),
        },
        origin: Origin::default(),
        sensing: Sensing::default(),
        uncertainty: Uncertainty::default(),
    };
    let name = match topology {
        Topology::Separated => "separated",
        Topology::Mixed => "mixed",
    };
    Scenario::from_file(name, file)
}

/// Returns the `Gamma` that keeps the `J Gamma` of Table I (36 sensors at 0.015), rounded to five
/// decimals. The physical limit of a slot, `log2(1 / (1 - J Gamma))`, is then the same for every
/// `J`, and `Gamma` is always below `1/J`.
fn usual_threshold(sensors: usize) -> f64 {
    let share = 36.0 * 0.015;
    (share / sensors.max(1) as f64 * 1e5).round() / 1e5
}

/// Draws `count` positions, rounded to a decimetre.
fn draw(
    random: &mut Pcg64,
    count: usize,
    [[west, east], [south, north]]: Rectangle,
) -> Vec<[f64; 2]> {
    let decimetre = |value: f64| (value * 10.0).round() / 10.0;
    (0..count)
        .map(|_| {
            [
                decimetre(random.random_range(west..east)),
                decimetre(random.random_range(south..north)),
            ]
        })
        .collect()
}
