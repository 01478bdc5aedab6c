//! Sweeps through the command line: they write the same bytes as single runs, are continued after a
//! kill, and their array scripts execute every run.

use std::{
    fs,
    io::Read,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use assert_cmd::cargo::cargo_bin;
use tempfile::TempDir;

/// Settings of a small run, in which learning starts in the third episode.
const SETTINGS: &str = "hidden = 32\nbatch = 16\nwarmup_slots = 120\nevaluate_every = 4\n\
                        checkpoint_every = 2\nbuffer_capacity = 1000\n";

/// A folder whose name has a space and a quote, with a sweep in it.
struct Folder {
    temporary: TempDir,
}

impl Folder {
    fn new(sweep: &str) -> Self {
        let folder = Self {
            temporary: tempfile::tempdir().expect("temporary"),
        };
        fs::create_dir(folder.path()).expect("writable");
        fs::write(folder.file(), sweep).expect("writable");
        folder
    }

    fn path(&self) -> PathBuf {
        self.temporary.path().join("it's a folder")
    }

    fn file(&self) -> PathBuf {
        self.path().join("small sweep.toml")
    }

    fn out(&self) -> PathBuf {
        self.path().join("small sweep-runs")
    }

    fn sweep(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(cargo_bin("trainer"));
        command.arg("sweep").arg(self.file()).args(arguments);
        command
    }
}

fn sweep_of(start: &str, settings: &str) -> String {
    format!("{start}[settings]\n{SETTINGS}{settings}")
}

/// A process that is killed when the test ends, however it ends.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn output(command: &mut Command) -> Output {
    command.output().expect("starts")
}

fn succeed(command: &mut Command) -> String {
    let output = output(command);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Returns the one line that a command prints as its error, and its exit code.
fn fail(command: &mut Command) -> (i32, String) {
    let output = output(command);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code().expect("not killed"), errors)
}

/// Reads the files that must be equal between two equal runs.
fn results(directory: &Path) -> [Vec<u8>; 3] {
    ["policy.onnx", "metrics.csv", "checkpoint.bin"]
        .map(|name| fs::read(directory.join(name)).unwrap_or_else(|_| panic!("{directory:?}")))
}

/// The directory of the only run whose name has this end.
fn run_of(folder: &Path, end: &str) -> PathBuf {
    let entries = fs::read_dir(folder).expect("a folder");
    let mut paths = entries.map(|entry| entry.expect("readable").path());
    let found = paths.find(|path| path.to_string_lossy().ends_with(end));
    found.unwrap_or_else(|| panic!("no run {end} in {folder:?}"))
}

#[test]
fn runs_are_those_of_train_and_the_second_time_there_is_nothing_to_do() {
    let start =
        "scenarios = [\"separated\", \"mixed\"]\nalgorithm = [\"sac\", \"ddpg\"]\nseeds = [5]\n";
    let folder = Folder::new(&sweep_of(start, "episodes = 8\n"));
    let listed = succeed(&mut folder.sweep(&["--dry-run"]));
    assert!(listed.starts_with("1 separated-sac-paper-"), "{listed}");
    assert!(
        listed.contains("-s5 (not begun)\n4 mixed-ddpg-") || listed.contains("4 runs in "),
        "{listed}"
    );
    assert!(!folder.out().exists());

    let printed = succeed(&mut folder.sweep(&["--jobs", "2"]));
    assert!(printed.contains("[4/4] ") && printed.contains("all 4 runs are finished in "));
    let settings = folder.path().join("settings.toml");
    fs::write(&settings, SETTINGS).expect("writable");
    for (scenario, algorithm) in [("separated", "sac"), ("mixed", "ddpg")] {
        let alone = folder.path().join(format!("{scenario}-{algorithm}"));
        let mut train = Command::new(cargo_bin("trainer"));
        train.args(["train", "--quiet", "--episodes", "8", "--seed", "5"]);
        train.args(["--scenario", scenario, "--algorithm", algorithm]);
        train
            .arg("--settings")
            .arg(&settings)
            .arg("--out")
            .arg(&alone);
        succeed(&mut train);
        let runs = fs::read_dir(folder.out()).expect("written");
        let start = format!("{scenario}-{algorithm}-paper-");
        let mut names = runs.map(|run| run.expect("readable").file_name());
        let name = names.find(|name| name.to_string_lossy().starts_with(&start));
        assert!(results(&folder.out().join(name.expect("written"))) == results(&alone));
    }

    let again = succeed(&mut folder.sweep(&[]));
    assert!(
        again.starts_with("nothing to do: all 4 runs are finished in "),
        "{again}"
    );
    assert_eq!(again.lines().count(), 1, "{again}");
    let status = succeed(&mut folder.sweep(&["--status"]));
    assert!(
        status.starts_with("4 runs: 4 finished, 0 running, 0 stopped"),
        "{status}"
    );
    let task = succeed(&mut folder.sweep(&["--task", "4"]));
    assert!(task.contains("-s5: finished before, "), "{task}");

    let mut compare = Command::new(cargo_bin("trainer"));
    let table = succeed(compare.arg("compare").arg(folder.out()));
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(lines.len(), 2 + 2 * (2 + 3), "{table}");
    assert!(lines[2].starts_with("| mixed 0.015 | "), "{table}");
    assert!(
        lines[4].starts_with("| mixed 0.015 | fair straight line | | "),
        "{table}"
    );
}

