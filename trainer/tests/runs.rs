//! Whole runs through the command line: they are reproducible, can be killed and resumed, and export
//! policies.

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use assert_cmd::cargo::cargo_bin;
use firmware_core::policy::mlp::Mlp;
use trainer::onnx;

/// Settings of a small run, in which learning starts in the third episode.
const SETTINGS: &str = "hidden = 32\nbatch = 16\nwarmup_slots = 120\nevaluate_every = 4\n\
                        checkpoint_every = 4\nbuffer_capacity = 1000\n";

fn train(directory: &Path, arguments: &[&str]) -> Command {
    let settings = directory.with_extension("toml");
    fs::write(&settings, SETTINGS).expect("writable");
    let mut command = Command::new(cargo_bin("trainer"));
    command
        .args(["train", "--quiet", "--out"])
        .arg(directory)
        .args(arguments);
    if !arguments.contains(&"--resume") {
        command.arg("--settings").arg(settings);
    }
    command
}

fn succeed(mut command: Command) -> String {
    let output = command.output().expect("runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Reads the files that must be equal between two equal runs.
fn results(directory: &Path) -> [Vec<u8>; 3] {
    ["policy.onnx", "metrics.csv", "checkpoint.bin"]
        .map(|name| fs::read(directory.join(name)).expect("written"))
}

#[test]
fn same_seed_same_bytes_and_another_seed_others() {
    let home = tempfile::tempdir().expect("temporary");
    for algorithm in ["sac", "ddpg"] {
        let run = |name: &str, seed: &str| {
            let directory = home.path().join(format!("{algorithm}-{name}"));
            let arguments = ["--algorithm", algorithm, "--episodes", "12", "--seed", seed];
            succeed(train(&directory, &arguments));
            results(&directory)
        };
        let first = run("first", "5");
        assert!(first == run("second", "5"), "{algorithm}");
        assert!(first[0] != run("third", "6")[0], "{algorithm}");
    }
}

/// A run that is killed at an arbitrary time and resumed writes the same bytes as an undisturbed one.
#[test]
fn a_killed_run_resumes_bit_for_bit() {
    let home = tempfile::tempdir().expect("temporary");
    let whole = home.path().join("whole");
    succeed(train(&whole, &["--episodes", "24"]));

    let killed = home.path().join("killed");
    let mut child = train(&killed, &["--episodes", "24"])
        .stdout(Stdio::null())
        .spawn()
        .expect("runs");
    let checkpoint = killed.join("checkpoint.bin");
    let patience = Instant::now() + Duration::from_secs(120);
    while !checkpoint.exists() && Instant::now() < patience {
        thread::sleep(Duration::from_millis(1));
    }
    // It may have ended by itself on a fast machine; then resuming has nothing left to do.
    let _ = child.kill();
    child.wait().expect("ends");
    succeed(train(&killed, &["--resume"]));
    assert!(results(&killed) == results(&whole));
}

/// A run of 8 episodes that is resumed with 24 equals a run of 24.
#[test]
fn a_finished_run_can_be_prolonged() {
    let home = tempfile::tempdir().expect("temporary");
    let (whole, parts) = (home.path().join("whole"), home.path().join("parts"));
    succeed(train(&whole, &["--episodes", "24"]));
    succeed(train(&parts, &["--episodes", "8"]));
    succeed(train(&parts, &["--resume", "--episodes", "24"]));
    assert!(results(&parts)[..2] == results(&whole)[..2]);
}

#[test]
fn a_damaged_checkpoint_or_another_scenario_is_refused() {
    let home = tempfile::tempdir().expect("temporary");
    let directory = home.path().join("run");
    succeed(train(&directory, &["--episodes", "4"]));
    let refused = |arguments: &[&str], expected: &str| {
        let output = train(&directory, arguments).output().expect("runs");
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains(expected), "{errors}");
        assert_eq!(errors.lines().count(), 1, "{errors}");
    };
    refused(&["--episodes", "4"], "--resume continues it");
    for (option, value) in [("--scenario", "mixed"), ("--algorithm", "ddpg")] {
        let mut command = train(&directory, &["--resume", option, value]);
        let output = command.output().expect("runs");
        assert_eq!(output.status.code(), Some(2));
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(errors.contains("cannot be used with"), "{errors}");
    }
    let path = directory.join("checkpoint.bin");
    let mut bytes = fs::read(&path).expect("readable");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&path, bytes).expect("writable");
    refused(&["--resume"], "the file is damaged");
}

