//! Draws whole missions at random: layouts, numbers, areas, speeds, powers and thresholds.
//!
//! The distribution is that of the benchmark (`benchmarks/`). It is wider than the paper's Table I,
//! so that a planner that works on one map only does badly. The whole distribution is our
//! assumption.

use clap::ValueEnum;
use firmware_core::mission::{Environment, ExcessLoss, RadioModel};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::rates::PlaceRates;
use crate::{
    Scenario, Sensing, Uncertainty,
    mission_file::{
        AircompTable, MissionTable, Origin, RadioTable, ScenarioFile, SensorsTable, UsersTable,
    },
};

/// How users or sensors are distributed over the area.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// Anywhere in the area.
    Uniform,
    /// In two to four clusters.
    Clustered,
    /// On a ring.
    Ring,
    /// Along a line.
    Line,
    /// In one corner of the area.
    Corner,
}

impl Layout {
    /// All layouts. Each is as likely as the others.
    pub const ALL: [Self; 5] = [
        Self::Uniform,
        Self::Clustered,
        Self::Ring,
        Self::Line,
        Self::Corner,
    ];

    /// Returns the name, as on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Clustered => "clustered",
            Self::Ring => "ring",
            Self::Line => "line",
            Self::Corner => "corner",
        }
    }
}

/// The layouts of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layouts {
    /// The layout of the users.
    pub users: Layout,
    /// The layout of the sensors.
    pub sensors: Layout,
}

/// A mission that was drawn at random, with the layouts that were drawn for it. The scenario file
/// does not state them.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawnMission {
    /// The mission.
    pub scenario: Scenario,
    /// Its layouts.
    pub layouts: Layouts,
}

/// The number of points along each axis at which a draw is checked for rates above 0.
const CHECKED_POINTS: usize = 16;
/// The fraction of a slot's rate limit that some position in a mission must reach.
const LEAST_FRACTION: f64 = 0.1;
/// The number of draws after which a seed is given up. About one draw in fifty is rejected.
const DRAWS_MAX: usize = 1000;

/// Draws a mission with 4 to 16 users, 8 to 64 sensors, 30 to 90 slots, `Gamma` from `0.3/J` to
/// `0.93/J`, and noise from -100 to -85 dBm. Users and sensors have separate layouts, unless
/// `layout` names one for both. The same seed gives the same mission.
///
/// A draw is discarded, and the next one taken, if its destination is out of reach or if no
/// position gives a tenth of the rate limit of a slot.
///
/// # Errors
/// Returns an error if none of 1000 draws with this seed gives a mission.
pub fn random(seed: u64, layout: Option<Layout>) -> Result<Scenario, String> {
    DrawnMission::new(seed, layout, &[]).map(|drawn| drawn.scenario)
}

impl DrawnMission {
    /// Draws a mission like [`random`], but also discards each draw in which the users or the
    /// sensors have one of the layouts `left_out`. Where none is left out, or the first valid draw
    /// has none of them, the mission is that of [`random`].
    ///
    /// # Errors
    /// Returns an error if none of 1000 draws with this seed gives a mission; so it is if `layout`
    /// or all layouts are left out.
    pub fn new(seed: u64, layout: Option<Layout>, left_out: &[Layout]) -> Result<Self, String> {
        let mut random = Pcg64::seed_from_u64(seed);
        for _ in 0..DRAWS_MAX {
            let (layouts, file) = draw(&mut random, layout);
            let is_left_out = [layouts.users, layouts.sensors]
                .iter()
                .any(|layout| left_out.contains(layout));
            if !is_left_out
                && let Ok(scenario) = Scenario::from_file(&format!("random-{seed:04}"), file)
                && carries_data(&scenario)
            {
                return Ok(Self { scenario, layouts });
            }
        }
        Err(format!(
            "--seed {seed}: no valid mission was found in {DRAWS_MAX} draws"
        ))
    }
}

