//! The true positions of users and sensors in each slot, and the position updates that the vehicle
//! receives.
//!
//! The position that the vehicle knows differs from the true one by an error that is constant over the
//! mission. The vehicle receives an update, for the next slot, when a node has moved far enough.

use std::{collections::HashSet, path::Path};

use files::input;
use firmware_core::{
    Displacement, Position,
    channel::GroundNode,
    controller::DatedChange,
    mission::{Area, MissionChange},
};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::{HostMission, Motion, MotionModel, Uncertainty, node_csv};

/// The first line of a file of motion.
const HEADER: [&str; 5] = ["slot", "node", "index", "east_m", "north_m"];

/// A place of a node from a file, from the end of a slot on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Waymark {
    slot: u32,
    node: GroundNode,
    place: Position<f64>,
}

/// The true places of all users and sensors of a mission.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracks {
    area: Area<f64>,
    slots: u32,
    told_after_m: f64,
    users: Vec<Track>,
    sensors: Vec<Track>,
}

/// The places of one node.
#[derive(Clone, Debug, PartialEq)]
struct Track {
    /// What is known minus what is true.
    error: Displacement<f64>,
    /// The true places at the beginning and at the end of every slot; `None` for a node that does not
    /// move by itself.
    places: Option<Vec<Position<f64>>>,
}

impl Tracks {
    /// Draws the tracks of a mission. The same seed gives the same tracks.
    pub(crate) fn draw(uncertainty: &Uncertainty, mission: &HostMission, file: &[Waymark]) -> Self {
        let p = mission.parameters();
        let track = |node: GroundNode, known: &Position<f64>| {
            let mut random = generator(uncertainty.seed, node);
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            let wanted = Displacement::new(normal(), normal()) * uncertainty.position_error_m;
            let start = within(&p.area, &(known - wanted));
            let motion = uncertainty.motion.as_ref().filter(|motion| match node {
                GroundNode::User(_) => motion.nodes.has_users(),
                GroundNode::Sensor(_) => motion.nodes.has_sensors(),
            });
            Track {
                error: known - start,
                places: motion.map(|motion| match motion.model {
                    MotionModel::File => marked(mission, file, node, start),
                    _ => moved(mission, motion, start, &mut random),
                }),
            }
        };
        let users = p.users.iter().enumerate();
        let sensors = p.sensors.iter().enumerate();
        Self {
            area: p.area,
            slots: p.slots,
            told_after_m: uncertainty
                .motion
                .as_ref()
                .map_or(0.0, Motion::told_after_m),
            users: users
                .map(|(user, place)| track(GroundNode::User(user), place))
                .collect(),
            sensors: sensors
                .map(|(sensor, place)| track(GroundNode::Sensor(sensor), place))
                .collect(),
        }
    }

    fn of(&self, node: GroundNode) -> Option<&Track> {
        match node {
            GroundNode::User(user) => self.users.get(user),
            GroundNode::Sensor(sensor) => self.sensors.get(sensor),
        }
    }

    /// Returns whether a node moves by itself, and not only by the changes of the mission.
    pub fn moves(&self, node: GroundNode) -> bool {
        self.of(node).is_some_and(|track| track.places.is_some())
    }

    /// Returns where a node truly is at the end of a slot, if it is `known` to be at this place.
    pub fn place(&self, node: GroundNode, slot: u32, known: &Position<f64>) -> Position<f64> {
        let Some(track) = self.of(node) else {
            // The node joined in flight, and its position is known exactly.
            return *known;
        };
        match &track.places {
            Some(places) => places[(slot as usize).min(places.len() - 1)],
            None if track.error == Displacement::zeros() => *known,
            None => within(&self.area, &(known - track.error)),
        }
    }