/// A resumed run keeps its scenario, algorithm and settings. Only `--episodes` may differ, and is saved.
#[test]
fn a_resumed_run_knows_what_it_is() {
    let home = tempfile::tempdir().expect("temporary");
    let directory = home.path().join("run");
    let arguments = ["--scenario", "mixed", "--mse-threshold", "0.02"];
    let ddpg = ["--algorithm", "ddpg", "--episodes", "4"];
    succeed(train(&directory, &[arguments, ddpg].concat()));
    succeed(train(&directory, &["--resume", "--episodes", "8"]));
    let settings = fs::read_to_string(directory.join("settings.toml")).expect("written");
    assert!(settings.contains("algorithm = \"ddpg\"") && settings.contains("episodes = 8"));
}

/// Replacing a run removes all of its files, so none can be mistaken for those of the new run.
#[test]
fn overwriting_removes_the_old_run() {
    let home = tempfile::tempdir().expect("temporary");
    let directory = home.path().join("run");
    succeed(train(&directory, &["--episodes", "8"]));
    let mut restart = train(&directory, &["--overwrite", "--seed", "2"]);
    let mut child = restart.spawn().expect("starts");
    let settings = directory.join("settings.toml");
    let checkpoint = directory.join("checkpoint.bin");
    let begun = || {
        fs::read_to_string(&settings).is_ok_and(|text| text.contains("seed = 2"))
            && checkpoint.exists()
    };
    let end = std::time::Instant::now() + std::time::Duration::from_secs(60);
    while !begun() {
        assert!(std::time::Instant::now() < end, "it does not begin");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
    succeed(train(&directory, &["--resume", "--episodes", "12"]));
    let whole = home.path().join("whole");
    succeed(train(&whole, &["--episodes", "12", "--seed", "2"]));
    assert!(results(&directory) == results(&whole));
}

/// A settings file may name algorithm and seed. Options on the command line override it.
#[test]
fn a_settings_file_names_algorithm_and_seed() {
    let home = tempfile::tempdir().expect("temporary");
    let file = home.path().join("given.toml");
    let run = |name: &str, named: &str, arguments: &[&str]| {
        fs::write(&file, format!("{SETTINGS}{named}")).expect("writable");
        let directory = home.path().join(name);
        let mut command = Command::new(cargo_bin("trainer"));
        command.args(["train", "--quiet", "--episodes", "4", "--settings"]);
        command.arg(&file).arg("--out").arg(&directory);
        succeed({
            command.args(arguments);
            command
        });
        results(&directory)
    };
    let named = run("named", "algorithm = \"ddpg\"\nseed = 7\n", &[]);
    let told = run("told", "", &["--algorithm", "ddpg", "--seed", "7"]);
    assert!(named == told);
    let both = run(
        "both",
        "seed = 9\n",
        &["--seed", "7", "--algorithm", "ddpg"],
    );
    assert!(both == told);
}

/// A run with another threshold than its scenario's saves the changed scenario.
#[test]
fn a_run_keeps_the_scenario_that_it_was_made_on() {
    let home = tempfile::tempdir().expect("temporary");
    let directory = home.path().join("run");
    let arguments = ["--episodes", "4", "--mse-threshold", "0.02"];
    succeed(train(&directory, &arguments));
    let curves = || {
        let mut command = Command::new(cargo_bin("trainer"));
        command.arg("curves").arg(&directory).arg("--out");
        command.arg(home.path().join("curves.csv"));
        command.arg("--svg").arg(home.path().join("curves.svg"));
        command
    };
    succeed(curves());
    let text = fs::read_to_string(home.path().join("curves.csv")).expect("written");
    assert!(text.contains(",sac,0.0001,0.9,1,4,"), "{text}");
    let drawing = fs::read_to_string(home.path().join("curves.svg")).expect("written");
    assert!(
        drawing.starts_with("<svg") && drawing.contains("<path"),
        "{drawing}"
    );

    // Without scenario.toml, the shipped scenario of that name is used, which differs.
    fs::remove_file(directory.join("scenario.toml")).expect("was there");
    let output = curves().output().expect("runs");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("the run was made on"), "{errors}");
    assert_eq!(errors.lines().count(), 1, "{errors}");
}

