//! The choices of mission and settings that a sweep's file lists: their products, and the words that
//! name them.

use std::fmt::Write as _;

use anyhow::{Context, bail, ensure};
use scenario::Changes;
use toml::{Table, Value};

use crate::{
    overlay::overlay,
    settings::{Algorithm, Preset, TrainingSettings},
};

use super::{
    fields::short,
    file::{MissionValues, RUNS_MAX, SweepFile},
};

/// A short name for all three learning rates, as the option `--learning-rate`.
const LEARNING_RATE: &str = "learning_rate";
const LEARNING_RATES: [&str; 3] = [
    "policy_learning_rate",
    "critic_learning_rate",
    "temperature_learning_rate",
];

/// Returns the product of the mission's parameters.
pub(super) fn changes(values: &MissionValues) -> Vec<Changes> {
    fn all<T: Copy>(values: &[T]) -> Vec<Option<T>> {
        match values.is_empty() {
            true => vec![None],
            false => values.iter().copied().map(Some).collect(),
        }
    }
    let mut product = Vec::new();
    for mse_threshold in all(&values.mse_threshold) {
        for noise_dbm in all(&values.noise_dbm) {
            for slots in all(&values.slots) {
                product.push(Changes {
                    mse_threshold,
                    noise_dbm,
                    slots,
                });
            }
        }
    }
    product
}

/// Returns the part of a run's name that says what differs from the scenario.
pub(super) fn mission_name(changes: &Changes) -> String {
    let mut name = String::new();
    // Writing to a string cannot fail.
    if let Some(threshold) = changes.mse_threshold {
        let _ = write!(name, "-mse_threshold={threshold}");
    }
    if let Some(noise) = changes.noise_dbm {
        let _ = write!(name, "-noise_dbm={noise}");
    }
    if let Some(slots) = changes.slots {
        let _ = write!(name, "-slots={slots}");
    }
    name
}

/// Returns the product of algorithms, presets and settings, each with the part of the name that says
/// what it is. The name has all settings of the file, also those with one value, so that a run keeps
/// its name when the file gets further values.
pub(super) fn all_settings(file: &SweepFile) -> anyhow::Result<Vec<(TrainingSettings, String)>> {
    let mut product = vec![(Vec::<(&str, &Value)>::new(), String::new())];
    for (key, values) in &file.settings {
        check_values(file, key, values)?;
        let mut longer = Vec::new();
        for (pairs, words) in &product {
            for value in values {
                let mut pairs = pairs.clone();
                pairs.push((key, value));
                let value = match value {
                    Value::String(text) => text.clone(),
                    other => other.to_string(),
                };
                longer.push((pairs, format!("{words}-{key}={value}")));
            }
        }
        product = longer;
        ensure!(
            product.len() as u64 <= RUNS_MAX,
            "settings: the product has more than {RUNS_MAX} runs"
        );
    }
    let mut all = Vec::new();
    for &algorithm in &file.algorithms {
        for &preset in &file.presets {
            let start = format!("-{}-{}", algorithm.name(), preset_name(preset));
            for (pairs, words) in &product {
                let settings = TrainingSettings::preset(preset, algorithm, 0);
                let settings = overlay(&settings, table(pairs))?;
                let checked = settings.check();
                checked.with_context(|| format!("settings of {}{words}", &start[1..]))?;
                all.push((settings, format!("{start}{words}")));
            }
        }
    }
    Ok(all)
}

/// Checks that a setting exists, that each of its values has the right type, and that they differ.
fn check_values(file: &SweepFile, key: &str, values: &[Value]) -> anyhow::Result<()> {
    if ["algorithm", "seed"].contains(&key) {
        bail!("settings.{key}: it is not in [settings], but before it, as `{key}` or `seeds`");
    }
    let other = LEARNING_RATES.iter().find(|&&rate| {
        key == LEARNING_RATE && file.settings.iter().any(|(other, _)| other == rate)
    });
    if let Some(other) = other {
        bail!(
            "settings.{LEARNING_RATE} sets all three learning rates, but settings.{other} sets one"
        );
    }
    let usual = TrainingSettings::preset(Preset::Paper, Algorithm::Sac, 0);
    let known = Table::try_from(&usual)?;
    if key != LEARNING_RATE && !known.contains_key(key) {
        let known: Vec<&str> = known.keys().map(String::as_str).collect();
        bail!(
            "settings.{key} is unknown; known here: {LEARNING_RATE}, {}",
            known.join(", ")
        );
    }
    for (i, value) in values.iter().enumerate() {
        let fit = overlay(&usual, table(&[(key, value)]));
        if let Err(problem) = fit {
            let problem = format!("{problem:#}");
            let problem = problem.lines().next().unwrap_or_default().to_owned();
            bail!("settings.{key} is {}: {problem}", short(value));
        }
        ensure!(
            !values[..i].contains(value),
            "settings.{key} contains {value} twice, but each run is trained once"
        );
    }
    Ok(())
}

fn table(pairs: &[(&str, &Value)]) -> Table {
    let mut table = Table::new();
    for &(key, value) in pairs {
        match key {
            LEARNING_RATE => {
                table.extend(LEARNING_RATES.map(|rate| (rate.to_owned(), value.clone())));
            }
            _ => _ = table.insert(key.to_owned(), value.clone()),
        }
    }
    table
}

fn preset_name(preset: Preset) -> &'static str {
    match preset {
        Preset::Paper => "paper",
        Preset::Tuned => "tuned",
    }
}
