//! The file that describes a sweep. `docs/sweeps.md` documents its fields.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::ValueEnum;
use files::input;
use toml::Value;

use crate::settings::{Algorithm, Preset};

use super::fields::{self, Fields};

/// The largest number of runs of a sweep.
pub const RUNS_MAX: u64 = 100_000;

/// The content of the file. Everything that is a list has at least one value.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepFile {
    /// Names of shipped scenarios, or files relative to the folder of the sweep's file.
    pub scenarios: Vec<PathBuf>,
    /// The seeds.
    pub seeds: Vec<u64>,
    /// The algorithms.
    pub algorithms: Vec<Algorithm>,
    /// The presets that the settings start from.
    pub presets: Vec<Preset>,
    /// The parameters of the mission that differ from the scenario's.
    pub mission: MissionValues,
    /// Names of settings, with their values.
    pub settings: Vec<(String, Vec<Value>)>,
    /// Whether finished runs keep their checkpoints.
    pub keep_checkpoints: bool,
    /// Options of the HyperQueue job.
    pub hyperqueue: HyperqueueOptions,
    /// Options of the Slurm job.
    pub slurm: SlurmOptions,
}

/// Parameters of the mission with their values; a list that is empty leaves the scenario's value.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MissionValues {
    /// MSE thresholds (Gamma).
    pub mse_threshold: Vec<f64>,
    /// Noise powers, dBm.
    pub noise_dbm: Vec<f64>,
    /// Numbers of slots (N).
    pub slots: Vec<u32>,
}

/// Options of the HyperQueue job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HyperqueueOptions {
    /// The number of lost workers after which HyperQueue gives a run up.
    pub crash_limit: u32,
    /// Further options of `hq submit`.
    pub options: Vec<String>,
}

/// Options of the Slurm job.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SlurmOptions {
    /// Time limit of an array task, as in `--time`.
    pub time_limit: Option<String>,
    /// The partition.
    pub partition: Option<String>,
    /// Memory of an array task, as in `--mem`.
    pub memory: Option<String>,
    /// Number of runs that an array task executes one after the other.
    pub runs_per_task: Option<u32>,
    /// The largest number of array tasks that are executed at the same time.
    pub running_max: Option<u32>,
    /// Further options of `sbatch`.
    pub options: Vec<String>,
}

/// HyperQueue's own default is 5. Runs are resumed, so each attempt makes progress, and preempted
/// nodes are lost workers as well.
const CRASH_LIMIT: u32 = 20;

const SCENARIO: &str =
    "the name of a shipped scenario or the path of a scenario file, or a list of them";
const SEEDS: &str = "a range such as \"1..5\", or a whole number from 0, or a list of them";

impl SweepFile {
    /// Reads a file.
    ///
    /// # Errors
    /// Names the file, the field, its value and what would be right.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let text = input::read_text(path).with_context(|| path.display().to_string())?;
        Self::parse(&text).with_context(|| path.display().to_string())
    }

    /// Parses the text of a file.
    ///
    /// # Errors
    /// Names the field, its value and what would be right.
    pub fn parse(text: &str) -> anyhow::Result<Self> {
        let mut fields = Fields::parse(text)?;
        let scenarios = fields.list("scenarios", SCENARIO, |value| {
            fields::line(value).map(PathBuf::from)
        })?;
        let Some(scenarios) = scenarios else {
            return fields.missing("scenarios", SCENARIO);
        };
        let seeds = seeds(&mut fields)?;
        let algorithms = fields.list("algorithm", "sac or ddpg, or a list of them", named)?;
        let presets = fields.list("preset", "paper or tuned, or a list of them", named)?;
        let keep_checkpoints = fields.one("keep_checkpoints", "true or false", Value::as_bool)?;
        let mut mission = fields.table("mission")?;
        let number = "a number, or a list of numbers";
        let count = "a whole number above 0, or a list of them";
        let values = MissionValues {
            mse_threshold: (mission.list("mse_threshold", number, fields::number)?)
                .unwrap_or_default(),
            noise_dbm: (mission.list("noise_dbm", number, fields::number)?).unwrap_or_default(),
            slots: (mission.list("slots", count, fields::count)?).unwrap_or_default(),
        };
        mission.finish()?;
        let settings = fields.table("settings")?.remaining()?;
        let hyperqueue = hyperqueue_options(fields.table("hyperqueue")?)?;
        let slurm = slurm_options(fields.table("slurm")?)?;
        fields.finish()?;
        Ok(Self {
            scenarios,
            seeds,
            algorithms: algorithms.unwrap_or_else(|| vec![Algorithm::Sac]),
            presets: presets.unwrap_or_else(|| vec![Preset::Paper]),
            mission: values,
            settings,
            keep_checkpoints: keep_checkpoints.unwrap_or(true),
            hyperqueue,
            slurm,
        })
    }
}