fn draw(random: &mut Pcg64, layout: Option<Layout>) -> (Layouts, ScenarioFile) {
    let mut layout =
        || layout.unwrap_or_else(|| Layout::ALL[random.random_range(0..Layout::ALL.len())]);
    let layouts = Layouts {
        users: layout(),
        sensors: layout(),
    };
    let side_m = |random: &mut Pcg64| rounded(random.random_range(500.0..1600.0), 10.0);
    let area_m = [side_m(random), side_m(random)];
    let users = random.random_range(4..=16);
    let sensors = random.random_range(8..=64);
    let threshold = random.random_range(0.3..0.93) / sensors as f64;
    let mut anywhere = || place(random, area_m, [0.03, 0.97], [0.03, 0.97]);
    let (start_m, destination_m) = (anywhere(), anywhere());
    let file = ScenarioFile {
        mission: MissionTable {
            slots: random.random_range(30..=90),
            slot_duration_s: [1.0, 1.0, 2.0][random.random_range(0..3)],
            start_m,
            destination_m,
            area_m,
            altitude_m: rounded(random.random_range(60.0..150.0), 1.0),
            max_speed_mps: rounded(random.random_range(10.0..40.0), 0.5),
        },
        radio: RadioTable {
            carrier_hz: 2e9,
            noise_dbm: rounded(random.random_range(-100.0..-85.0), 0.1),
            model: RadioModel::ProbabilisticLos,
            environment: Some(Environment { a: 9.613, b: 0.158 }),
            excess_loss_db: Some(ExcessLoss {
                los: 1.0,
                nlos: 20.0,
            }),
            gain_map: None,
        },
        aircomp: AircompTable {
            mse_threshold: rounded(threshold, 1e-6),
            sensor_power_max_w: rounded(random.random_range(0.02..0.1), 0.001),
        },
        users: UsersTable {
            power_max_w: rounded(random.random_range(0.1..0.4), 0.01),
            positions_m: places(random, layouts.users, users, area_m),
        },
        sensors: SensorsTable {
            positions_m: places(random, layouts.sensors, sensors, area_m),
        },
        origin: Origin::default(),
        sensing: Sensing::default(),
        uncertainty: Uncertainty::default(),
    };
    (layouts, file)
}

/// Returns whether some position on a coarse grid gives some user a usable rate.
fn carries_data(scenario: &Scenario) -> bool {
    let mission = &scenario.mission;
    let area = mission.parameters().area;
    let mut place_rates = PlaceRates::new(mission);
    let mut rates = vec![0.0; mission.user_count()];
    let least = LEAST_FRACTION * mission.slot_rate_limit();
    (0..CHECKED_POINTS * CHECKED_POINTS).any(|index| {
        let fraction = |index: usize| (index as f64 + 0.5) / CHECKED_POINTS as f64;
        let east_m = area.east_m * fraction(index % CHECKED_POINTS);
        let north_m = area.north_m * fraction(index / CHECKED_POINTS);
        place_rates.write(&firmware_core::Position::new(east_m, north_m), &mut rates);
        rates.iter().any(|&rate| rate >= least)
    })
}

/// Returns the nearest multiple of `step`, without the trailing digits that a product would leave.
fn rounded(value: f64, step: f64) -> f64 {
    let inverse = (1.0 / step).round().max(1.0);
    if step >= 1.0 {
        (value / step).round() * step
    } else {
        (value * inverse).round() / inverse
    }
}

/// Draws a position with both coordinates within the given fractions of the area.
fn place(random: &mut Pcg64, area_m: [f64; 2], east: [f64; 2], north: [f64; 2]) -> [f64; 2] {
    let mut along = |extent_m: f64, [low, high]: [f64; 2]| {
        rounded(extent_m * random.random_range(low..high), 0.1)
    };
    [along(area_m[0], east), along(area_m[1], north)]
}

