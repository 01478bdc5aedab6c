//! The runs of a sweep: the product of what its file lists, with a name, a scenario and settings for
//! each. All of it is decided, and every error of the file found, before a run is started.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf, absolute},
    sync::Arc,
};

use anyhow::{Context, Error, bail, ensure};
use crc::{CRC_32_ISO_HDLC, Crc};
use scenario::Scenario;

use crate::settings::TrainingSettings;

use super::{
    choices::{all_settings, changes, mission_name},
    file::{HyperqueueOptions, RUNS_MAX, SlurmOptions, SweepFile},
};

/// A sweep: its runs and where they are.
#[derive(Debug)]
pub struct Sweep {
    /// The absolute path of its file.
    pub file: PathBuf,
    /// The absolute path of the directory that contains the directories of the runs.
    pub out: PathBuf,
    /// The runs; number K is at index K - 1.
    pub runs: Vec<SweepRun>,
    /// Whether finished runs keep their checkpoints.
    pub keep_checkpoints: bool,
    /// Options of the HyperQueue job.
    pub hyperqueue: HyperqueueOptions,
    /// Options of the Slurm job.
    pub slurm: SlurmOptions,
}

/// One run of a sweep.
#[derive(Clone, Debug)]
pub struct SweepRun {
    /// The number, from 1.
    pub number: usize,
    /// The name of its directory.
    pub name: String,
    /// The scenario.
    pub scenario: Arc<Scenario>,
    /// The settings, with the seed.
    pub settings: TrainingSettings,
}

/// The longest name of a directory, bytes. File systems allow 255.
const NAME_MAX: usize = 200;
const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

impl Sweep {
    /// Reads a sweep's file and plans its runs. Without `out`, the directory is `STEM-runs` beside the
    /// file.
    ///
    /// # Errors
    /// Names the file and what is wrong with it, with a scenario, or with the settings of a run.
    pub fn load(path: &Path, out: Option<&Path>) -> anyhow::Result<Self> {
        let content = SweepFile::load(path)?;
        let file = absolute(path).with_context(|| path.display().to_string())?;
        let folder = file.parent().unwrap_or(Path::new("/"));
        let out = match out {
            Some(out) => absolute(out).with_context(|| out.display().to_string())?,
            None => {
                let stem = file.file_stem().unwrap_or_default().to_string_lossy();
                folder.join(format!("{stem}-runs"))
            }
        };
        let runs = runs(&content, folder).with_context(|| path.display().to_string())?;
        Ok(Self {
            file,
            out,
            runs,
            keep_checkpoints: content.keep_checkpoints,
            hyperqueue: content.hyperqueue,
            slurm: content.slurm,
        })
    }

    /// Returns run number `number`.
    ///
    /// # Errors
    /// States which numbers there are.
    pub fn run(&self, number: usize) -> anyhow::Result<&SweepRun> {
        let run = number.checked_sub(1).and_then(|index| self.runs.get(index));
        run.with_context(|| {
            let (file, count) = (self.file.display(), self.runs.len());
            format!("{file}: run {number} does not exist: the runs are 1 to {count}")
        })
    }

    /// Returns the directory of a run.
    pub fn directory(&self, run: &SweepRun) -> PathBuf {
        self.out.join(&run.name)
    }

    /// Returns the stem of the file's name.
    pub fn name(&self) -> String {
        let stem = self.file.file_stem().unwrap_or_default();
        stem.to_string_lossy().into_owned()
    }

    /// Returns a checksum of the names and scenarios of all runs in their order. A queued job carries
    /// it, because its numbers mean other runs once the file is changed.
    pub fn checksum(&self) -> String {
        let mut digest = CHECKSUM.digest();
        for run in &self.runs {
            digest.update(run.name.as_bytes());
            digest.update(run.scenario.digest().as_bytes());
        }
        format!("{:08x}", digest.finalize())
    }
}

