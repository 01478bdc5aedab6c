//! Events of a mission: what changes in flight, and in which slot. A TOML file, one `[[event]]` per
//! change:
//!
//! ```toml
//! [[event]]
//! slot = 31                    # the first slot with the change, 2 to N
//! user = 3                     # moved, joined (the first unused number) or returned ...
//! position_m = [420.0, 180.0]  # ... here
//!
//! [[event]]
//! slot = 31
//! sensor = 7
//! leaves = true
//!
//! [[event]]
//! slot = 40
//! mse_threshold = 0.012        # or noise_dbm, max_speed_mps, slots
//! ```

use std::path::Path;

use firmware_core::{
    Position, Watt, channel::GroundNode, controller::DatedChange, mission::MissionChange,
};
use serde::Deserialize;

use crate::{
    HostMission, Tracks,
    file::{self, ScenarioError, optional_pair},
};

/// The events of a mission, in the order of their slots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Events {
    changes: Vec<DatedChange<f64>>,
    /// The nodes' own motion is among the changes.
    has_motion: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EventFile {
    #[serde(default)]
    event: Vec<Event>,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Event {
    slot: u32,
    user: Option<u16>,
    sensor: Option<u16>,
    #[serde(default, deserialize_with = "optional_pair")]
    position_m: Option<[f64; 2]>,
    leaves: Option<bool>,
    mse_threshold: Option<f64>,
    noise_dbm: Option<f64>,
    max_speed_mps: Option<f64>,
    slots: Option<u32>,
}

impl Event {
    fn change(&self) -> Result<MissionChange<f64>, String> {
        let place = || match (self.position_m, self.leaves) {
            (Some([east_m, north_m]), None | Some(false)) => {
                Ok(Some(Position::new(east_m, north_m)))
            }
            (None, Some(true)) => Ok(None),
            _ => Err("must have either position_m or leaves = true".to_owned()),
        };
        let mut changes = Vec::new();
        if let Some(user) = self.user {
            changes.push(match place()? {
                Some(position_m) => MissionChange::User { user, position_m },
                None => MissionChange::UserLeft { user },
            });
        }
        if let Some(sensor) = self.sensor {
            changes.push(match place()? {
                Some(position_m) => MissionChange::Sensor { sensor, position_m },
                None => MissionChange::SensorLeft { sensor },
            });
        }
        if self.user.is_none()
            && self.sensor.is_none()
            && (self.position_m.is_some() || self.leaves.is_some())
        {
            return Err(
                "position_m and leaves need the key user or sensor in the same event".into(),
            );
        }
        changes.extend(self.mse_threshold.map(MissionChange::MseThreshold));
        let noise = self.noise_dbm.map(Watt::from_dbm);
        changes.extend(noise.map(MissionChange::NoisePower));
        changes.extend(self.max_speed_mps.map(MissionChange::MaxSpeed));
        changes.extend(self.slots.map(MissionChange::Slots));
        match changes.as_slice() {
            [change] => Ok(*change),
            _ => Err(format!(
                "changes {} things, but must change one: user, sensor, mse_threshold, noise_dbm, \
                 max_speed_mps or slots",
                changes.len()
            )),
        }
    }
}

impl Events {
    /// Loads the events of a mission from a file.
    ///
    /// # Errors
    /// Returns an error that names the file, the event, the field and what is allowed.
    pub fn load(path: &Path, mission: &HostMission) -> Result<Self, ScenarioError> {
        let text = file::read(path)?;
        Self::parse(&text, mission).map_err(|problem| ScenarioError::new(path, problem))
    }

    /// Parses the content of a file of events, and checks that the mission stays valid.
    ///
    /// # Errors
    /// Returns an error that names the event, the field and what is allowed.
    pub fn parse(text: &str, mission: &HostMission) -> Result<Self, String> {
        let file: EventFile = file::parse(text)?;
        let mut changes = Vec::new();
        for (index, event) in file.event.iter().enumerate() {
            let named = |problem| format!("event {} (slot {}): {problem}", index + 1, event.slot);
            let change = event.change().map_err(named)?;
            changes.push((
                index,
                DatedChange {
                    from_slot: event.slot,
                    change,
                },
            ));
        }
        changes.sort_by_key(|(_, change)| change.from_slot);
        let mut changed = mission.clone();
        for (index, DatedChange { from_slot, change }) in &changes {
            let named = |problem| format!("event {} (slot {from_slot}): {problem}", index + 1);
            if !(2..=changed.slots()).contains(from_slot) {
                return Err(named(format!(
                    "slot is {from_slot}, but must be from 2 to {}, the last slot of the mission",
                    changed.slots()
                )));
            }
            let made = changed.change(change, from_slot - 1);
            made.map_err(|error| named(error.to_string()))?;
        }
        let changes = changes.into_iter().map(|(_, change)| change).collect();
        Ok(Self::new(changes))
    }

    /// Creates events from changes that are known to be valid, in the order of their slots.
    pub fn new(mut changes: Vec<DatedChange<f64>>) -> Self {
        changes.sort_by_key(|change| change.from_slot);
        Self {
            changes,
            has_motion: false,
        }
    }

    /// Returns these events and the motion of the nodes, as the vehicle is told of it; events that
    /// have it already stay as they are.
    ///
    /// # Errors
    /// Returns one line that names an event and a node that moves by itself.
    pub(crate) fn with_motion(
        &self,
        mission: &HostMission,
        tracks: &Tracks,
    ) -> Result<Self, String> {
        let told = tracks.told();
        if told.is_empty() || self.has_motion {
            return Ok(self.clone());
        }
        let moves = |event: &&DatedChange<f64>| {
            moved_node(&event.change).is_some_and(|node| tracks.moves(node))
        };
        if let Some(DatedChange { from_slot, change }) = self.changes.iter().find(moves) {
            return Err(format!(
                "slot {from_slot}: {change}, but the scenario's uncertainty.motion moves it, too"
            ));
        }
        let timeline = self.timeline(mission);
        // A mission may become shorter, and a node that left stays away.
        let is_there = |event: &DatedChange<f64>| {
            let mission = timeline.in_slot(event.from_slot);
            event.from_slot <= mission.slots()
                && match moved_node(&event.change) {
                    Some(GroundNode::User(user)) => mission.has_user(user),
                    Some(GroundNode::Sensor(sensor)) => mission.has_sensor(sensor),
                    None => true,
                }
        };
        let mut changes = self.changes.clone();
        changes.extend(told.into_iter().filter(is_there));
        changes.sort_by_key(|change| change.from_slot);
        Ok(Self {
            changes,
            has_motion: true,
        })
    }

    /// Returns whether the changes are announced one by one: nodes that move by themselves would
    /// change something in every slot.
    pub fn are_announced(&self) -> bool {
        !self.has_motion
    }

    /// Returns the changes, in the order of their slots. Their numbers on the ground link start at
    /// 1.
    pub fn changes(&self) -> &[DatedChange<f64>] {
        &self.changes
    }

    /// Returns the mission as it is in each slot.
    pub fn timeline(&self, mission: &HostMission) -> Timeline {
        let mut entries = vec![(1, mission.clone())];
        let mut changed = mission.clone();
        for DatedChange { from_slot, change } in &self.changes {
            // Checked when the events were read.
            let _ = changed.change(change, from_slot - 1);
            if entries.last().is_some_and(|(slot, _)| slot == from_slot) {
                entries.pop();
            }
            entries.push((*from_slot, changed.clone()));
        }
        Timeline { entries }
    }
}

/// Returns the node whose place a change sets.
fn moved_node(change: &MissionChange<f64>) -> Option<GroundNode> {
    match *change {
        MissionChange::User { user, .. } => Some(GroundNode::User(user.into())),
        MissionChange::Sensor { sensor, .. } => Some(GroundNode::Sensor(sensor.into())),
        _ => None,
    }
}

/// A mission as it is in each slot.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeline {
    /// The first slot of each version, ascending, and the mission from then on; never empty.
    entries: Vec<(u32, HostMission)>,
}

