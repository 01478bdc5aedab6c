//! The results of a sweep: one row for each scenario and choice of settings, over the seeds.

use std::{collections::BTreeMap, fmt::Write as _, fs, path::Path};

use anyhow::{Context, Error, ensure};
use scenario::Scenario;

use crate::{
    compare::{References, label, mission_label},
    run::{SCENARIO, has_run},
    settings::TrainingSettings,
};

use super::record::{RunRecord, RunState};

/// The results of the runs in a sweep's directory.
#[derive(Debug)]
pub struct SweepResults {
    missions: Vec<SweptMission>,
    /// The number of runs that have begun and are not finished.
    pub unfinished: usize,
}

#[derive(Debug)]
struct SweptMission {
    label: String,
    /// `None` if the mission cannot be bounded.
    references: Option<References>,
    groups: Vec<Group>,
}

/// Runs that differ in their seeds only.
#[derive(Debug)]
struct Group {
    label: String,
    /// Seeds and total rates of the best policies, bit/s/Hz.
    rates: Vec<(u64, f64)>,
    /// The number of runs without an admissible policy.
    without_policy: usize,
}

/// Returns whether a directory contains the runs of a sweep, and is not a run itself.
pub fn is_sweep(directory: &Path) -> bool {
    let Ok(entries) = fs::read_dir(directory) else {
        return false;
    };
    !has_run(directory)
        && entries.flatten().any(|entry| {
            let path = entry.path();
            has_run(&path) || RunState::of(&path) == RunState::Finished
        })
}

impl SweepResults {
    /// Reads the records of the finished runs, and computes straight line, search and bound for each
    /// mission.
    ///
    /// # Errors
    /// Fails if no run is finished or if a file cannot be read.
    pub fn read(directory: &Path) -> anyhow::Result<Self> {
        let mut names = Vec::new();
        for entry in fs::read_dir(directory).with_context(|| directory.display().to_string())? {
            let entry = entry?;
            // The script for Slurm is beside the runs.
            if entry.path().is_dir() {
                names.push(entry.file_name());
            }
        }
        names.sort();
        let mut unfinished = 0;
        let mut by_mission: BTreeMap<String, (Scenario, Vec<RunRecord>)> = BTreeMap::new();
        for name in names {
            let run = directory.join(name);
            let Some(record) = RunRecord::read(&run)? else {
                unfinished += usize::from(has_run(&run));
                continue;
            };
            match by_mission.get_mut(&record.scenario_digest) {
                Some((_, records)) => records.push(record),
                None => {
                    let scenario = scenario(&run, &record)?;
                    by_mission.insert(record.scenario_digest.clone(), (scenario, vec![record]));
                }
            }
        }
        ensure!(
            !by_mission.is_empty(),
            "{}: no run of the sweep is finished",
            directory.display()
        );
        let missions = by_mission.into_values().map(|(scenario, records)| {
            Ok(SweptMission {
                label: mission_label(&scenario),
                references: References::of(&scenario.mission).ok(),
                groups: groups(&records)?,
            })
        });
        let mut missions = missions.collect::<anyhow::Result<Vec<_>>>()?;
        missions.sort_by(|a, b| a.label.cmp(&b.label));
        Ok(Self {
            missions,
            unfinished,
        })
    }

    /// Returns the table in Markdown: for each mission its groups, the one with the highest mean
    /// first, and what they are compared with.
    pub fn markdown(&self) -> String {
        let mut table = String::from(
            "| scenario, Gamma | learner | runs | mean | standard deviation | worst | best |\n\
             |---|---|---|---|---|---|---|\n",
        );
        for mission in &self.missions {
            for group in &mission.groups {
                // Writing to a string cannot fail.
                let _ = writeln!(table, "| {} | {} |", mission.label, group.row(mission));
            }
            let Some(references) = &mission.references else {
                continue;
            };
            for (name, rate) in [
                ("fair straight line", references.straight_line),
                ("search", references.search),
                ("upper bound of any mission", references.bound),
            ] {
                let _ = writeln!(table, "| {} | {name} | | {rate:.2} | | | |", mission.label);
            }
        }
        table
    }
}

impl Group {
    fn mean(&self) -> Option<f64> {
        let sum: f64 = self.rates.iter().map(|(_, rate)| rate).sum();
        (!self.rates.is_empty()).then(|| sum / self.rates.len() as f64)
    }

    /// Returns the sample standard deviation, which takes two runs.
    fn deviation(&self) -> Option<f64> {
        let mean = self.mean().filter(|_| self.rates.len() > 1)?;
        let squares = self.rates.iter().map(|(_, rate)| (rate - mean).powi(2));
        Some((squares.sum::<f64>() / (self.rates.len() - 1) as f64).sqrt())
    }