/// A sweep that is killed half-way and started again ends with the bytes of an undisturbed one.
#[test]
fn a_killed_sweep_is_continued_bit_for_bit() {
    let text = sweep_of(
        "scenarios = \"separated\"\nseeds = \"1..3\"\n",
        "episodes = 100\n",
    );
    let (whole, killed) = (Folder::new(&text), Folder::new(&text));
    succeed(&mut whole.sweep(&["--jobs", "1"]));

    let mut command = killed.sweep(&["--jobs", "1"]);
    let mut child = Running(command.stdout(Stdio::null()).spawn().expect("starts"));
    // The second run has begun and has a checkpoint after its start.
    let end = Instant::now() + Duration::from_secs(120);
    let metrics = || {
        let entries = fs::read_dir(killed.out()).ok()?;
        let run = entries
            .flatten()
            .find(|run| run.path().to_string_lossy().ends_with("-s2"))?;
        fs::read_to_string(run.path().join("metrics.csv")).ok()
    };
    while metrics().is_none_or(|text| text.lines().count() < 8) {
        assert!(Instant::now() < end, "it does not get there");
        thread::sleep(Duration::from_millis(1));
    }
    child.0.kill().expect("killed");
    child.0.wait().expect("ended");
    let status = succeed(&mut killed.sweep(&["--status"]));
    assert!(
        status.starts_with("3 runs: 1 finished, 0 running, 1 stopped, 0 diverged, 1 not begun"),
        "{status}"
    );

    let checkpoint = run_of(&killed.out(), "-s2").join("checkpoint.bin");
    let before = fs::metadata(&checkpoint)
        .expect("written")
        .modified()
        .expect("known");
    let printed = succeed(&mut killed.sweep(&["--jobs", "1"]));
    assert!(!printed.contains("-s1: "), "{printed}");
    assert!(
        fs::metadata(&checkpoint)
            .expect("there")
            .modified()
            .expect("known")
            > before
    );
    for seed in ["-s1", "-s2", "-s3"] {
        let [whole, killed] = [whole.out(), killed.out()].map(|out| results(&run_of(&out, seed)));
        assert!(whole == killed, "{seed}");
    }
    // It was resumed, not started again: there are the events of two processes.
    let files = fs::read_dir(run_of(&killed.out(), "-s2")).expect("readable");
    let names = files.map(|file| file.expect("readable").file_name());
    let events = names.filter(|name| name.to_string_lossy().starts_with("events."));
    assert_eq!(events.count(), 2);
}

/// SIGTERM, which a cluster sends at the time limit, and Ctrl-C: the checkpoint is written at once.
#[test]
fn a_signal_stops_a_sweep_with_checkpoints() {
    let text = sweep_of(
        "scenarios = \"separated\"\nseeds = \"1..2\"\n",
        "episodes = 100000\n",
    )
    .replace("checkpoint_every = 2", "checkpoint_every = 100000");
    let folder = Folder::new(&text);
    for signal in ["-INT", "-TERM"] {
        let mut command = folder.sweep(&["--jobs", "1"]);
        let child = command.stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = Running(child.spawn().expect("starts"));
        let end = Instant::now() + Duration::from_secs(120);
        let running = || succeed(&mut folder.sweep(&["--status"])).contains("(running)");
        while !running() {
            assert!(Instant::now() < end, "it does not begin");
        }
        thread::sleep(Duration::from_millis(500));
        let process = child.0.id().to_string();
        let kill = Command::new("kill").args([signal, &process]).status();
        assert!(kill.expect("starts").success());
        let mut errors = String::new();
        let stderr = child.0.stderr.as_mut().expect("piped");
        stderr.read_to_string(&mut errors).expect("text");
        let status = child.0.wait().expect("ends");
        assert_eq!(status.code(), Some(1), "{errors}");
        assert!(
            errors.contains("interrupted: 0 of 2 runs are finished"),
            "{errors}"
        );
        let status = succeed(&mut folder.sweep(&["--status"]));
        assert!(
            status.starts_with("2 runs: 0 finished, 0 running, 1 stopped"),
            "{status}"
        );
        assert_eq!(status.lines().count(), 2, "{status}");
    }
    // Episodes were trained although none of the periodic checkpoints was due.
    let metrics = fs::read_to_string(run_of(&folder.out(), "-s1").join("metrics.csv"));
    assert!(metrics.expect("written").lines().count() > 2);
}

