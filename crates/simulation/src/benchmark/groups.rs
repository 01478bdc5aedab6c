//! The statistics of policies over groups of missions: by layout, by numbers of users and sensors and
//! by `J Gamma`.

use std::collections::BTreeMap;

use scenario::{MissionGroup, MissionProperties, Scenario};
use serde::Serialize;

use super::{Bounds, Flown, PolicyStatistics, statistics};

/// The statistics of one policy over the missions of a group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupStatistics {
    /// The group; `all` for all missions.
    pub group: String,
    /// The statistics over its missions.
    #[serde(flatten)]
    pub statistics: PolicyStatistics,
}

/// Returns the statistics of each policy over all missions, then over those of each group. The first
/// policy is the reference. Groups are left out of which a policy flew no mission.
pub fn group_statistics(
    scenarios: &[Scenario],
    policies: &[String],
    flights: &[Flown],
    bounds: &Bounds,
) -> Vec<GroupStatistics> {
    let properties: BTreeMap<String, MissionProperties> = scenarios
        .iter()
        .map(|scenario| (scenario.digest(), MissionProperties::of_scenario(scenario)))
        .collect();
    let groups = MissionGroup::by_layout().chain(MissionGroup::BY_SIZE);
    let mut found = Vec::new();
    for group in [None].into_iter().chain(groups.map(Some)) {
        let is_in = |flown: &&Flown| {
            let known = properties.get(&flown.digest);
            group.is_none_or(|group| known.is_some_and(|known| group.contains(known)))
        };
        let flights: Vec<Flown> = flights.iter().filter(is_in).cloned().collect();
        for policy in policies {
            let statistics = statistics(policy, &policies[0], &flights, &[], bounds);
            if statistics.flown > 0 {
                found.push(GroupStatistics {
                    group: group.map_or("all".to_owned(), |group| group.to_string()),
                    statistics,
                });
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::benchmark::BoundRecord;

    /// Each mission counts once in each kind of group, with the fraction that it has in all.
    #[test]
    fn each_mission_is_in_one_group_of_each_kind() {
        let mut bounds = Bounds::default();
        let (mut scenarios, mut flights) = (Vec::new(), Vec::new());
        for seed in 1..=12 {
            let scenario = scenario::random(seed, None).expect("a mission");
            let digest = scenario.digest();
            bounds.insert(BoundRecord {
                mission: scenario.name.clone(),
                digest: digest.clone(),
                upper: 10.0,
                lower: 9.9,
                gap: 0.01,
                processor_seconds: 1.0,
            });
            flights.push(Flown {
                mission: scenario.name.clone(),
                digest,
                policy: "plan".into(),
                profile: "ideal".into(),
                sum_rate: 10.0 - 0.1 * seed as f64,
                violations: usize::from(seed == 3),
                inaccurate_slots: 0,
                preparation_s: 1.0,
                decision_us: 1.0,
            });
            scenarios.push(scenario);
        }
        let policies = ["plan".to_owned(), "any".to_owned()];
        let found = group_statistics(&scenarios, &policies, &flights, &bounds);
        let all = &found[0];
        assert_eq!((all.group.as_str(), all.statistics.counted), ("all", 12));
        assert!(found.iter().all(|row| row.statistics.policy == "plan"));
        let parts = |is_in: &dyn Fn(&str) -> bool| {
            let rows = found.iter().filter(|row| is_in(&row.group));
            let sums = rows.map(|row| &row.statistics).map(|row| {
                let total = row.mean * row.counted as f64;
                (row.counted, total, row.violations)
            });
            sums.fold((0, 0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1, a.2 + b.2))
        };
        let kinds: [&dyn Fn(&str) -> bool; 5] = [
            &|group| group.starts_with("users "),
            &|group| group.starts_with("sensors "),
            &|group| group.ends_with(" users"),
            &|group| group.ends_with(" sensors"),
            &|group| group.starts_with("J Gamma"),
        ];
        for kind in kinds {
            let (counted, total, violations) = parts(kind);
            assert_eq!((counted, violations), (12, 1));
            assert!((total - 12.0 * all.statistics.mean).abs() < 1e-9);
        }
        assert!(!found.iter().any(|row| row.group == "layouts unknown"));
        // The layouts of a mission that the seed in its name does not give are not known.
        let text = scenarios[0].to_toml();
        scenarios[0] = Scenario::parse("random-0002", &text).expect("valid");
        let found = group_statistics(&scenarios, &policies, &flights, &bounds);
        let unknown = found.iter().find(|row| row.group == "layouts unknown");
        assert_eq!(unknown.map(|row| row.statistics.counted), Some(1));
    }
}