/// Draws `count` positions of one layout, inside the area.
fn places(random: &mut Pcg64, layout: Layout, count: usize, area_m: [f64; 2]) -> Vec<[f64; 2]> {
    let short_m = area_m[0].min(area_m[1]);
    let inner = [0.2, 0.8];
    let inside = |[east, north]: [f64; 2]| {
        let clamp = |value: f64, extent_m: f64| rounded(value.clamp(0.0, extent_m), 0.1);
        [clamp(east, area_m[0]), clamp(north, area_m[1])]
    };
    let scattered = |random: &mut Pcg64, [east, north]: [f64; 2], spread_m: f64| {
        // The sum of three uniform numbers is close enough to a normally distributed one.
        let mut offset = || (0..3).map(|_| random.random_range(-1.0..1.0)).sum::<f64>() * spread_m;
        inside([east + offset(), north + offset()])
    };
    match layout {
        Layout::Uniform => (0..count)
            .map(|_| place(random, area_m, [0.02, 0.98], [0.02, 0.98]))
            .collect(),
        Layout::Clustered => {
            let clusters = random.random_range(2..=4);
            let centers: Vec<_> = (0..clusters)
                .map(|_| place(random, area_m, [0.1, 0.9], [0.1, 0.9]))
                .collect();
            (0..count)
                .map(|index| scattered(random, centers[index % clusters], 0.05 * short_m))
                .collect()
        }
        Layout::Ring => {
            let [east, north] = place(random, area_m, [0.4, 0.6], [0.4, 0.6]);
            let radius_m = short_m * random.random_range(0.2..0.4);
            (0..count)
                .map(|_| {
                    let angle = random.random_range(0.0..std::f64::consts::TAU);
                    let center = [
                        east + radius_m * angle.cos(),
                        north + radius_m * angle.sin(),
                    ];
                    scattered(random, center, 0.01 * short_m)
                })
                .collect()
        }
        Layout::Line => {
            let [from, to] = [(); 2].map(|()| place(random, area_m, inner, inner));
            (0..count)
                .map(|_| {
                    let along: f64 = random.random_range(-0.3..1.3);
                    let between = |axis: usize| from[axis] + along * (to[axis] - from[axis]);
                    scattered(random, [between(0), between(1)], 0.01 * short_m)
                })
                .collect()
        }
        Layout::Corner => {
            let mut end = || [[0.02, 0.35], [0.65, 0.98]][random.random_range(0..2)];
            let (east, north) = (end(), end());
            (0..count)
                .map(|_| place(random, area_m, east, north))
                .collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_names_one_mission() {
        for seed in 0..20 {
            let scenario = random(seed, None).expect("a mission");
            assert_eq!(scenario, random(seed, None).expect("a mission"));
            assert_ne!(
                scenario.digest(),
                random(seed + 1, None).expect("a mission").digest()
            );
            let again = Scenario::parse(&scenario.name, &scenario.to_toml()).expect("valid");
            assert_eq!(again, scenario);
        }
    }

    #[test]
    fn numbers_are_in_their_ranges_for_every_layout() {
        for layout in Layout::ALL {
            for seed in 0..10 {
                let mission = random(seed, Some(layout)).expect("a mission").mission;
                let sensors = mission.sensor_count();
                let threshold = mission.parameters().mse_threshold * sensors as f64;
                assert!((4..=16).contains(&mission.user_count()));
                assert!((8..=64).contains(&sensors));
                assert!((30..=90).contains(&mission.slots()));
                assert!((0.299..0.931).contains(&threshold), "{threshold}");
            }
        }
    }

    /// Names on the command line, in files and in tables are the same, and none is missing.
    #[test]
    fn a_layout_has_one_name() {
        assert_eq!(Layout::value_variants(), Layout::ALL);
        for layout in Layout::ALL {
            let value = layout.to_possible_value().expect("a name");
            assert_eq!(value.get_name(), layout.name());
            let in_file = toml::Value::try_from(layout).expect("serializable");
            assert_eq!(in_file.as_str(), Some(layout.name()));
        }
    }

    /// Missions without some layouts are those of the distribution that have none of them.
    #[test]
    fn layouts_that_are_left_out_are_not_drawn() {
        let left_out = [Layout::Ring, Layout::Line];
        let mut found = Vec::new();
        let mut unchanged = 0;
        for seed in 0..60 {
            let drawn = DrawnMission::new(seed, None, &left_out).expect("a mission");
            let plain = DrawnMission::new(seed, None, &[]).expect("a mission");
            assert_eq!(plain.scenario, random(seed, None).expect("a mission"));
            let of = |layouts: Layouts| [layouts.users, layouts.sensors];
            if of(plain.layouts).iter().any(|one| left_out.contains(one)) {
                assert_ne!(drawn.scenario.digest(), plain.scenario.digest());
            } else {
                assert_eq!(drawn, plain);
                unchanged += 1;
            }
            found.extend(of(drawn.layouts));
        }
        assert!((10..40).contains(&unchanged), "{unchanged}");
        for layout in Layout::ALL {
            assert_eq!(found.contains(&layout), !left_out.contains(&layout));
        }
        assert!(DrawnMission::new(1, None, &Layout::ALL).is_err());
        assert!(DrawnMission::new(1, Some(Layout::Ring), &left_out).is_err());
    }

    /// The layouts are those of the positions: in a corner no coordinate is in the middle.
    #[test]
    fn layouts_are_those_of_the_positions() {
        let mut corners = 0;
        for seed in 0..60 {
            let drawn = DrawnMission::new(seed, None, &[]).expect("a mission");
            let mission = &drawn.scenario.mission;
            let area = &mission.parameters().area;
            let is_cornered = |place: &firmware_core::Position<f64>| {
                let fractions = [place.x / area.east_m, place.y / area.north_m];
                fractions.iter().all(|f| !(0.36..0.64).contains(f))
            };
            if drawn.layouts.users == Layout::Corner {
                assert!(mission.users().all(|(_, place)| is_cornered(place)));
                corners += 1;
            }
            if drawn.layouts.sensors == Layout::Corner {
                assert!(mission.sensors().all(|(_, place)| is_cornered(place)));
                corners += 1;
            }
        }
        assert!(corners > 5, "{corners}");
    }
}