#[test]
fn a_diverging_run_stops_and_leaves_its_batch() {
    let home = tempfile::tempdir().expect("temporary");
    let directory = home.path().join("run");
    let arguments = ["--episodes", "24", "--learning-rate", "1e6"];
    let output = train(&directory, &arguments).output().expect("runs");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("episode ") && errors.contains("losses/"),
        "{errors}"
    );
    let batch = fs::read(directory.join("diverged.json")).expect("written");
    let batch: serde_json::Value = serde_json::from_slice(&batch).expect("JSON");
    assert_eq!(batch["reward"].as_array().expect("a list").len(), 16);
}

/// Exported and converted files contain the same policy.
#[test]
fn exported_and_converted_policies_fly_alike() {
    let home = tempfile::tempdir().expect("temporary");
    let directory = home.path().join("run");
    succeed(train(&directory, &["--episodes", "8"]));
    let (exported, converted) = (home.path().join("p.onnx"), home.path().join("p.policy"));
    let trainer = || Command::new(cargo_bin("trainer"));
    let mut export = trainer();
    export
        .arg("export")
        .arg(directory.join("checkpoint.bin"))
        .arg("--onnx")
        .arg(&exported);
    succeed(export);
    let best = fs::read(directory.join("policy.onnx")).expect("written");
    assert!(fs::read(&exported).expect("written") == best);
    let mut convert = trainer();
    convert.arg("convert").args([&exported, &converted]);
    succeed(convert);
    let evaluate = |policy: &Path| {
        let mut command = trainer();
        command.arg("evaluate").arg(policy).args(["--json"]);
        succeed(command)
    };
    assert_eq!(evaluate(&exported), evaluate(&converted));
    let report: serde_json::Value = serde_json::from_str(&evaluate(&exported)).expect("JSON");
    assert_eq!(report["arrived"], true);
    assert_eq!(report["fair"], true);

    let actor = onnx::read::parse(&best).expect("sound");
    let policy = Mlp::load(fs::read(&converted).expect("written")).expect("sound");
    assert_eq!(policy.provenance(), &actor.provenance);
    assert_eq!(actor.provenance.algorithm, "sac");
}

/// `--seeds` trains one run per seed, each the same as a run with that `--seed`.
#[test]
fn a_range_of_seeds_trains_a_run_for_each() {
    let home = tempfile::tempdir().expect("temporary");
    let (range, single) = (home.path().join("range"), home.path().join("single"));
    let printed = succeed(train(&range, &["--episodes", "4", "--seeds", "2..4"]));
    assert_eq!(printed.lines().count(), 3, "{printed}");
    let mut written: Vec<String> = fs::read_dir(&range)
        .expect("readable")
        .map(|entry| {
            let name = entry.expect("readable").file_name();
            name.into_string().expect("text")
        })
        .collect();
    written.sort();
    assert_eq!(written, ["seed-2", "seed-3", "seed-4"]);
    succeed(train(&single, &["--episodes", "4", "--seed", "3"]));
    assert!(results(&range.join("seed-3")) == results(&single));
    assert!(results(&range.join("seed-3")) != results(&range.join("seed-4")));
    // Nothing is trained if one of the runs exists.
    let overlapping = train(&range, &["--episodes", "4", "--seeds", "1..2"]).output();
    let overlapping = overlapping.expect("runs");
    assert_eq!(overlapping.status.code(), Some(2));
    assert!(!range.join("seed-1").exists());
}