fn runs(file: &SweepFile, folder: &Path) -> anyhow::Result<Vec<SweepRun>> {
    let mut sources: BTreeMap<String, &Path> = BTreeMap::new();
    let mut groups = Vec::new();
    for path in &file.scenarios {
        let scenario = load(path, folder)?;
        if let Some(other) = sources.insert(scenario.name.clone(), path) {
            bail!(
                "scenarios: {} and {} have the same name, {}, which names their runs: rename one",
                other.display(),
                path.display(),
                scenario.name
            );
        }
        for changes in changes(&file.mission) {
            let changed = scenario.changed(&changes);
            let changed = changed.map_err(|problem| {
                let mission = mission_name(&changes).replacen('-', "", 1);
                anyhow::anyhow!("mission: {} with {mission}: {problem}", path.display())
            })?;
            groups.push((Arc::new(changed), changes));
        }
    }
    let settings = all_settings(file)?;
    let count = groups.len() as u64 * settings.len() as u64 * file.seeds.len() as u64;
    ensure!(
        count <= RUNS_MAX,
        "the product has {count} runs, but a sweep has at most {RUNS_MAX}"
    );
    let mut runs = Vec::new();
    let mut names = BTreeMap::new();
    for (scenario, changes) in &groups {
        for (settings, words) in &settings {
            let allowed = settings.inner.check(&scenario.mission);
            allowed.map_err(|problem| anyhow::anyhow!("{}: {problem}", scenario.name))?;
            for &seed in &file.seeds {
                let mission = mission_name(changes);
                let name = name(&format!("{}{mission}{words}-s{seed}", scenario.name));
                let number = runs.len() + 1;
                if let Some(other) = names.insert(name.clone(), number) {
                    bail!("runs {other} and {number} would both be named {name}");
                }
                runs.push(SweepRun {
                    number,
                    name,
                    scenario: Arc::clone(scenario),
                    settings: TrainingSettings {
                        seed,
                        ..settings.clone()
                    },
                });
            }
        }
    }
    Ok(runs)
}

/// Loads a shipped scenario, or a file whose path is relative to the sweep's file.
fn load(path: &Path, folder: &Path) -> anyhow::Result<Scenario> {
    let shipped = path.to_str().and_then(Scenario::shipped);
    match shipped {
        Some(shipped) => Ok(shipped),
        None => Scenario::named(&folder.join(path))
            .map_err(Error::msg)
            .context("scenarios"),
    }
}

