//! Comparison of trained policies with the fair straight line, with the search's feasible mission, and
//! with the upper bound of all missions.

use std::{fmt::Write as _, path::Path};

use anyhow::{Context, bail, ensure};
use environment::Allocation;
use firmware_core::policy::{StraightLine, mlp::Mlp};
use planning::bound;
use scenario::{HostMission, Scenario};

use crate::{
    evaluate::fly,
    run::Run,
    settings::{Algorithm, Preset, TrainingSettings},
};

/// The values that policies on a mission are compared with, bit/s/Hz summed over the slots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct References {
    /// Total rate of the straight line that serves the nearest admissible user.
    pub straight_line: f64,
    /// Total rate of the search's feasible mission: `lower` of `host-sim bound`.
    pub search: f64,
    /// Upper bound on the total rate of every mission: `upper` of `host-sim bound`.
    pub bound: f64,
}

impl References {
    /// Flies the straight line and computes search and bound, which takes about a second for a shipped
    /// mission.
    ///
    /// # Errors
    /// Fails if the mission cannot be bounded.
    pub fn of(mission: &HostMission) -> anyhow::Result<Self> {
        let bound = bound::certify(mission, &bound::BoundSettings::default(), |_| ())?;
        Ok(Self {
            straight_line: fly(mission, StraightLine::new(mission), Allocation::Exact)?.sum_rate,
            search: bound.lower,
            bound: bound.upper,
        })
    }
}

/// A table with learners as rows and missions as columns.
#[derive(Debug)]
pub struct Comparison {
    missions: Vec<Mission>,
    learners: Vec<LearnerRow>,
}

#[derive(Debug)]
struct Mission {
    label: String,
    digest: String,
    references: References,
}

#[derive(Debug)]
struct LearnerRow {
    label: String,
    algorithm: Algorithm,
    /// For every mission, the total rates of all seeds.
    rates: Vec<Vec<f64>>,
}

impl Comparison {
    /// Flies the best policy of every run.
    ///
    /// # Errors
    /// Fails if a directory does not contain a run or if its best policy violates a constraint.
    pub fn of(directories: &[impl AsRef<Path>]) -> anyhow::Result<Self> {
        let mut comparison = Self {
            missions: Vec::new(),
            learners: Vec::new(),
        };
        for directory in directories {
            let directory = directory.as_ref();
            let run = Run::open(directory)?;
            let adding = comparison.add(&run);
            adding.with_context(|| directory.display().to_string())?;
        }
        Ok(comparison)
    }

    fn add(&mut self, run: &Run) -> anyhow::Result<()> {
        let best = run.progress.best.as_ref();
        let best = best.context("the run has no admissible policy")?;
        let mission = &run.scenario.mission;
        let inner = run.progress.settings.inner;
        let flight = fly(mission, Mlp::load(best.actor.to_policy_file()?)?, inner)?;
        ensure!(
            flight.is_admissible_under(inner),
            "its best policy violates a constraint"
        );
        let column = self.column(&run.scenario)?;
        let settings = &run.progress.settings;
        let label = label(settings)?;
        let known = self.learners.iter().position(|row| row.label == label);
        let row = known.unwrap_or_else(|| {
            self.learners.push(LearnerRow {
                label,
                algorithm: settings.algorithm,
                rates: Vec::new(),
            });
            self.learners.len() - 1
        });
        let rates = &mut self.learners[row].rates;
        rates.resize(rates.len().max(column + 1), Vec::new());
        rates[column].push(flight.sum_rate);
        Ok(())
    }

    fn column(&mut self, scenario: &Scenario) -> anyhow::Result<usize> {
        let digest = scenario.digest();
        if let Some(known) = self.missions.iter().position(|m| m.digest == digest) {
            return Ok(known);
        }
        self.missions.push(Mission {
            label: mission_label(scenario),
            digest,
            references: References::of(&scenario.mission)?,
        });
        Ok(self.missions.len() - 1)
    }

