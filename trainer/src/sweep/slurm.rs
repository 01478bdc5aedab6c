//! A sweep as an array script for Slurm's `sbatch`.
//!
//! Clusters limit the number of array tasks (`MaxArraySize`, usually 1,001), and starting a job takes
//! seconds, so an array task executes several runs one after the other.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use anyhow::Context;

use super::{array::ranges, hyperqueue::LOGS, plan::Sweep};

/// The largest number of array tasks, unless the file sets `runs_per_task`: Slurm's default for
/// `MaxArraySize` is 1,001, and indices are below it.
const TASKS_MAX: usize = 1_000;

/// A script and what it submits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlurmScript {
    /// Its text.
    pub text: String,
    /// Number of array tasks.
    pub tasks: usize,
    /// The largest number of runs that one of them executes.
    pub runs_per_task: usize,
}

impl SlurmScript {
    /// Returns the path of the script of a sweep.
    pub fn path(sweep: &Sweep) -> PathBuf {
        sweep.out.join("slurm.sh")
    }

    /// Writes a script that executes these runs; array tasks without any of them are left out.
    /// `trainer` is the absolute path of this program on the cluster.
    ///
    /// # Errors
    /// Fails if a path is not UTF-8.
    pub fn of(sweep: &Sweep, numbers: &[usize], trainer: &Path) -> anyhow::Result<Self> {
        let count = sweep.runs.len();
        let runs_per_task = match sweep.slurm.runs_per_task {
            Some(runs) => runs as usize,
            None => count.div_ceil(TASKS_MAX),
        };
        let mut indices: Vec<usize> = (numbers.iter())
            .map(|number| (number - 1) / runs_per_task)
            .collect();
        indices.dedup();
        let mut array = ranges(&indices);
        if let Some(running) = sweep.slurm.running_max {
            // Writing to a string cannot fail.
            let _ = write!(array, "%{running}");
        }
        let directives = [
            Some(format!("--job-name=sweep-{}", word(&sweep.name()))),
            Some(format!("--array={array}")),
            Some("--ntasks=1".to_owned()),
            Some("--cpus-per-task=1".to_owned()),
            // Paths of directives have other rules for quotes than bash: the script opens its log.
            Some("--output=/dev/null".to_owned()),
            (sweep.slurm.time_limit.as_ref()).map(|time| format!("--time={time}")),
            (sweep.slurm.partition.as_ref()).map(|name| format!("--partition={name}")),
            (sweep.slurm.memory.as_ref()).map(|memory| format!("--mem={memory}")),
        ];
        let mut text = String::from("#!/bin/bash\n");
        let further = sweep.slurm.options.iter().cloned();
        for directive in directives.into_iter().flatten().chain(further) {
            let _ = writeln!(text, "#SBATCH {directive}");
        }
        let logs = sweep.out.join(LOGS);
        let _ = write!(
            text,
            r#"# Written by `trainer sweep --engine slurm`. Runs that are finished are skipped, and runs that
# were stopped are resumed, so this script may be submitted again at any time.
set -u
trainer={trainer}
file={file}
out={out}
logs={logs}
exec >>"$logs/slurm-${{SLURM_ARRAY_JOB_ID:-0}}_$SLURM_ARRAY_TASK_ID.log" 2>&1
# The run that is being executed writes its checkpoint; the following ones do not begin.
trap 'exit 143' TERM
first=$((SLURM_ARRAY_TASK_ID * {runs_per_task} + 1))
last=$((first + {runs_per_task} - 1))
if [ "$last" -gt {count} ]; then
  last={count}
fi
failed=0
for ((run = first; run <= last; run++)); do
  "$trainer" sweep "$file" --out "$out" --plan {checksum} --task "$run" || failed=1
done
exit "$failed"
"#,
            trainer = quoted(trainer)?,
            file = quoted(&sweep.file)?,
            out = quoted(&sweep.out)?,
            logs = quoted(&logs)?,
            checksum = sweep.checksum(),
        );
        Ok(Self {
            text,
            tasks: indices.len(),
            runs_per_task,
        })
    }
}

/// Returns a path in single quotes, as bash reads it back.
pub fn quoted(path: &Path) -> anyhow::Result<String> {
    let text = path.to_str();
    let text = text.with_context(|| format!("{} is not UTF-8", path.display()))?;
    Ok(format!("'{}'", text.replace('\'', r"'\''")))
}

/// Returns a text without characters that need quotes.
fn word(text: &str) -> String {
    let plain = |letter: char| match letter.is_ascii_alphanumeric() || "._-".contains(letter) {
        true => letter,
        false => '_',
    };
    text.chars().map(plain).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn script(text: &str, numbers: &[usize]) -> SlurmScript {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("my sweep.toml");
        fs::write(&file, text).unwrap();
        let sweep = Sweep::load(&file, None).unwrap();
        SlurmScript::of(&sweep, numbers, Path::new("/opt/it's/trainer")).unwrap()
    }

    #[test]
    fn directives_come_first_and_only_tasks_with_work_are_submitted() {
        let text = "scenarios = \"mixed\"\nseeds = \"1..10\"\n[slurm]\ntime_limit = \"01:00:00\"\n\
                    partition = \"short\"\nmemory = \"500M\"\nruns_per_task = 3\nrunning_max = 2\n\
                    options = [\"--account=a\"]\n";
        let script = script(text, &[1, 2, 7, 10]);
        let lines: Vec<&str> = script.text.lines().collect();
        assert_eq!(
            lines[..10],
            [
                "#!/bin/bash",
                "#SBATCH --job-name=sweep-my_sweep",
                "#SBATCH --array=0,2-3%2",
                "#SBATCH --ntasks=1",
                "#SBATCH --cpus-per-task=1",
                "#SBATCH --output=/dev/null",
                "#SBATCH --time=01:00:00",
                "#SBATCH --partition=short",
                "#SBATCH --mem=500M",
                "#SBATCH --account=a",
            ]
        );
        assert!(script.text.contains(r"trainer='/opt/it'\''s/trainer'"));
        assert_eq!((script.tasks, script.runs_per_task), (3, 3));
    }

    #[test]
    fn ten_thousand_runs_fit_into_an_array_of_the_usual_size() {
        let numbers: Vec<usize> = (1..=10_000).collect();
        let script = script("scenarios = \"mixed\"\nseeds = \"1..10000\"\n", &numbers);
        assert!(script.text.contains("#SBATCH --array=0-999\n"));
        assert_eq!((script.tasks, script.runs_per_task), (1_000, 10));
    }
}