    fn row(&self, mission: &SweptMission) -> String {
        let runs = self.rates.len() + self.without_policy;
        let runs = match self.without_policy {
            0 => runs.to_string(),
            none => format!("{runs}, {none} without an admissible policy"),
        };
        let rate = |rate: Option<f64>| rate.map_or_else(String::new, |rate| format!("{rate:.2}"));
        let mean = match (self.mean(), &mission.references) {
            (Some(mean), Some(references)) => {
                let percent = 100.0 * mean / references.search;
                format!("{mean:.2} ({percent:.1} %)")
            }
            (mean, _) => rate(mean),
        };
        let worst = self.rates.iter().map(|(_, rate)| *rate).reduce(f64::min);
        let best = self.rates.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        let best = best.map_or_else(String::new, |(seed, rate)| {
            format!("{rate:.2}, seed {seed}")
        });
        let (deviation, worst) = (rate(self.deviation()), rate(worst));
        format!(
            "{} | {runs} | {mean} | {deviation} | {worst} | {best}",
            self.label
        )
    }
}

/// Reads the scenario of a run.
fn scenario(run: &Path, record: &RunRecord) -> anyhow::Result<Scenario> {
    let path = run.join(SCENARIO);
    let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let scenario = Scenario::parse_in(&record.scenario, &text, run).map_err(Error::msg);
    scenario.with_context(|| path.display().to_string())
}

/// Puts runs of one mission that differ in their seeds only into one group.
fn groups(records: &[RunRecord]) -> anyhow::Result<Vec<Group>> {
    let mut found: Vec<(TrainingSettings, Group)> = Vec::new();
    for record in records {
        let settings = TrainingSettings {
            seed: 0,
            ..record.settings.clone()
        };
        let known = found.iter().position(|(known, _)| *known == settings);
        let index = match known {
            Some(index) => index,
            None => {
                let group = Group {
                    label: label(&settings)?,
                    rates: Vec::new(),
                    without_policy: 0,
                };
                found.push((settings, group));
                found.len() - 1
            }
        };
        let group = &mut found[index].1;
        match &record.best {
            Some(best) => group.rates.push((record.settings.seed, best.sum_rate)),
            None => group.without_policy += 1,
        }
    }
    // A label leaves out what does not affect learning, so two groups may have the same.
    let labels: Vec<String> = found.iter().map(|(_, group)| group.label.clone()).collect();
    for (settings, group) in &mut found {
        let same = labels.iter().filter(|label| **label == group.label);
        if same.count() > 1 {
            let (evaluation, checkpoint) = (settings.evaluate_every, settings.checkpoint_every);
            group.label += &format!(", evaluated every {evaluation}, saved every {checkpoint}");
        }
    }
    let mut groups: Vec<Group> = found.into_iter().map(|(_, group)| group).collect();
    // The sort is stable: groups without any policy stay in their order, at the end.
    let mean = |group: &Group| group.mean().unwrap_or(f64::NEG_INFINITY);
    groups.sort_by(|a, b| mean(b).total_cmp(&mean(a)));
    Ok(groups)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        settings::{Algorithm, Preset},
        sweep::record::BestPolicy,
    };

    fn record(seed: u64, discount: f32, rate: Option<f64>) -> RunRecord {
        RunRecord {
            scenario: "separated".into(),
            scenario_digest: "d".into(),
            episodes: 4_000,
            best: rate.map(|sum_rate| BestPolicy {
                episode: 20,
                sum_rate,
            }),
            settings: TrainingSettings {
                discount,
                ..TrainingSettings::preset(Preset::Paper, Algorithm::Sac, seed)
            },
        }
    }

    #[test]
    fn a_row_has_mean_spread_worst_and_best_over_the_seeds() {
        let records = [
            record(1, 0.9, Some(50.0)),
            record(1, 0.95, Some(60.0)),
            record(2, 0.95, Some(66.0)),
            record(3, 0.95, Some(63.0)),
            record(2, 0.9, None),
            record(1, 0.8, None),
        ];
        let results = SweepResults {
            missions: vec![SweptMission {
                label: "there 0.015".into(),
                references: Some(References {
                    straight_line: 40.0,
                    search: 70.0,
                    bound: 71.0,
                }),
                groups: groups(&records).unwrap(),
            }],
            unfinished: 0,
        };
        assert_eq!(
            results.markdown().lines().skip(2).collect::<Vec<_>>(),
            [
                "| there 0.015 | SAC, discount 0.95 | 3 | 63.00 (90.0 %) | 3.00 | 60.00 | 66.00, seed 2 |",
                "| there 0.015 | SAC | 2, 1 without an admissible policy | 50.00 (71.4 %) |  | 50.00 | 50.00, seed 1 |",
                "| there 0.015 | SAC, discount 0.8 | 1, 1 without an admissible policy |  |  |  |  |",
                "| there 0.015 | fair straight line | | 40.00 | | | |",
                "| there 0.015 | search | | 70.00 | | | |",
                "| there 0.015 | upper bound of any mission | | 71.00 | | | |",
            ]
        );
    }

    #[test]
    fn groups_with_the_same_label_are_told_apart() {
        let mut often = record(1, 0.9, Some(50.0));
        often.settings.evaluate_every = 5;
        let groups = groups(&[record(1, 0.9, Some(49.0)), often]).unwrap();
        let labels: Vec<&str> = groups.iter().map(|group| group.label.as_str()).collect();
        assert_eq!(
            labels,
            [
                "SAC, evaluated every 5, saved every 500",
                "SAC, evaluated every 20, saved every 500"
            ]
        );
    }
}