    /// Returns the table in Markdown: total rates and their percentage of the search's, with the best
    /// learner of a column in bold.
    pub fn markdown(&self) -> String {
        let mut table = String::from("| scenario, Gamma");
        for mission in &self.missions {
            // Writing to a string cannot fail.
            let _ = write!(table, " | {}", mission.label);
        }
        let _ = writeln!(table, " |\n|---{}|", "|---".repeat(self.missions.len()));
        let mut row = |label: &str, cell: &dyn Fn(usize, &Mission) -> String| {
            let cells = self.missions.iter().enumerate();
            let cells: Vec<String> = cells.map(|(i, mission)| cell(i, mission)).collect();
            let _ = writeln!(table, "| {label} | {} |", cells.join(" | "));
        };
        let of_search = |rate: f64, mission: &Mission| {
            let percent = 100.0 * rate / mission.references.search;
            format!("{rate:.2} ({percent:.1} %)")
        };
        row("fair straight line", &|_, mission| {
            of_search(mission.references.straight_line, mission)
        });
        for learner in &self.learners {
            row(&learner.label, &|i, mission| match learner.mean(i) {
                None => String::new(),
                Some(mean) => {
                    let others = self.learners.iter().filter_map(|other| other.mean(i));
                    let best = others.fold(f64::NEG_INFINITY, f64::max);
                    let mark = if mean == best { "**" } else { "" };
                    format!(
                        "{mark}{}{mark}{}",
                        of_search(mean, mission),
                        learner.seeds(i)
                    )
                }
            });
        }
        row("search", &|_, mission| {
            format!("{:.2}", mission.references.search)
        });
        row("upper bound of any mission", &|_, mission| {
            format!("{:.2}", mission.references.bound)
        });
        table
    }

    /// Checks that on every mission each SAC row is above the straight line and at least one of them
    /// is not below any DDPG row.
    ///
    /// # Errors
    /// Names the first mission on which this does not hold.
    pub fn check(&self) -> anyhow::Result<()> {
        for (i, mission) in self.missions.iter().enumerate() {
            let of = |algorithm| {
                let rows = self.learners.iter();
                let rows = rows.filter(move |row| row.algorithm == algorithm);
                rows.filter_map(move |row| row.mean(i))
            };
            let line = mission.references.straight_line;
            let Some(worst) = of(Algorithm::Sac).reduce(f64::min) else {
                bail!("{}: no run of SAC", mission.label);
            };
            let best = of(Algorithm::Sac).fold(worst, f64::max);
            let label = &mission.label;
            ensure!(
                worst > line,
                "{label}: SAC has {worst:.3}, the straight line {line:.3}"
            );
            ensure!(
                of(Algorithm::Ddpg).next().is_some(),
                "{label}: no run of DDPG"
            );
            for ddpg in of(Algorithm::Ddpg) {
                ensure!(best >= ddpg, "{label}: SAC has {best:.3}, DDPG {ddpg:.3}");
            }
        }
        Ok(())
    }
}

impl LearnerRow {
    fn mean(&self, mission: usize) -> Option<f64> {
        let rates = self.rates.get(mission).filter(|rates| !rates.is_empty())?;
        Some(rates.iter().sum::<f64>() / rates.len() as f64)
    }

    /// Returns the range of rates over the seeds, or an empty text for a single seed.
    fn seeds(&self, mission: usize) -> String {
        let rates = &self.rates[mission];
        if rates.len() < 2 {
            return String::new();
        }
        let least = rates.iter().copied().fold(f64::INFINITY, f64::min);
        let most = rates.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        format!(", {} seeds from {least:.2} to {most:.2}", rates.len())
    }
}

/// Returns the scenario's name and threshold, and its other differences from the shipped scenario of
/// that name.
pub(crate) fn mission_label(scenario: &Scenario) -> String {
    let p = scenario.mission.parameters();
    let mut label = format!("{} {:.3}", scenario.name, p.mse_threshold);
    if let Some(shipped) = Scenario::shipped(&scenario.name) {
        let usual = shipped.mission.parameters();
        if p.slots != usual.slots {
            let _ = write!(label, ", N = {}", p.slots);
        }
        if p.noise_power != usual.noise_power {
            let dbm = 10.0 * p.noise_power.0.log10() + 30.0;
            let _ = write!(label, ", {dbm:.0} dBm");
        }
    }
    label
}

/// Settings that a label does not mention: they do not affect what is learned, or it names them
/// otherwise.
const UNLABELLED: [&str; 4] = ["algorithm", "seed", "evaluate_every", "checkpoint_every"];
const LEARNING_RATES: [&str; 3] = [
    "policy_learning_rate",
    "critic_learning_rate",
    "temperature_learning_rate",
];

/// Returns a label with the algorithm, the preset with the fewest differences (Table I is not
/// mentioned), and these differences.
pub(crate) fn label(settings: &TrainingSettings) -> anyhow::Result<String> {
    let name = settings.algorithm.name().to_uppercase();
    let mut shortest: Option<(String, Vec<(String, String)>)> = None;
    for (preset, known_as) in [(Preset::Paper, ""), (Preset::Tuned, ", tuned")] {
        let preset = TrainingSettings::preset(preset, settings.algorithm, settings.seed);
        let changed = changes(settings, &preset)?;
        if shortest
            .as_ref()
            .is_none_or(|(_, least)| changed.len() < least.len())
        {
            shortest = Some((format!("{name}{known_as}"), changed));
        }
    }
    let (start, changed) = shortest.unwrap_or_default();
    Ok(changed.into_iter().fold(start, |label, (key, value)| {
        format!("{label}, {} {value}", key.replace('_', " "))
    }))
}

