//! `trainer sweep`: the runs of a sweep on this machine, by HyperQueue or by Slurm.

use std::{
    fs,
    io::{self, IsTerminal},
    num::NonZeroUsize,
    path::{Path, PathBuf},
    process::{Command, ExitStatus},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use anyhow::{Context, anyhow, ensure};
use clap::{Args, ValueEnum};
use files::output;
use trainer::sweep::{
    hyperqueue::{self, LOGS},
    local,
    plan::{Sweep, SweepRun},
    record::{RunRecord, RunState},
    slurm::{SlurmScript, quoted},
    task::{self, StopFlag, TaskOutcome, WhenTaken},
};

use super::outcome::{Failure, Outcome};

/// Train the product of scenarios, settings and seeds that a file lists, here or on a cluster
///
/// Finished runs are skipped and stopped ones are resumed, so the same command continues a sweep. Each
/// run has a directory DIR/NAME with the files of `trainer train`; `trainer compare DIR` prints the
/// table of all. Exit code 1: a run failed or is not finished; 2: bad usage or a wrong file.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLE)]
pub(crate) struct RunSweep {
    /// The file that describes the sweep
    file: PathBuf,
    /// Directory of the runs [default: STEM-runs beside the file STEM.toml]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Where the runs are executed
    #[arg(long, value_enum, default_value = "local")]
    engine: Engine,
    /// Number of runs at the same time, with --engine local [default: number of cores]
    #[arg(long, value_name = "N", conflicts_with_all = ["task", "status", "dry_run"])]
    jobs: Option<NonZeroUsize>,
    /// The program `hq`, with --engine hyperqueue
    #[arg(long, value_name = "PROGRAM", default_value = "hq")]
    hq: PathBuf,
    /// Submit the script by `sbatch` as well, with --engine slurm
    #[arg(long)]
    submit: bool,
    /// Execute only run number K, or the one whose number is in the environment variable K: what
    /// array jobs call. If another process executes it, wait for that
    #[arg(long, value_name = "K", conflicts_with_all = ["engine", "submit", "status", "dry_run"])]
    task: Option<String>,
    /// Checksum of the planned runs: fail if the file has been changed since an array job was
    /// submitted, because numbers then mean other runs
    #[arg(long, value_name = "CHECKSUM", requires = "task")]
    plan: Option<String>,
    /// Print how many runs are finished, stopped and not begun, and the names of those that are not
    /// finished
    #[arg(long, conflicts_with = "dry_run")]
    status: bool,
    /// Print number, state and directory of each run, and execute none
    #[arg(long)]
    dry_run: bool,
}

/// Where the runs are executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Engine {
    /// On the cores of this machine
    Local,
    /// As one job array of HyperQueue, by a running server
    Hyperqueue,
    /// As an array script for Slurm, which is written to OUT/slurm.sh
    Slurm,
}