    /// Returns the changes by which the vehicle is told the motion, in the order of their slots.
    pub(crate) fn told(&self) -> Vec<DatedChange<f64>> {
        let users = self.users.iter().enumerate();
        let users = users.map(|(user, track)| (GroundNode::User(user), track));
        let sensors = self.sensors.iter().enumerate();
        let sensors = sensors.map(|(sensor, track)| (GroundNode::Sensor(sensor), track));
        let mut told = Vec::new();
        for (node, track) in users.chain(sensors) {
            let places = track.places.as_deref().unwrap_or_default();
            let mut last = places.first().copied().unwrap_or_else(Position::origin);
            for (slot, place) in (0..self.slots).zip(places) {
                if (place - last).norm() < self.told_after_m {
                    continue;
                }
                last = *place;
                let position_m = within(&self.area, &(place + track.error));
                told.push(DatedChange {
                    from_slot: slot + 1,
                    change: match node {
                        GroundNode::User(user) => MissionChange::User {
                            user: user as u16,
                            position_m,
                        },
                        GroundNode::Sensor(sensor) => MissionChange::Sensor {
                            sensor: sensor as u16,
                            position_m,
                        },
                    },
                });
            }
        }
        told.sort_by_key(|change| change.from_slot);
        told
    }
}

/// Returns the generator of a node's error and motion.
fn generator(seed: u64, node: GroundNode) -> Pcg64 {
    let node = match node {
        GroundNode::User(user) => user as u64,
        GroundNode::Sensor(sensor) => 1 << 16 | sensor as u64,
    };
    // Neighbouring seeds must not give the nodes' generators to each other.
    Pcg64::seed_from_u64(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ node)
}

/// Returns the nearest place of the area.
fn within(area: &Area<f64>, place: &Position<f64>) -> Position<f64> {
    Position::new(
        place.x.clamp(0.0, area.east_m),
        place.y.clamp(0.0, area.north_m),
    )
}

/// Returns the places of a node that moves from `start` under a model with a speed.
fn moved(
    mission: &HostMission,
    motion: &Motion,
    start: Position<f64>,
    random: &mut Pcg64,
) -> Vec<Position<f64>> {
    let p = mission.parameters();
    let (area, slot_s) = (p.area, p.slot_duration_s);
    let mut places = vec![start];
    let mut here = start;
    match motion.model {
        MotionModel::GaussMarkov => {
            let deviation = motion.speed_mps();
            let kept = (-slot_s / motion.memory_s()).exp();
            let renewed = deviation * (1.0 - kept * kept).sqrt();
            let mut normal = || -> f64 { StandardNormal.sample(&mut *random) };
            let mut velocity = Displacement::new(normal(), normal()) * deviation;
            for _ in 0..p.slots {
                let (east, vx) = reflected(here.x + velocity.x * slot_s, velocity.x, area.east_m);
                let (north, vy) = reflected(here.y + velocity.y * slot_s, velocity.y, area.north_m);
                here = Position::new(east, north);
                places.push(here);
                let gust = Displacement::new(normal(), normal());
                velocity = Displacement::new(vx, vy) * kept + gust * renewed;
            }
        }
        MotionModel::RandomWaypoint | MotionModel::File => {
            let mut leg = here;
            let mut speed_mps = 0.0;
            for _ in 0..p.slots {
                let mut left_s = slot_s;
                // A slot may be longer than many legs, but a speed of 0 ends none.
                while left_s > 0.0 && motion.speed_mps() > 0.0 {
                    let way = leg - here;
                    let takes_s = way.norm() / speed_mps;
                    if takes_s > left_s {
                        here += way * (left_s / takes_s);
                        break;
                    }
                    here = leg;
                    left_s -= if takes_s.is_finite() { takes_s } else { 0.0 };
                    leg = Position::new(
                        random.random_range(0.0..=area.east_m),
                        random.random_range(0.0..=area.north_m),
                    );
                    speed_mps = motion.speed_mps() * random.random_range(0.2..=1.0);
                }
                places.push(here);
            }
        }
    }
    places
}

/// Returns a coordinate and its velocity after turning round at 0 and at `end`.
fn reflected(place: f64, velocity: f64, end: f64) -> (f64, f64) {
    let round = place.rem_euclid(2.0 * end);
    let back = round > end;
    let turns = (place / end).floor() as i64;
    (
        if back { 2.0 * end - round } else { round },
        if turns.rem_euclid(2) == 1 {
            -velocity
        } else {
            velocity
        },
    )
}

/// Returns the places of a node whose motion is in a file.
fn marked(
    mission: &HostMission,
    file: &[Waymark],
    node: GroundNode,
    start: Position<f64>,
) -> Vec<Position<f64>> {
    let mut places = vec![start];
    let mut here = start;
    for slot in 1..=mission.slots() {
        let mark = file
            .iter()
            .find(|mark| mark.node == node && mark.slot == slot);
        here = mark.map_or(here, |mark| mark.place);
        places.push(here);
    }
    places
}

