//! Groups of random missions: by layout, by numbers of users (`M`) and sensors (`J`), and by `J Gamma`.
//!
//! Results on many missions are also stated for each group, so that a weakness that a mean hides is
//! seen. A mission is in several groups: one of each kind.

use std::fmt;

use crate::{DrawnMission, HostMission, Layout, Layouts, Scenario};

/// The properties of a mission by which it belongs to groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissionProperties {
    /// The number of users (`M`).
    pub users: usize,
    /// The number of sensors (`J`).
    pub sensors: usize,
    /// `J Gamma`, the share of the error budget of an ideal channel that may be used: 0 to 1.
    pub tolerance: f64,
    /// The layouts; `None` if they are not known.
    pub layouts: Option<Layouts>,
}

impl MissionProperties {
    /// Returns the properties of a mission with unknown layouts.
    pub fn of(mission: &HostMission) -> Self {
        let sensors = mission.sensor_count();
        Self {
            users: mission.user_count(),
            sensors,
            tolerance: sensors as f64 * mission.parameters().mse_threshold,
            layouts: None,
        }
    }

    /// Returns the properties of a scenario. Its layouts are known if it is the mission of the seed
    /// in its name, `random-SEED`, as `host-sim scenario random` writes it; the digests are compared.
    pub fn of_scenario(scenario: &Scenario) -> Self {
        let drawn = || {
            let seed = scenario.name.strip_prefix("random-")?.parse().ok()?;
            let drawn = DrawnMission::new(seed, None, &[]).ok()?;
            (drawn.scenario.digest() == scenario.digest()).then_some(drawn.layouts)
        };
        Self {
            layouts: drawn(),
            ..Self::of(&scenario.mission)
        }
    }
}

/// A group of missions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MissionGroup {
    /// The users have this layout.
    UserLayout(Layout),
    /// The sensors have this layout.
    SensorLayout(Layout),
    /// The layouts are not known.
    UnknownLayouts,
    /// The number of users is in this range, ends included.
    Users(usize, usize),
    /// The number of sensors is in this range, ends included.
    Sensors(usize, usize),
    /// `J Gamma` is below 0.5.
    LowTolerance,
    /// `J Gamma` is from 0.5 to 0.7.
    MediumTolerance,
    /// `J Gamma` is above 0.7.
    HighTolerance,
}

impl MissionGroup {
    /// The groups by numbers of users and sensors and by `J Gamma`.
    pub const BY_SIZE: [Self; 9] = [
        Self::Users(4, 8),
        Self::Users(9, 12),
        Self::Users(13, 16),
        Self::Sensors(8, 24),
        Self::Sensors(25, 44),
        Self::Sensors(45, 64),
        Self::LowTolerance,
        Self::MediumTolerance,
        Self::HighTolerance,
    ];

    /// Returns the groups by layout of the users and of the sensors.
    pub fn by_layout() -> impl Iterator<Item = Self> {
        let users = Layout::ALL.into_iter().map(Self::UserLayout);
        let sensors = Layout::ALL.into_iter().map(Self::SensorLayout);
        users.chain(sensors).chain([Self::UnknownLayouts])
    }

    /// Returns whether a mission with these properties belongs to the group.
    pub fn contains(self, properties: &MissionProperties) -> bool {
        let MissionProperties {
            users,
            sensors,
            tolerance,
            layouts,
        } = *properties;
        match self {
            Self::UserLayout(layout) => layouts.is_some_and(|known| known.users == layout),
            Self::SensorLayout(layout) => layouts.is_some_and(|known| known.sensors == layout),
            Self::UnknownLayouts => layouts.is_none(),
            Self::Users(least, most) => (least..=most).contains(&users),
            Self::Sensors(least, most) => (least..=most).contains(&sensors),
            Self::LowTolerance => tolerance < 0.5,
            Self::MediumTolerance => (0.5..0.7).contains(&tolerance),
            Self::HighTolerance => tolerance >= 0.7,
        }
    }
}

impl fmt::Display for MissionGroup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UserLayout(layout) => write!(f, "users {}", layout.name()),
            Self::SensorLayout(layout) => write!(f, "sensors {}", layout.name()),
            Self::UnknownLayouts => f.write_str("layouts unknown"),
            Self::Users(least, most) => write!(f, "{least} to {most} users"),
            Self::Sensors(least, most) => write!(f, "{least} to {most} sensors"),
            Self::LowTolerance => f.write_str("J Gamma below 0.5"),
            Self::MediumTolerance => f.write_str("J Gamma from 0.5 to 0.7"),
            Self::HighTolerance => f.write_str("J Gamma above 0.7"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random;

    /// Each mission of the distribution is in one group of each of the five kinds.
    #[test]
    fn the_groups_of_a_kind_divide_the_missions() {
        let mut sizes = [0; 19];
        let groups: Vec<_> = (MissionGroup::by_layout()
            .filter(|g| *g != MissionGroup::UnknownLayouts))
        .chain(MissionGroup::BY_SIZE)
        .collect();
        for seed in 0..60 {
            let scenario = random(seed, None).expect("a mission");
            let properties = MissionProperties::of_scenario(&scenario);
            assert!(!MissionGroup::UnknownLayouts.contains(&properties));
            let is_in: Vec<bool> = groups.iter().map(|g| g.contains(&properties)).collect();
            let count = |range: std::ops::Range<usize>| is_in[range].iter().filter(|x| **x).count();
            for range in [0..5, 5..10, 10..13, 13..16, 16..19] {
                assert_eq!(count(range.clone()), 1, "{properties:?} {range:?}");
            }
            for (size, is_in) in sizes.iter_mut().zip(is_in) {
                *size += usize::from(is_in);
            }
        }
        assert!(sizes.iter().all(|&size| size > 2), "{sizes:?}");
    }

    /// Layouts are known only of the very mission that the seed in the name gives.
    #[test]
    fn layouts_are_recovered_from_the_seed_in_the_name() {
        let drawn = DrawnMission::new(17, None, &[]).expect("a mission");
        let known = MissionProperties::of_scenario(&drawn.scenario);
        assert_eq!(known.layouts, Some(drawn.layouts));
        for name in ["random-0018", "mission-17", "random-x"] {
            let renamed = Scenario::parse(name, &drawn.scenario.to_toml()).expect("valid");
            let properties = MissionProperties::of_scenario(&renamed);
            assert_eq!(properties.layouts, None, "{name}");
            assert!(MissionGroup::UnknownLayouts.contains(&properties));
            assert_eq!(properties, MissionProperties::of(&renamed.mission));
        }
    }
}