/// A file for the help; docs/sweeps.md has all fields.
const EXAMPLE: &str = "\
A file with 2 x 2 x 3 = 12 runs (docs/sweeps.md describes all fields):

    scenarios = [\"separated\", \"mixed\"]
    seeds = \"1..3\"
    preset = \"tuned\"
    [settings]
    learning_rate = [1e-3, 3e-4]
    [slurm]
    time_limit = \"02:00:00\"";
/// At most this many runs are listed at the end.
const LISTED_MAX: usize = 20;

impl RunSweep {
    pub(crate) fn execute(self) -> Outcome {
        self.check_options().map_err(Failure::BadInput)?;
        let sweep = Sweep::load(&self.file, self.out.as_deref()).map_err(Failure::BadInput)?;
        if self.dry_run {
            return dry_run(&sweep);
        }
        if self.status {
            print_status(&sweep);
            return Ok(());
        }
        if let Some(task) = &self.task {
            return self.execute_task(&sweep, task);
        }
        let unfinished = unfinished(&sweep);
        if unfinished.is_empty() {
            let (count, out) = (sweep.runs.len(), sweep.out.display());
            println!("nothing to do: all {count} runs are finished in {out}");
            return Ok(());
        }
        fs::create_dir_all(&sweep.out)
            .with_context(|| sweep.out.display().to_string())
            .map_err(Failure::Failed)?;
        match self.engine {
            Engine::Local => self.execute_here(&sweep),
            Engine::Hyperqueue => self.submit_to_hyperqueue(&sweep, &unfinished),
            Engine::Slurm => self.write_for_slurm(&sweep, &unfinished),
        }
    }

    /// Checks that no option is for another engine.
    fn check_options(&self) -> anyhow::Result<()> {
        ensure!(
            self.jobs.is_none() || self.engine == Engine::Local,
            "--jobs is for --engine local: another engine decides that itself"
        );
        ensure!(
            !self.submit || self.engine == Engine::Slurm,
            "--submit is for --engine slurm"
        );
        Ok(())
    }

    fn execute_task(&self, sweep: &Sweep, task: &str) -> Outcome {
        let prepare = || -> anyhow::Result<_> {
            let number = task_number(task)?;
            if let Some(expected) = &self.plan {
                let checksum = sweep.checksum();
                ensure!(
                    checksum == *expected,
                    "{}: the runs have the checksum {checksum}, and had {expected} when the job was \
                     submitted: submit it again",
                    sweep.file.display()
                );
            }
            sweep.run(number)
        };
        let run = prepare().map_err(Failure::BadInput)?;
        let outcome = task::execute(sweep, run, WhenTaken::Wait, &stop_flag());
        let outcome = outcome
            .with_context(|| run.name.clone())
            .map_err(Failure::Failed)?;
        println!("{}: {}", run.name, description(&outcome));
        match outcome {
            TaskOutcome::Finished(_) | TaskOutcome::AlreadyFinished(_) => Ok(()),
            TaskOutcome::Taken | TaskOutcome::Interrupted => Err(Failure::Failed(anyhow!(
                "{}: not finished; the same command continues it",
                run.name
            ))),
        }
    }

    fn execute_here(&self, sweep: &Sweep) -> Outcome {
        let jobs = match self.jobs {
            Some(jobs) => jobs.get(),
            None => thread::available_parallelism().map_or(1, NonZeroUsize::get),
        };
        let stop = stop_flag();
        let (done, count) = (AtomicUsize::new(0), sweep.runs.len());
        let failed = Mutex::new(Vec::new());
        local::execute_all(sweep, jobs, &stop, |run, outcome| match outcome {
            Ok(TaskOutcome::Interrupted) => {}
            Ok(outcome) => {
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                // Finished runs of an earlier command would fill the screen.
                if !matches!(outcome, TaskOutcome::AlreadyFinished(_)) {
                    println!("[{done}/{count}] {}: {}", run.name, description(&outcome));
                }
            }
            Err(error) => {
                eprintln!("{}: {error:#}", run.name);
                let mut failed = failed.lock().unwrap_or_else(PoisonError::into_inner);
                failed.push(run.number);
            }
        });
        if stop.load(Ordering::Relaxed) {
            let done = done.into_inner();
            return Err(Failure::Failed(anyhow!(
                "interrupted: {done} of {count} runs are finished; the same command continues"
            )));
        }
        let mut failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
        failed.sort_unstable();
        conclude(sweep, &failed)
    }

    fn submit_to_hyperqueue(&self, sweep: &Sweep, numbers: &[usize]) -> Outcome {
        let submit = || -> anyhow::Result<ExitStatus> {
            create_logs(sweep)?;
            let terminal = io::stderr().is_terminal();
            let arguments = hyperqueue::submission(sweep, numbers, &this_program()?, terminal);
            let status = Command::new(&self.hq).args(arguments).status();
            status.with_context(|| {
                format!(
                    "{} cannot be started: install HyperQueue, or name its program by --hq",
                    self.hq.display()
                )
            })
        };
        let status = submit().map_err(Failure::BadInput)?;
        // The files are what counts: hq also ends with 0 if tasks failed.
        let unfinished = unfinished(sweep);
        if !status.success() && !unfinished.is_empty() {
            let hq = self.hq.display();
            return Err(Failure::Failed(anyhow!(
                "{hq} submit ended with {status}; {} of {} runs are not finished",
                unfinished.len(),
                sweep.runs.len()
            )));
        }
        conclude(sweep, &unfinished)
    }

    fn write_for_slurm(&self, sweep: &Sweep, numbers: &[usize]) -> Outcome {
        let path = SlurmScript::path(sweep);
        let prepare = || -> anyhow::Result<SlurmScript> {
            create_logs(sweep)?;
            let script = SlurmScript::of(sweep, numbers, &this_program()?)?;
            output::write(&path, script.text.as_bytes())
                .with_context(|| path.display().to_string())?;
            Ok(script)
        };
        let script = prepare().map_err(Failure::BadInput)?;
        println!(
            "{}: {} runs in {} array tasks, at most {} runs each",
            path.display(),
            numbers.len(),
            script.tasks,
            script.runs_per_task
        );
        if !self.submit {
            let path = quoted(&path).map_err(Failure::BadInput)?;
            println!("submit it by: sbatch {path}");
            return Ok(());
        }
        let status = Command::new("sbatch").arg(&path).status();
        let status = status
            .context("sbatch cannot be started: is this a login node of a cluster with Slurm?")
            .map_err(Failure::BadInput)?;
        match status.success() {
            true => Ok(()),
            false => Err(Failure::Failed(anyhow!("sbatch ended with {status}"))),
        }
    }
}

/// Returns a flag that is set by Ctrl-C, SIGTERM or SIGHUP. A second signal ends the process at once.
fn stop_flag() -> StopFlag {
    let flag = StopFlag::default();
    let inner = StopFlag::clone(&flag);
    let handler = move || {
        if inner.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("stopping after the current episodes, with checkpoints; once more: at once");
    };
    // Without a handler the process ends at the signal, and the last checkpoints are continued.
    let _ = ctrlc::set_handler(handler);
    flag
}

/// Reads the number of a run, from an environment variable if it is not a number itself.
fn task_number(task: &str) -> anyhow::Result<usize> {
    let expected = "a number of a run, or the name of an environment variable that contains one";
    if let Ok(number) = task.parse() {
        return Ok(number);
    }
    let value = std::env::var(task)
        .map_err(|_| anyhow!("--task is {task:?}, but must be {expected}; it is not set"))?;
    let number = value.parse();
    number.map_err(|_| anyhow!("--task: {task} is {value:?}, but must be the number of a run"))
}

fn this_program() -> anyhow::Result<PathBuf> {
    std::env::current_exe().context("the path of this program is not known")
}

fn create_logs(sweep: &Sweep) -> anyhow::Result<()> {
    let logs = sweep.out.join(LOGS);
    fs::create_dir_all(&logs).with_context(|| logs.display().to_string())
}

fn state(sweep: &Sweep, run: &SweepRun) -> RunState {
    RunState::of(&sweep.directory(run))
}

/// Returns the numbers of the runs that are not finished.
fn unfinished(sweep: &Sweep) -> Vec<usize> {
    let runs = sweep.runs.iter();
    let runs = runs.filter(|run| state(sweep, run) != RunState::Finished);
    runs.map(|run| run.number).collect()
}

fn description(outcome: &TaskOutcome) -> String {
    let result = |record: &RunRecord| match record.best {
        Some(best) => format!("{:.3} bit/s/Hz (episode {})", best.sum_rate, best.episode),
        None => "no policy kept every constraint when it was evaluated".to_owned(),
    };
    match outcome {
        TaskOutcome::AlreadyFinished(record) => format!("finished before, {}", result(record)),
        TaskOutcome::Finished(record) => result(record),
        TaskOutcome::Taken => "executed by another process".to_owned(),
        TaskOutcome::Interrupted => "interrupted".to_owned(),
    }
}

/// Prints the end of a sweep; the error names the runs that are not finished.
fn conclude(sweep: &Sweep, unfinished: &[usize]) -> Outcome {
    let count = sweep.runs.len();
    if unfinished.is_empty() {
        println!("all {count} runs are finished in {}", sweep.out.display());
        return Ok(());
    }
    let runs = unfinished
        .iter()
        .filter_map(|number| sweep.run(*number).ok());
    let listed = runs.take(LISTED_MAX);
    let mut names: Vec<String> = listed
        .map(|run| format!("{} ({})", run.name, state(sweep, run).name()))
        .collect();
    if unfinished.len() > LISTED_MAX {
        names.push("..".to_owned());
    }
    Err(Failure::Failed(anyhow!(
        "{} of {count} runs are not finished: {}",
        unfinished.len(),
        names.join(", ")
    )))
}

fn print_status(sweep: &Sweep) {
    let states: Vec<RunState> = sweep.runs.iter().map(|run| state(sweep, run)).collect();
    let all = [
        RunState::Finished,
        RunState::Running,
        RunState::Stopped,
        RunState::Diverged,
        RunState::NotBegun,
    ];
    let counts = all.map(|kind| {
        let count = states.iter().filter(|state| **state == kind).count();
        format!("{count} {}", kind.name())
    });
    println!("{} runs: {}", states.len(), counts.join(", "));
    for (run, state) in sweep.runs.iter().zip(&states) {
        if ![RunState::Finished, RunState::NotBegun].contains(state) {
            println!("{} {} ({})", run.number, run.name, state.name());
        }
    }
}

fn dry_run(sweep: &Sweep) -> Outcome {
    for run in &sweep.runs {
        println!("{} {} ({})", run.number, run.name, state(sweep, run).name());
    }
    let out: &Path = &sweep.out;
    println!("{} runs in {}", sweep.runs.len(), out.display());
    Ok(())
}