/// Reads a file of motion.
///
/// # Errors
/// Returns one line that names the file, the line, the field, the value and what is allowed.
pub(crate) fn load(path: &Path, mission: &HostMission) -> Result<Vec<Waymark>, String> {
    let named = |problem| format!("uncertainty.motion.csv: {}: {problem}", path.display());
    let content = input::read(path).map_err(|error| named(error.to_string()))?;
    read(&content, mission).map_err(named)
}

fn read(content: &[u8], mission: &HostMission) -> Result<Vec<Waymark>, String> {
    let mut reader = node_csv::reader(content, &HEADER)?;
    let mut marks: Vec<Waymark> = Vec::new();
    let mut known = HashSet::new();
    for row in reader.records() {
        let row = row.map_err(|error| error.to_string())?;
        let line = row.position().map_or(0, csv::Position::line);
        let mark = waymark(&row, mission).map_err(|problem| format!("line {line}: {problem}"))?;
        if !known.insert((mark.slot, mark.node)) {
            return Err(format!(
                "line {line}: a second place of {} {} in slot {}",
                &row[1], &row[2], mark.slot
            ));
        }
        marks.push(mark);
    }
    Ok(marks)
}

fn waymark(row: &csv::StringRecord, mission: &HostMission) -> Result<Waymark, String> {
    let [slot, node, index, east_m, north_m] = node_csv::values(row)?;
    let slots = mission.slots();
    let number = slot.parse().ok().filter(|slot| (1..=slots).contains(slot));
    let slot = number
        .ok_or_else(|| format!("slot is `{slot}`, but must be from 1 to {slots}, the last one"))?;
    let node = node_csv::node(node, index, mission)?;
    let area = mission.parameters().area;
    let metres = |field: &str, cell: &str, end: f64| {
        let value: Option<f64> = cell.parse().ok();
        let value = value.filter(|value| (0.0..=end).contains(value));
        value.ok_or_else(|| {
            format!(
                "{field} is `{cell}`, but must be from 0 to {end} m, in the area of the mission"
            )
        })
    };
    Ok(Waymark {
        slot,
        node,
        place: Position::new(
            metres("east_m", east_m, area.east_m)?,
            metres("north_m", north_m, area.north_m)?,
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Events, MovingNodes, Scenario};

    fn mission() -> HostMission {
        Scenario::shipped("mixed").expect("shipped").mission
    }

    fn moving(model: MotionModel, speed_mps: f64) -> Uncertainty {
        Uncertainty {
            motion: Some(Motion {
                model,
                nodes: MovingNodes::All,
                speed_mps: Some(speed_mps),
                memory_s: None,
                csv: None,
                told_after_m: None,
            }),
            ..Uncertainty::default()
        }
    }

    fn nodes(mission: &HostMission) -> Vec<(GroundNode, Position<f64>)> {
        let users = mission
            .users()
            .map(|(user, place)| (GroundNode::User(user), *place));
        let sensors = mission
            .sensors()
            .map(|(j, place)| (GroundNode::Sensor(j), *place));
        users.chain(sensors).collect()
    }

    /// Nodes begin where they are known to be, stay in the area, and move as fast as they should.
    #[test]
    fn motion_has_its_speed_and_stays_in_the_area() {
        let mission = mission();
        let p = mission.parameters();
        for model in [MotionModel::RandomWaypoint, MotionModel::GaussMarkov] {
            let tracks = Tracks::draw(&moving(model, 5.0), &mission, &[]);
            let (mut squares, mut steps) = (0.0, 0.0);
            for (node, known) in nodes(&mission) {
                assert_eq!(tracks.place(node, 0, &known), known);
                let mut last = known;
                for slot in 1..=mission.slots() {
                    let place = tracks.place(node, slot, &known);
                    assert_eq!(within(&p.area, &place), place);
                    let speed_mps = (place - last).norm() / p.slot_duration_s;
                    if model == MotionModel::RandomWaypoint {
                        assert!(speed_mps <= 5.0 + 1e-9, "{speed_mps}");
                    }
                    squares += speed_mps * speed_mps;
                    steps += 1.0;
                    last = place;
                }
            }
            let rms_mps = f64::sqrt(squares / steps);
            // Uniform from 1 to 5 m/s; two directions of 5 m/s each.
            let expected = match model {
                MotionModel::GaussMarkov => 5.0 * f64::sqrt(2.0),
                _ => f64::sqrt(9.0 + 16.0 / 12.0),
            };
            assert!(
                (rms_mps / expected - 1.0).abs() < 0.1,
                "{model:?}: {rms_mps}"
            );
        }
    }

    /// After every slot, what was told is at most the threshold and one slot's way from the truth,
    /// apart from the constant error.
    #[test]
    fn the_vehicle_is_told_in_time() {
        let mission = mission();
        let uncertainty = Uncertainty {
            position_error_m: 12.0,
            ..moving(MotionModel::RandomWaypoint, 5.0)
        };
        let tracks = Tracks::draw(&uncertainty, &mission, &[]);
        let told = tracks.told();
        let way_m = 5.0 * mission.parameters().slot_duration_s;
        for (node, start) in nodes(&mission) {
            let mut known = start;
            let error = start - tracks.place(node, 0, &start);
            assert!(error.norm() > 0.0 && error.norm() < 60.0);
            for slot in 1..=mission.slots() {
                for change in told.iter().filter(|change| change.from_slot == slot) {
                    match change.change {
                        MissionChange::User { user, position_m }
                            if node == GroundNode::User(user.into()) =>
                        {
                            known = position_m
                        }
                        MissionChange::Sensor { sensor, position_m }
                            if node == GroundNode::Sensor(sensor.into()) =>
                        {
                            known = position_m
                        }
                        _ => {}
                    }
                }
                let off_m = (known - error - tracks.place(node, slot, &known)).norm();
                // At the border, the erroneous place is moved into the area.
                assert!(
                    off_m <= 10.0 + way_m + 1e-9
                        || within(&mission.parameters().area, &known) == known
                            && off_m <= 10.0 + way_m + error.norm(),
                    "{off_m}"
                );
            }
        }
    }

    /// A record's changes have the motion already, and are flown again as they are.
    #[test]
    fn motion_is_told_once() {
        let scenario = Scenario::shipped("mixed").expect("shipped");
        let scenario = scenario
            .with_uncertainty(moving(MotionModel::RandomWaypoint, 5.0))
            .expect("valid");
        let events = scenario.with_motion(&Events::default()).expect("no events");
        assert!(events.changes().len() > 100);
        assert_eq!(scenario.with_motion(&events), Ok(events));
    }

    #[test]
    fn a_file_moves_its_nodes_and_wrong_lines_are_named() {
        let mission = mission();
        let read = |rows: &str| {
            read(
                format!("slot,node,index,east_m,north_m\n{rows}").as_bytes(),
                &mission,
            )
        };
        let marks = read("7,user,3,10,20\n9,user,3,30,40\n").expect("valid");
        let uncertainty = moving(MotionModel::File, 0.0);
        let tracks = Tracks::draw(&uncertainty, &mission, &marks);
        let user = GroundNode::User(3);
        let known = mission.parameters().users[3];
        let at = |slot| tracks.place(user, slot, &known);
        assert_eq!(
            [at(6), at(7), at(8), at(9), at(60)],
            [
                known,
                Position::new(10.0, 20.0),
                Position::new(10.0, 20.0),
                Position::new(30.0, 40.0),
                Position::new(30.0, 40.0)
            ]
        );
        for (rows, words) in [
            (
                "0,user,3,1,1\n",
                "line 2: slot is `0`, but must be from 1 to 60",
            ),
            (
                "1,usr,3,1,1\n",
                "line 2: node is `usr`, but must be user or sensor",
            ),
            (
                "1,user,15,1,1\n",
                "line 2: index is `15`, but must be from 0 to 14",
            ),
            (
                "1,user,3,NaN,1\n",
                "line 2: east_m is `NaN`, but must be from 0 to 1000 m",
            ),
            (
                "1,user,3,1,1\n1,user,3,2,2\n",
                "line 3: a second place of user 3 in slot 1",
            ),
            ("1,user,3,1\n", "line 2: has 4 values, but must have 5"),
        ] {
            let error = read(rows).expect_err(rows);
            assert!(error.contains(words), "{error}");
        }
    }
}