/// A failed run does not keep the following seeds from being trained, and the exit code reports it.
#[test]
fn every_seed_is_trained_although_one_fails() {
    let home = tempfile::tempdir().expect("temporary");
    let directory = home.path().join("run");
    let arguments = [
        "--episodes",
        "24",
        "--learning-rate",
        "1e6",
        "--seeds",
        "1..2",
    ];
    let output = train(&directory, &arguments).output().expect("runs");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(errors.contains("seed 1: episode ") && errors.contains("; seed 2: episode "));
    assert!(directory.join("seed-2/diverged.json").exists());
}

#[test]
fn a_bad_range_of_seeds_is_refused() {
    let home = tempfile::tempdir().expect("temporary");
    let directory = home.path().join("run");
    let cases: [(&[&str], &str); 6] = [
        (&["--seeds", "3"], "FIRST..LAST, for example 1..3"),
        (
            &["--seeds", "3..1"],
            "the first seed, 3, is above the last, 1",
        ),
        (&["--seeds", "1..x"], "\"x\" is not a seed"),
        (&["--seeds=-1..2"], "\"-1\" is not a seed"),
        (&["--seeds", "1..1001000"], "more than 1000 seeds"),
        (&["--seeds", "1..2", "--seed", "1"], "cannot be used with"),
    ];
    for (arguments, expected) in cases {
        let output = train(&directory, arguments).output().expect("runs");
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains(expected), "{errors}");
        assert!(!directory.exists());
    }
}

/// A run on a mission with a model of TR 36.777, and one with a map of gains, is trained, resumed and
/// knows its scenario, wherever it was started from; prices that need the bound are refused with a
/// map.
#[test]
fn runs_with_other_gains_are_resumed() {
    let home = tempfile::tempdir().expect("temporary");
    let paper =
        "environment = { a = 9.613, b = 0.158 }\nexcess_loss_db = { los = 1.0, nlos = 20.0 }\n";
    let shipped = scenario::generate(scenario::Topology::Mixed, 1, 2, 3).expect("valid");
    let mut csv = "node,index,east_m,north_m,power_gain\n".to_owned();
    for node in ["user,0", "user,1", "sensor,0", "sensor,1", "sensor,2"] {
        for place in ["0,0", "1000,0", "0,1000", "1000,1000"] {
            csv += &format!("{node},{place},{:e}\n", 1e-10 * place.len() as f64);
        }
    }
    fs::write(home.path().join("gains.csv"), csv).expect("writable");
    for (name, radio) in [
        ("model", "model = \"umi-av\"\n".to_owned()),
        ("map", format!("{paper}gain_map = \"gains.csv\"\n")),
    ] {
        let file = home.path().join(format!("{name}-scenario.toml"));
        fs::write(&file, shipped.to_toml().replace(paper, &radio)).expect("writable");
        let file = file.to_str().expect("printable");
        let (whole, parts) = (
            home.path().join(format!("{name}-whole")),
            home.path().join(format!("{name}-parts")),
        );
        succeed(train(&whole, &["--scenario", file, "--episodes", "12"]));
        succeed(train(&parts, &["--scenario", file, "--episodes", "8"]));
        succeed(train(&parts, &["--resume", "--episodes", "12"]));
        assert!(results(&parts)[..2] == results(&whole)[..2], "{name}");
        let tuned = home.path().join(format!("{name}-tuned"));
        let arguments = ["--scenario", file, "--episodes", "4", "--preset", "tuned"];
        let output = train(&tuned, &arguments).output().expect("runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        let map = name == "map";
        assert_eq!(
            output.status.code(),
            Some(if map { 2 } else { 0 }),
            "{errors}"
        );
        assert_eq!(
            map,
            errors.contains("fairness_prices = true needs the bound's prices")
        );
    }
}