/// Returns the names and values of the settings that differ from a preset.
fn changes(
    settings: &TrainingSettings,
    preset: &TrainingSettings,
) -> anyhow::Result<Vec<(String, String)>> {
    let (own, preset) = (
        toml::Table::try_from(settings)?,
        toml::Table::try_from(preset)?,
    );
    let changed = own.iter().filter(|(key, value)| {
        !UNLABELLED.contains(&key.as_str()) && preset.get(*key) != Some(value)
    });
    let mut changed: Vec<(String, String)> = changed
        .map(|(key, value)| (key.clone(), shown(value)))
        .collect();
    let rate = settings.policy_learning_rate;
    let of_rates = |key: &String| LEARNING_RATES.contains(&key.as_str());
    if settings.critic_learning_rate == rate
        && settings.temperature_learning_rate == rate
        && changed.iter().any(|(key, _)| of_rates(key))
    {
        changed.retain(|(key, _)| !of_rates(key));
        changed.push(("learning rates".into(), format!("{rate:e}")));
    }
    Ok(changed)
}

/// Formats a value, and a number with the digits of single precision.
fn shown(value: &toml::Value) -> String {
    match value {
        toml::Value::Float(number) => (*number as f32).to_string(),
        toml::Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(algorithm: Algorithm) -> TrainingSettings {
        TrainingSettings::preset(Preset::Paper, algorithm, 4)
    }

    #[test]
    fn a_label_says_what_is_not_as_in_table_one() {
        let mut s = settings(Algorithm::Sac);
        assert_eq!(label(&s).unwrap(), "SAC");
        (s.evaluate_every, s.discount) = (50, 0.98);
        assert_eq!(label(&s).unwrap(), "SAC, discount 0.98");
        let tuned = TrainingSettings::preset(Preset::Tuned, Algorithm::Sac, 1);
        assert_eq!(label(&tuned).unwrap(), "SAC, tuned");
        let unpriced = TrainingSettings {
            fairness_prices: false,
            ..TrainingSettings::preset(Preset::Tuned, Algorithm::Sac, 1)
        };
        assert_eq!(
            label(&unpriced).unwrap(),
            "SAC, tuned, fairness prices false"
        );
        s = settings(Algorithm::Ddpg);
        s.critic_learning_rate = 1e-3;
        assert_eq!(label(&s).unwrap(), "DDPG, critic learning rate 0.001");
    }

    fn comparison(sac: &[f64], ddpg: f64) -> Comparison {
        let row = |label: &str, algorithm, rates: &[f64]| LearnerRow {
            label: label.into(),
            algorithm,
            rates: vec![rates.to_vec()],
        };
        Comparison {
            missions: vec![Mission {
                label: "there 0.015".into(),
                digest: String::new(),
                references: References {
                    straight_line: 50.0,
                    search: 80.0,
                    bound: 81.0,
                },
            }],
            learners: vec![
                row("SAC", Algorithm::Sac, sac),
                row("DDPG", Algorithm::Ddpg, &[ddpg]),
            ],
        }
    }

    #[test]
    fn a_table_has_rates_percentages_and_seeds() {
        let table = comparison(&[60.0, 64.0], 56.0).markdown();
        assert_eq!(
            table,
            "| scenario, Gamma | there 0.015 |\n|---|---|\n\
             | fair straight line | 50.00 (62.5 %) |\n\
             | SAC | **62.00 (77.5 %)**, 2 seeds from 60.00 to 64.00 |\n\
             | DDPG | 56.00 (70.0 %) |\n\
             | search | 80.00 |\n| upper bound of any mission | 81.00 |\n"
        );
    }

    #[test]
    fn sac_below_the_line_or_below_ddpg_is_noticed() {
        comparison(&[60.0], 59.0).check().unwrap();
        let problem = |sac, ddpg| comparison(&[sac], ddpg).check().unwrap_err().to_string();
        let below = "there 0.015: SAC has 49.000, the straight line 50.000";
        assert_eq!(problem(49.0, 48.0), below);
        assert_eq!(
            problem(60.0, 61.0),
            "there 0.015: SAC has 60.000, DDPG 61.000"
        );
    }
}