/// Takes the seeds: an inclusive range, a number, or a list.
fn seeds(fields: &mut Fields) -> anyhow::Result<Vec<u64>> {
    let Some(value) = fields.take("seeds") else {
        return fields.missing("seeds", SEEDS);
    };
    let seed = |value: &Value| u64::try_from(value.as_integer()?).ok();
    let seeds: Option<Vec<u64>> = match &value {
        Value::String(range) => match range.split_once("..").map(|(a, b)| (a.parse(), b.parse())) {
            Some((Ok(first), Ok(last))) if first <= last => {
                let last: u64 = last;
                ensure!(
                    last - first < RUNS_MAX,
                    "seeds is \"{range}\", but a sweep has at most {RUNS_MAX} runs"
                );
                Some((first..=last).collect())
            }
            _ => None,
        },
        Value::Array(values) if !values.is_empty() => values.iter().map(seed).collect(),
        other => seed(other).map(|seed| vec![seed]),
    };
    let Some(seeds) = seeds else {
        return fields.wrong("seeds", &value, SEEDS);
    };
    for (i, seed) in seeds.iter().enumerate() {
        ensure!(
            value.is_str() || !seeds[..i].contains(seed),
            "seeds contains {seed} twice, but each run is trained once"
        );
    }
    Ok(seeds)
}

/// Converts the name of a variant.
fn named<T: ValueEnum>(value: &Value) -> Option<T> {
    T::from_str(value.as_str()?, false).ok()
}

/// Takes further options of a program.
fn options(fields: &mut Fields) -> anyhow::Result<Vec<String>> {
    let option = |value: &Value| fields::line(value).filter(|text| text.starts_with('-'));
    let options = fields.list(
        "options",
        "a list of options such as \"--account=A\"",
        option,
    )?;
    Ok(options.unwrap_or_default())
}

fn hyperqueue_options(mut fields: Fields) -> anyhow::Result<HyperqueueOptions> {
    let crash_limit = fields.one("crash_limit", "a whole number above 0", fields::count)?;
    let options = options(&mut fields)?;
    fields.finish()?;
    Ok(HyperqueueOptions {
        crash_limit: crash_limit.unwrap_or(CRASH_LIMIT),
        options,
    })
}