impl Timeline {
    /// Returns the versions of the mission, each with its first slot.
    pub fn versions(&self) -> &[(u32, HostMission)] {
        &self.entries
    }

    /// Returns the index of the version that holds in a slot.
    pub fn version_in(&self, slot: u32) -> usize {
        let later = |(from_slot, _): &(u32, HostMission)| *from_slot <= slot;
        self.entries.partition_point(later).max(1) - 1
    }

    /// Returns the mission as it is in a slot.
    pub fn in_slot(&self, slot: u32) -> &HostMission {
        &self.entries[self.version_in(slot)].1
    }

    /// Returns the mission as it is at the end.
    pub fn at_end(&self) -> &HostMission {
        &self.entries[self.entries.len() - 1].1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;

    fn parse(text: &str) -> Result<Events, String> {
        let scenario = Scenario::shipped("separated").expect("shipped");
        Events::parse(text, &scenario.mission)
    }

    #[test]
    fn events_are_read_in_the_order_of_their_slots() {
        let events = parse(
            "[[event]]\nslot = 40\nslots = 55\n\
             [[event]]\nslot = 31\nuser = 15\nposition_m = [420.0, 180.0]\n\
             [[event]]\nslot = 31\nsensor = 7\nleaves = true\n",
        )
        .expect("valid events");
        let slots: Vec<u32> = events.changes().iter().map(|c| c.from_slot).collect();
        assert_eq!(slots, [31, 31, 40]);
        let scenario = Scenario::shipped("separated").expect("shipped");
        let timeline = events.timeline(&scenario.mission);
        let seen = |slot| {
            let mission = timeline.in_slot(slot);
            (
                mission.slots(),
                mission.users().count(),
                mission.sensors().count(),
            )
        };
        assert_eq!(seen(30), (60, 15, 36));
        assert_eq!(seen(31), (60, 16, 35));
        assert_eq!(seen(40), (55, 16, 35));
        assert_eq!(
            (timeline.versions().len(), timeline.at_end().slots()),
            (3, 55)
        );
    }

    #[test]
    fn wrong_events_are_named() {
        for (text, words) in [
            ("[[event]]\nuser = 3\n", "missing field `slot`"),
            ("[[event]]\nslot = 3\nusr = 3\n", "usr"),
            (
                "[[event]]\nslot = 1\nslots = 55\n",
                "event 1 (slot 1): slot is 1, but must be from 2 to 60",
            ),
            (
                "[[event]]\nslot = 9\n",
                "event 1 (slot 9): changes 0 things, but must change one",
            ),
            (
                "[[event]]\nslot = 9\nuser = 3\n",
                "event 1 (slot 9): must have either position_m or leaves = true",
            ),
            (
                "[[event]]\nslot = 9\nuser = 3\nposition_m = [1, 2, 3]\n",
                "event[0].position_m: is [1.0, 2.0, 3.0], but must be two numbers: east and north in metres (line 4",
            ),
            (
                "[[event]]\nslot = 9\nslots = 50\nnoise_dbm = -90\n",
                "changes 2 things",
            ),
            (
                "[[event]]\nslot = 9\nleaves = true\n",
                "need the key user or sensor",
            ),
            (
                "[[event]]\nslot = 9\nuser = 17\nposition_m = [1, 1]\n",
                "user 17, but must be at most 15, the next unused number",
            ),
            (
                "[[event]]\nslot = 9\nmax_speed_mps = nan\n",
                "mission.max_speed_mps is NaN",
            ),
            (
                "[[event]]\nslot = 9\nuser = 3\nposition_m = [-5, 1]\n",
                "users.positions_m[3] is [-5, 1], but must lie in the area",
            ),
        ] {
            let error = parse(text).expect_err(text);
            assert!(error.contains(words), "{error}");
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }
}
