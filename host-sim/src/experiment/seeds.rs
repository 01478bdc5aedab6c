//! Flies the policies of finished trainings and writes their results to `seeds.csv`.

use std::{
    fs,
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use sha2::{Digest as _, Sha256};

use super::{
    ExperimentContext,
    cell::{Cell, Learner, Training},
    rounded,
    seed_table::{SEEDS, SeedRow},
    table,
    trainings::CELLS,
};
use crate::policy::{HostPolicy, PolicyChoice};
use environment::Allocation;

/// The largest seed that is looked for.
pub const SEEDS_MAX: u64 = 16;

/// What [`collect`] has done.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Collected {
    /// The number of rows that were measured now.
    pub flown: usize,
    /// The number of rows that were kept because their policies are not there.
    pub kept: usize,
    /// The policies of seed 1 that were copied to the shipped ones.
    pub copied: Vec<String>,
    /// The runs that have not finished.
    pub unfinished: Vec<String>,
}

/// Flies every policy of the figures' missions that is shipped or that a finished run in `runs` has
/// left, and writes `seeds.csv` in the directory of shipped policies. Rows whose policies are not
/// there stay as they are. Policies of seed 1 that are not shipped yet are copied to the shipped
/// ones.
///
/// # Errors
/// Returns a message of one line if a policy cannot be read or flown, is not the one that its name
/// says, or a file cannot be written.
pub fn collect(context: &ExperimentContext<'_>, runs: Option<&Path>) -> Result<Collected, String> {
    let mut collected = Collected::default();
    let mut places = Vec::new();
    let models = context.settings().models.clone();
    let mut trainings = Vec::new();
    for cell in Cell::all() {
        for learner in Learner::ALL {
            trainings.extend((1..=SEEDS_MAX).map(|seed| Training::new(cell, learner, seed)));
        }
    }
    for training in trainings {
        let run = runs.map(|runs| runs.join(training.to_string()));
        let run = run.filter(|run| run.is_dir());
        let file = match (context.trainings().find(&training), run) {
            (Some(file), _) => Some(file),
            (None, Some(run)) if finished(&run) => Some(run.join("policy.onnx")),
            (None, Some(_)) => {
                collected.unfinished.push(training.to_string());
                None
            }
            (None, None) => None,
        };
        places.push((training, file));
    }
    let measured: Result<Vec<Option<SeedRow>>, String> = places
        .par_iter()
        .map(|(training, file)| {
            let file = file.as_deref();
            file.map(|file| measure(context, training, file))
                .transpose()
        })
        .collect();
    let mut rows = Vec::new();
    for ((training, file), measured) in places.iter().zip(measured?) {
        if let (1, Some(file)) = (training.seed, file) {
            let shipped = models.join(CELLS).join(format!("{training}.onnx"));
            if !shipped.is_file() {
                table::write_bytes(&shipped, &read(file)?)?;
                collected.copied.push(training.to_string());
            }
        }
        match measured {
            Some(row) => {
                collected.flown += 1;
                rows.push(row);
            }
            None => {
                let stored = context.trainings().stored(training)?;
                collected.kept += usize::from(stored.is_some());
                rows.extend(stored.cloned());
            }
        }
    }
    table::write(&models.join(SEEDS), &rows)?;
    Ok(collected)
}

/// Flies the policy of a training.
///
/// # Errors
/// Returns a message of one line if the policy cannot be read or flown, or is not the one that its
/// name says.
pub fn measure(
    context: &ExperimentContext<'_>,
    training: &Training,
    file: &Path,
) -> Result<SeedRow, String> {
    let cell = &training.cell;
    let scenario = cell.scenario()?;
    let choice = PolicyChoice::File(PathBuf::from(file));
    let (policy, _) = HostPolicy::load(&choice, &scenario)?;
    let provenance = policy.provenance();
    let provenance =
        provenance.ok_or_else(|| files::named(file, "does not say how it was trained"))?;
    let [algorithm, preset] = training.learner.arguments();
    let digest = scenario.digest();
    let same_algorithm = provenance.algorithm.eq_ignore_ascii_case(algorithm);
    if provenance.scenario_digest.as_str() != digest
        || !same_algorithm
        || provenance.seed != training.seed
    {
        return Err(files::named(
            file,
            format!(
                "is of {} with seed {} on the scenario {}, and not {training}",
                provenance.algorithm, provenance.seed, provenance.scenario_digest
            ),
        ));
    }
    let episodes = provenance.episodes;
    let flown = context.fly(cell, &choice, Allocation::Exact)?.summary();
    Ok(SeedRow {
        topology: cell.topology,
        mission_time_s: cell.slots,
        noise_dbm: cell.noise_dbm,
        mse_threshold: cell.mse_threshold,
        scenario_digest: digest,
        algorithm: algorithm.into(),
        preset: preset.into(),
        seed: training.seed,
        episodes,
        sum_rate: rounded(flown.sum_rate),
        missed_slots: flown.mse_violations,
        arrived: flown.arrived,
        fair: flown.fair,
        constraint_violations: flown.constraint_violations,
        policy_sha256: sha256(&read(file)?),
    })
}

/// Returns the SHA-256 of a file's bytes, hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns whether a run has its policy and has trained all episodes that its settings name.
fn finished(run: &Path) -> bool {
    let text = |name: &str| fs::read_to_string(run.join(name)).unwrap_or_default();
    let settings: Option<toml::Table> = text("settings.toml").parse().ok();
    let wanted = settings.and_then(|settings| settings.get("episodes")?.as_integer());
    let metrics = text("metrics.csv");
    let last = metrics
        .lines()
        .last()
        .and_then(|line| line.split(',').next());
    let trained = last.and_then(|episode| episode.parse::<i64>().ok());
    run.join("policy.onnx").is_file() && wanted.is_some() && trained >= wanted
}

fn read(file: &Path) -> Result<Vec<u8>, String> {
    fs::read(file).map_err(|error| files::named(file, error))
}