/// Returns a name for a directory that needs no quoting. A long one is cut, and ends with a checksum.
fn name(words: &str) -> String {
    let plain = |letter: char| match letter {
        'a'..='z' | 'A'..='Z' | '0'..='9' | '.' | '_' | '-' | '=' => letter,
        _ => '_',
    };
    let name: String = words.chars().map(plain).collect();
    // A name that starts with a point would be hidden, and one with a dash would be an option.
    let name = match name.starts_with(['.', '-']) {
        true => format!("_{name}"),
        false => name,
    };
    match name.get(..NAME_MAX - 9) {
        Some(start) if name.len() > NAME_MAX => {
            format!("{start}-{:08x}", CHECKSUM.checksum(words.as_bytes()))
        }
        _ => name,
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeSet, fs};

    use super::*;
    use crate::settings::Algorithm;

    fn sweep(text: &str) -> anyhow::Result<Sweep> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rates.toml");
        fs::write(&file, text).unwrap();
        Sweep::load(&file, None)
    }

    #[test]
    fn runs_are_the_product_with_seeds_innermost() {
        let sweep = sweep(
            "scenarios = [\"separated\", \"mixed\"]\nseeds = \"1..2\"\nalgorithm = [\"sac\", \"ddpg\"]\n\
             [mission]\nmse_threshold = [0.015, 0.02]\n\
             [settings]\nlearning_rate = [1e-3, 3e-4]\nhidden = 32\n",
        )
        .unwrap();
        assert_eq!(sweep.runs.len(), 2 * 2 * 2 * 2 * 2);
        let names: Vec<&str> = sweep.runs.iter().map(|run| run.name.as_str()).collect();
        assert_eq!(
            names[..3],
            [
                "separated-mse_threshold=0.015-sac-paper-hidden=32-learning_rate=0.001-s1",
                "separated-mse_threshold=0.015-sac-paper-hidden=32-learning_rate=0.001-s2",
                "separated-mse_threshold=0.015-sac-paper-hidden=32-learning_rate=0.0003-s1",
            ]
        );
        assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len());
        let last = sweep.run(32).unwrap();
        assert_eq!((last.number, last.settings.seed), (32, 2));
        assert_eq!(last.settings.algorithm, Algorithm::Ddpg);
        assert_eq!((last.settings.hidden, last.settings.batch), (32, 64));
        assert_eq!(last.settings.critic_learning_rate, 3e-4);
        assert_eq!(last.settings.temperature_learning_rate, 3e-4);
        let mission = &last.scenario.mission;
        assert_eq!(mission.parameters().mse_threshold, 0.02);
        assert!(sweep.out.ends_with("rates-runs"), "{:?}", sweep.out);
        let problem = sweep.run(33).unwrap_err().to_string();
        assert!(problem.ends_with("run 33 does not exist: the runs are 1 to 32"));
        assert!(sweep.run(0).is_err());
    }

    /// A run keeps its name when the file gets further values, and the numbers then change, which the
    /// checksum shows.
    #[test]
    fn names_do_not_depend_on_the_other_runs() {
        let text = |seeds: &str, rates: &str| {
            format!("scenarios = \"mixed\"\nseeds = {seeds}\n[settings]\ndiscount = {rates}\n")
        };
        let few = sweep(&text("[2]", "0.9")).unwrap();
        let many = sweep(&text("[1, 2]", "[0.8, 0.9]")).unwrap();
        assert_eq!(few.runs[0].name, "mixed-sac-paper-discount=0.9-s2");
        assert_eq!(many.runs[3].name, few.runs[0].name);
        assert_ne!(many.checksum(), few.checksum());
        assert_eq!(many.checksum().len(), 8);
    }

    #[test]
    fn names_need_no_quoting_and_are_not_too_long() {
        assert_eq!(name("a b/c:0.1"), "a_b_c_0.1");
        assert_eq!(name("-x"), "_-x");
        let (one, two) = (name(&"x".repeat(300)), name(&"x".repeat(301)));
        assert_eq!((one.len(), two.len()), (NAME_MAX, NAME_MAX));
        assert_ne!(one, two);
    }

    #[test]
    fn errors_name_the_file_and_what_is_wrong() {
        let start = "scenarios = \"mixed\"\nseeds = 1\n";
        let cases = [
            (
                "[settings]\ndiscout = 0.9",
                "settings.discout is unknown; known here: learning_rate, ",
            ),
            (
                "[settings]\nseed = 2",
                "settings.seed: it is not in [settings]",
            ),
            (
                "[settings]\ndiscount = \"high\"",
                "settings.discount is \"high\": invalid type",
            ),
            (
                "[settings]\ndiscount = 1.5",
                "discount is 1.5, but must be a number from 0 to 1",
            ),
            (
                "[settings]\ndiscount = [0.9, 0.90]",
                "settings.discount contains 0.9 twice",
            ),
            (
                "[settings]\nlearning_rate = 0.1\ncritic_learning_rate = 0.1",
                "settings.critic_learning_rate sets one",
            ),
            (
                "[mission]\nmse_threshold = -1",
                "mission: mixed with mse_threshold=-1: ",
            ),
            (
                "[settings]\ninner = [\"exact\", \"best\"]",
                "settings.inner is \"best\": ",
            ),
        ];
        for (text, expected) in cases {
            let error = format!("{:#}", sweep(&format!("{start}{text}\n")).unwrap_err());
            assert!(
                error.contains("rates.toml: ") && error.contains(expected),
                "{error}"
            );
            assert_eq!(error.lines().count(), 1, "{error}");
        }
        let error = format!(
            "{:#}",
            sweep("scenarios = \"mixd\"\nseeds = 1").unwrap_err()
        );
        assert!(
            error.contains("scenarios: ") && error.contains("mixd"),
            "{error}"
        );
    }

    #[test]
    fn scenarios_of_one_name_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mixed = Scenario::shipped("mixed").unwrap().to_toml();
        for name in ["a", "b"] {
            fs::create_dir(folder.path().join(name)).unwrap();
            fs::write(folder.path().join(name).join("x.toml"), &mixed).unwrap();
        }
        let file = folder.path().join("sweep.toml");
        fs::write(
            &file,
            "scenarios = [\"a/x.toml\", \"b/x.toml\"]\nseeds = 1\n",
        )
        .unwrap();
        let error = format!("{:#}", Sweep::load(&file, None).unwrap_err());
        assert!(
            error.contains("a/x.toml and b/x.toml have the same name, x"),
            "{error}"
        );
    }
}