fn slurm_options(mut fields: Fields) -> anyhow::Result<SlurmOptions> {
    let time = "a time without spaces, as in sbatch --time: \"02:00:00\", \"1-12\" or \"90\"";
    let count = "a whole number above 0";
    let options = SlurmOptions {
        time_limit: fields.one("time_limit", time, fields::word)?,
        partition: fields.one("partition", "the name of a partition", fields::word)?,
        memory: fields.one("memory", "a size such as \"500M\" or \"2G\"", fields::word)?,
        runs_per_task: fields.one("runs_per_task", count, fields::count)?,
        running_max: fields.one("running_max", count, fields::count)?,
        options: options(&mut fields)?,
    };
    fields.finish()?;
    Ok(options)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: &str = "scenarios = \"mixed\"\nseeds = 3\n";

    #[test]
    fn a_value_may_stand_for_a_list() {
        let file = SweepFile::parse(LEAST).unwrap();
        assert_eq!(file.scenarios, [PathBuf::from("mixed")]);
        assert_eq!((file.seeds, file.keep_checkpoints), (vec![3], true));
        assert_eq!(file.algorithms, [Algorithm::Sac]);
        let full = "scenarios = [\"a.toml\", \"mixed\"]\nseeds = \"2..4\"\n\
                    algorithm = [\"ddpg\", \"sac\"]\npreset = \"tuned\"\nkeep_checkpoints = false\n\
                    [mission]\nmse_threshold = [0.01, 0.02]\nnoise_dbm = -85\n\
                    [settings]\ndiscount = [0.9, 0.95]\nepisodes = 4\n\
                    [slurm]\ntime_limit = \"02:00:00\"\noptions = [\"--account=a b\"]\n\
                    [hyperqueue]\ncrash_limit = 2\n";
        let file = SweepFile::parse(full).unwrap();
        assert_eq!(file.seeds, [2, 3, 4]);
        assert_eq!(file.algorithms, [Algorithm::Ddpg, Algorithm::Sac]);
        assert_eq!(file.mission.noise_dbm, [-85.0]);
        let names: Vec<_> = file.settings.iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["discount", "episodes"]);
        assert_eq!(file.hyperqueue.crash_limit, 2);
        assert_eq!(file.slurm.options, ["--account=a b"]);
    }

    #[test]
    fn the_documented_file_is_valid() {
        let page = include_str!("../../../docs/sweeps.md");
        let (_, rest) = page.split_once("```toml\n").unwrap();
        let (text, _) = rest.split_once("```").unwrap();
        let file = SweepFile::parse(text).unwrap();
        assert_eq!((file.seeds.len(), file.settings.len()), (3, 2));
        assert_eq!(file.slurm.running_max, Some(200));
    }

    #[test]
    fn each_error_names_field_value_and_what_is_right() {
        let cases = [
            ("seeds = 1", "scenarios is missing: it must be the name of"),
            (
                "scenarios = \"mixed\"",
                "seeds is missing: it must be a range such as \"1..5\"",
            ),
            (
                "seeds = 1\nscenarios = []",
                "scenarios is [], but must have a value",
            ),
            (
                "seeds = 1\nscenarios = 4",
                "scenarios is 4, but must be the name of a shipped",
            ),
            (
                "seeds = \"4..2\"\nscenarios = \"mixed\"",
                "seeds is \"4..2\", but must be a range",
            ),
            (
                "seeds = [1, -1]\nscenarios = \"mixed\"",
                "seeds is [1, -1], but must be",
            ),
            (
                "seeds = [1, 1]\nscenarios = \"mixed\"",
                "seeds contains 1 twice",
            ),
            (
                "seeds = \"1..1000000\"\nscenarios = \"m\"",
                "at most 100000 runs",
            ),
            ("seed = 1", "scenarios is missing"),
            ("\nseeds = =", "line 2: "),
        ];
        for (text, expected) in cases {
            let error = format!("{:#}", SweepFile::parse(text).unwrap_err());
            assert!(error.contains(expected), "{text}: {error}");
            assert_eq!(error.lines().count(), 1, "{error}");
        }
        let additions = [
            (
                "seed = 1",
                "seed = 1 is unknown; known here: scenarios, seeds, algorithm",
            ),
            (
                "preset = \"best\"",
                "preset is \"best\", but must be paper or tuned",
            ),
            (
                "algorithm = [\"sac\", \"sac\"]",
                "algorithm contains \"sac\" twice",
            ),
            (
                "keep_checkpoints = 1",
                "keep_checkpoints is 1, but must be true or false",
            ),
            (
                "[mission]\nslots = 0",
                "mission.slots is 0, but must be a whole number above 0",
            ),
            (
                "[mission]\ngamma = 0.1",
                "mission.gamma = 0.1 is unknown; known here: mse_thr",
            ),
            (
                "[settings]\ndiscount = []",
                "settings.discount is [], but must have a value",
            ),
            (
                "[slurm]\npartition = \"a b\"",
                "slurm.partition is \"a b\", but must be the name",
            ),
            (
                "[slurm]\noptions = [\"x\"]",
                "slurm.options is \"x\", but must be a list of options",
            ),
            (
                "[slurm]\noptions = [\"--a\\n--b\"]",
                "but must be a list of options",
            ),
            (
                "[hyperqueue]\ncrash_limit = 0",
                "hyperqueue.crash_limit is 0, but must be a whole",
            ),
            ("slurm = 4", "slurm is 4, but must be a table, [slurm]"),
        ];
        for (text, expected) in additions {
            let text = format!("{LEAST}{text}");
            let error = format!("{:#}", SweepFile::parse(&text).unwrap_err());
            assert!(error.contains(expected), "{text}: {error}");
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }
}
