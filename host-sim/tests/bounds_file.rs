//! The committed bounds of the benchmark's missions, and of the fresh ones.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    str::FromStr,
};

use host_sim::{
    benchmark::{self, Bounds},
    policy::PolicyChoice,
};
use scenario::{MissionGroup, MissionProperties};
use vehicle::Profile;

/// Returns the directories of both sets.
fn sets() -> [PathBuf; 2] {
    ["../benchmarks", "../benchmarks/fresh"]
        .map(|folder| Path::new(env!("CARGO_MANIFEST_DIR")).join(folder))
}

#[test]
fn every_mission_has_a_bound_that_no_flight_exceeds() {
    for folder in sets() {
        check_bounds(&folder);
    }
}

/// Every mission has a bound, no bound is of another mission, and no flight exceeds one.
fn check_bounds(folder: &Path) {
    let missions = benchmark::missions(folder).expect("missions");
    let bounds = Bounds::read(folder).expect("readable");
    let names: BTreeSet<&str> = missions
        .iter()
        .map(|mission| mission.name.as_str())
        .collect();
    for mission in &missions {
        let record = bounds.of(&mission.digest()).expect("a bound");
        assert_eq!(record.mission, mission.name);
        assert!(names.contains(record.mission.as_str()));
        assert!(
            0.0 <= record.lower && record.lower <= record.upper,
            "{record:?}"
        );
        let gap = (record.upper - record.lower) / record.upper;
        assert!((record.gap - gap).abs() < 1e-12, "{record:?}");
    }
    assert_eq!(bounds.len(), missions.len());
    let policies = ["plan", "straight-line"].map(PolicyChoice::from_str);
    for mission in missions.iter().step_by(20) {
        let record = bounds.of(&mission.digest()).expect("a bound");
        for policy in &policies {
            let policy = policy.as_ref().expect("a policy");
            let flown = benchmark::fly(mission, policy, Profile::Ideal);
            assert_eq!(flown.violations, 0, "{}", mission.name);
            assert!(flown.sum_rate <= record.upper, "{flown:?} {record:?}");
        }
    }
}

/// The gaps that the benchmark's page promises.
#[test]
fn most_gaps_are_small() {
    for folder in sets() {
        let missions = benchmark::missions(&folder).expect("missions");
        let bounds = Bounds::read(&folder).expect("readable");
        let within = |gap: f64| {
            let known = missions
                .iter()
                .filter_map(|mission| bounds.of(&mission.digest()));
            known.filter(|record| record.gap <= gap).count() as f64 / missions.len() as f64
        };
        assert!(within(0.01) >= 0.95, "{}", within(0.01));
        assert!(within(0.02) >= 0.99, "{}", within(0.02));
    }
}

/// The sets share no mission, and each is large enough for its quantiles. All missions are those of
/// the seeds in their names, so their layouts are known, and each layout occurs.
#[test]
fn the_sets_are_random_missions_and_share_none() {
    let mut digests = BTreeSet::new();
    for folder in sets() {
        let missions = benchmark::missions(&folder).expect("missions");
        assert_eq!(missions.len(), 200);
        let properties: Vec<_> = missions
            .iter()
            .map(MissionProperties::of_scenario)
            .collect();
        for group in MissionGroup::by_layout().chain(MissionGroup::BY_SIZE) {
            let is_in = |one: &&MissionProperties| group.contains(one);
            let count = properties.iter().filter(is_in).count();
            let is_expected = match group {
                MissionGroup::UnknownLayouts => count == 0,
                _ => count >= 20,
            };
            assert!(is_expected, "{}: {group}: {count}", folder.display());
        }
        digests.extend(missions.iter().map(scenario::Scenario::digest));
    }
    assert_eq!(digests.len(), 400);
}