#[test]
fn a_run_that_fails_does_not_stop_the_others() {
    let text = sweep_of(
        "scenarios = \"separated\"\nseeds = 1\n",
        "episodes = 8\nlearning_rate = [1e6, 1e-3]\n",
    );
    let folder = Folder::new(&text);
    for _ in 0..2 {
        let (code, errors) = fail(&mut folder.sweep(&["--jobs", "1"]));
        assert_eq!(code, 1, "{errors}");
        assert!(
            errors.contains("error: 1 of 2 runs are not finished: separated-sac-paper-"),
            "{errors}"
        );
        assert!(
            errors.contains("learning_rate=1000000.0") && errors.contains("(diverged)"),
            "{errors}"
        );
    }
    let status = succeed(&mut folder.sweep(&["--status"]));
    assert!(
        status.contains("2 runs: 1 finished, 0 running, 0 stopped, 1 diverged"),
        "{status}"
    );
}

/// Two processes share a sweep: each run is trained by one of them, and both end when all are finished.
#[test]
fn two_processes_share_a_sweep() {
    let text = sweep_of(
        "scenarios = \"separated\"\nseeds = \"1..4\"\n",
        "episodes = 12\n",
    );
    let folder = Folder::new(&text);
    let start = || {
        let mut command = folder.sweep(&["--jobs", "1"]);
        command.stdout(Stdio::piped()).spawn().expect("starts")
    };
    let outputs = [start(), start()].map(|child| child.wait_with_output().expect("ends"));
    for output in &outputs {
        let printed = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success() && printed.contains("all 4 runs are finished"),
            "{printed}"
        );
    }
    for seed in 1..=4 {
        let files = fs::read_dir(run_of(&folder.out(), &format!("-s{seed}"))).expect("readable");
        let names = files.map(|file| file.expect("readable").file_name());
        let events = names.filter(|name| name.to_string_lossy().starts_with("events."));
        assert_eq!(events.count(), 1, "seed {seed} was trained twice");
    }
}

/// The script is executed by bash as Slurm would: once for each index of its array.
#[test]
fn a_slurm_script_executes_every_run() {
    let text = sweep_of(
        "scenarios = \"separated\"\nseeds = \"1..5\"\n",
        "episodes = 4\n",
    );
    let text = format!("{text}[slurm]\nruns_per_task = 2\ntime_limit = \"00:10:00\"\n");
    let folder = Folder::new(&text);
    succeed(&mut folder.sweep(&["--task", "4"]));

    // A stand-in for sbatch: it executes the script for each index.
    let tools = folder.path().join("tools");
    fs::create_dir(&tools).expect("writable");
    let sbatch = tools.join("sbatch");
    let program = "#!/bin/bash\nset -e\nbash -n \"$1\"\narray=$(sed -n 's/^#SBATCH --array=//p' \"$1\")\n\
                   [ \"$array\" = 0-2 ]\nfor index in 0 1 2; do\n\
                   SLURM_ARRAY_JOB_ID=7 SLURM_ARRAY_TASK_ID=$index bash \"$1\"\ndone\n";
    fs::write(&sbatch, program).expect("writable");
    fs::set_permissions(&sbatch, fs::Permissions::from_mode(0o755)).expect("set");

    let printed = succeed(&mut folder.sweep(&["--engine", "slurm"]));
    assert!(
        printed.contains("4 runs in 3 array tasks, at most 2 runs each"),
        "{printed}"
    );
    assert!(printed.contains("submit it by: sbatch '"), "{printed}");
    let script = folder.out().join("slurm.sh");
    let syntax = Command::new("bash").arg("-n").arg(&script).status();
    assert!(syntax.expect("bash").success());
    // What is printed is a command that a shell understands.
    let command = printed
        .lines()
        .last()
        .expect("a line")
        .trim_start_matches("submit it by: ");
    let words = Command::new("bash")
        .arg("-c")
        .arg(format!("printf '%s\n' {command}"))
        .output();
    let words = String::from_utf8(words.expect("bash").stdout).expect("UTF-8");
    assert_eq!(words.lines().last(), script.to_str());

    let path = std::env::var("PATH").expect("set");
    let path = format!("{}:{path}", tools.display());
    succeed(
        folder
            .sweep(&["--engine", "slurm", "--submit"])
            .env("PATH", &path),
    );
    let status = succeed(&mut folder.sweep(&["--status"]));
    assert!(status.starts_with("5 runs: 5 finished"), "{status}");
    let log = fs::read_to_string(folder.out().join("logs/slurm-7_1.log")).expect("written");
    assert!(log.contains("-s4: finished before, "), "{log}");

    let mut compare = Command::new(cargo_bin("trainer"));
    let table = succeed(compare.arg("compare").arg(folder.out()));
    assert!(table.contains(" | 5 | "), "{table}");

    // The numbers of a changed file mean other runs, so the old script does nothing.
    fs::write(folder.file(), text.replace("1..5", "0..4")).expect("writable");
    let mut old = Command::new("bash");
    old.arg(&script).env("SLURM_ARRAY_TASK_ID", "0");
    assert_eq!(output(&mut old).status.code(), Some(1));
    let log = fs::read_to_string(folder.out().join("logs/slurm-0_0.log")).expect("written");
    assert!(log.contains("submit it again"), "{log}");
    let status = succeed(&mut folder.sweep(&["--status"]));
    assert!(status.starts_with("5 runs: 4 finished"), "{status}");
}

/// A stand-in for hq executes the tasks of `--array`; what it is told is what HyperQueue documents.
#[test]
fn a_hyperqueue_job_has_a_task_for_each_run_that_is_not_finished() {
    let text = sweep_of(
        "scenarios = \"separated\"\nseeds = \"1..3\"\n",
        "episodes = 4\n",
    );
    let folder = Folder::new(&text);
    succeed(&mut folder.sweep(&["--task", "2"]));
    let hq = folder.path().join("hq");
    let program = "#!/bin/bash\nset -e\nprintf '%s\\n' \"$@\" >\"$(dirname \"$0\")/arguments\"\n\
                   while [ \"$1\" != -- ]; do shift; done\nshift\n\
                   for id in 1 3; do HQ_TASK_ID=$id \"$@\"; done\n";
    fs::write(&hq, program).expect("writable");
    fs::set_permissions(&hq, fs::Permissions::from_mode(0o755)).expect("set");
    let mut command = folder.sweep(&["--engine", "hyperqueue", "--hq"]);
    let printed = succeed(command.arg(&hq));
    assert!(printed.contains("all 3 runs are finished in "), "{printed}");
    let arguments = fs::read_to_string(folder.path().join("arguments")).expect("written");
    assert!(arguments.starts_with("submit\n--name\n"), "{arguments}");
    assert!(
        arguments.contains("--array\n1,3\n--crash-limit\n20\n"),
        "{arguments}"
    );
    assert!(arguments.contains("\n--wait\n--\n/"), "{arguments}");

    fs::remove_dir_all(run_of(&folder.out(), "-s3")).expect("there");
    let mut missing = folder.sweep(&["--engine", "hyperqueue", "--hq", "/no/such/hq"]);
    let (code, errors) = fail(&mut missing);
    assert_eq!(code, 2, "{errors}");
    assert!(
        errors.contains("/no/such/hq cannot be started: install HyperQueue"),
        "{errors}"
    );
    assert_eq!(errors.lines().count(), 1, "{errors}");
    // A server that ends without having executed anything.
    let mut idle = folder.sweep(&["--engine", "hyperqueue", "--hq", "true"]);
    let (code, errors) = fail(&mut idle);
    assert_eq!(code, 1, "{errors}");
    assert!(errors.contains("1 of 3 runs are not finished") && errors.contains("-s3 (not begun)"));
}

#[test]
fn bad_usage_is_one_line_with_exit_code_2() {
    let folder = Folder::new("scenarios = \"separated\"\nseeds = 1\nseed = 2\n");
    let (code, errors) = fail(&mut folder.sweep(&[]));
    assert_eq!((code, errors.lines().count()), (2, 1), "{errors}");
    assert!(
        errors.contains("small sweep.toml: seed = 2 is unknown; known here: scenarios"),
        "{errors}"
    );
    fs::write(folder.file(), "scenarios = \"separated\"\nseeds = 1\n").expect("writable");
    for (task, expected) in [
        ("2", "run 2 does not exist: the runs are 1 to 1"),
        (
            "NO_SUCH_VARIABLE",
            "--task is \"NO_SUCH_VARIABLE\", but must be a number",
        ),
        ("HOME", "--task: HOME is "),
    ] {
        let (code, errors) = fail(&mut folder.sweep(&["--task", task]));
        assert_eq!((code, errors.lines().count()), (2, 1), "{errors}");
        assert!(errors.contains(expected), "{errors}");
    }
    for (arguments, expected) in [
        (
            ["--submit", "--engine=local"],
            "--submit is for --engine slurm",
        ),
        (
            ["--jobs=2", "--engine=slurm"],
            "--jobs is for --engine local",
        ),
    ] {
        let (code, errors) = fail(&mut folder.sweep(&arguments));
        assert_eq!((code, errors.lines().count()), (2, 1), "{errors}");
        assert!(errors.contains(expected), "{errors}");
    }
    assert!(!folder.out().exists());
}
