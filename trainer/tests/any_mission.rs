//! `trainer train --missions random` and `trainer export --policy`, as a user starts them.

use std::{fs, path::Path};

use assert_cmd::{Command, cargo::cargo_bin};
use firmware_core::policy::sets::{SetsNetwork, SetsWork};

fn trainer(arguments: &[&str], directory: &Path) -> assert_cmd::assert::Assert {
    let mut command = Command::new(cargo_bin("trainer"));
    command.args(arguments).current_dir(directory).assert()
}

const SETTINGS: &str = "
batch = 8
first_missions = 1
planning_operations = 5000000
correction_operations = 100000
held_out_missions = 1
evaluate_every = 4
report_every = 2
architecture = { width = 32, hidden = 32, layers = 1 }
";

#[test]
fn a_policy_is_trained_resumed_and_exported() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path();
    fs::write(path.join("small.toml"), SETTINGS).expect("written");
    let train = ["train", "--missions", "random", "--settings", "small.toml"];
    let run = ["--seed", "3", "--steps", "4", "--out", "run", "--quiet"];
    trainer(&[&train[..], &run].concat(), path).success();
    // Another run does not replace it by accident.
    trainer(&[&train[..], &run].concat(), path).code(2);
    let resume = [
        "train", "--resume", "--out", "run", "--steps", "8", "--quiet",
    ];
    trainer(&resume, path).success();
    let metrics = fs::read_to_string(path.join("run/metrics.csv")).expect("metrics");
    let steps: Vec<_> = metrics
        .lines()
        .filter_map(|line| line.split(',').nth(1))
        .collect();
    assert_eq!(steps, ["global_step", "2", "4", "6", "8"]);

    let export = ["export", "run/checkpoint.bin", "--policy", "any.policy"];
    trainer(&export, path).success();
    let file = fs::read(path.join("any.policy")).expect("the file");
    let network = SetsNetwork::load(file, &mut SetsWork::default()).expect("loads");
    assert_eq!(network.provenance().seed, 3);
    let from = [
        "--from",
        "run/checkpoint.bin",
        "--steps",
        "2",
        "--out",
        "second",
        "--quiet",
    ];
    trainer(&[&train[..], &from].concat(), path).success();

    // Layouts are left out of a run; a network that has learned from them does not begin one.
    let without = |layouts: &[&'static str], rest: &[&'static str]| {
        let leave_out = layouts.iter().flat_map(|layout| ["--leave-out", *layout]);
        let run = ["--steps", "2", "--out", "third", "--quiet"];
        let arguments: Vec<&str> = train.into_iter().chain(run).chain(leave_out).collect();
        trainer(&[&arguments[..], rest].concat(), path)
    };
    let errors = |assert: assert_cmd::assert::Assert| {
        String::from_utf8_lossy(&assert.code(2).get_output().stderr).into_owned()
    };
    let layouts = ["uniform", "clustered", "ring", "line", "corner"];
    let refused = errors(without(&layouts, &[]));
    assert!(refused.contains("left_out_layouts must leave"), "{refused}");
    let refused = errors(without(&["ring"], &["--from", "run/checkpoint.bin"]));
    assert!(
        refused.contains("learned from missions \"random\""),
        "{refused}"
    );
    without(&["ring", "line"], &[]).success();
    let settings = fs::read_to_string(path.join("third/settings.toml")).expect("settings");
    assert!(
        settings.contains(r#"left_out_layouts = ["ring", "line"]"#),
        "{settings}"
    );
    let from = ["--from", "third/checkpoint.bin", "--overwrite"];
    without(&["line", "ring"], &from).success();

    // As ONNX: converted to the same file, evaluated, and adapted to one mission.
    let export = ["export", "run/checkpoint.bin", "--onnx", "any.onnx"];
    trainer(&export, path).success();
    trainer(&["convert", "any.onnx", "converted.policy"], path).success();
    let [exported, converted] =
        ["any.policy", "converted.policy"].map(|name| fs::read(path.join(name)).expect("written"));
    assert_eq!(exported, converted);
    for file in ["any.onnx", "any.policy", "any"] {
        trainer(&["evaluate", file, "--scenario", "mixed"], path).success();
    }
    let adapt = [
        "train",
        "--scenario",
        "mixed",
        "--from",
        "any.onnx",
        "--settings",
        "small.toml",
        "--steps",
        "4",
        "--out",
        "adapted",
        "--quiet",
    ];
    trainer(&adapt, path).success();
    trainer(
        &["export", "adapted/checkpoint.bin", "--onnx", "mixed.onnx"],
        path,
    )
    .success();
    trainer(&["evaluate", "mixed.onnx", "--scenario", "mixed"], path).success();
}

const SAC_SETTINGS: &str = "
random_missions = 1
actor_frozen_steps = 2
imitation_batch = 8
critic_architecture = { width = 32, hidden = 32, layers = 1 }
[imitation]
batch = 8
first_missions = 1
planning_operations = 5000000
correction_operations = 100000
held_out_missions = 1
evaluate_every = 4
report_every = 2
architecture = { width = 32, hidden = 32, layers = 1 }
";

/// SAC from an untrained network, resumed, exported, and from the exported network.
#[test]
fn a_policy_is_improved_by_sac() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path();
    fs::write(path.join("small.toml"), SAC_SETTINGS).expect("written");
    let train = [
        "train",
        "--missions",
        "random",
        "--algorithm",
        "sac",
        "--settings",
        "small.toml",
        "--quiet",
    ];
    let run = ["--seed", "3", "--steps", "4", "--out", "run"];
    trainer(&[&train[..], &run].concat(), path).success();
    let resume = [
        "train", "--resume", "--out", "run", "--steps", "8", "--quiet",
    ];
    trainer(&resume, path).success();
    let metrics = fs::read_to_string(path.join("run/metrics.csv")).expect("metrics");
    assert_eq!(metrics.lines().count(), 5, "{metrics}");
    for name in [
        "losses/qf1_loss",
        "charts/held_out_mean",
        "charts/flown_fraction",
    ] {
        assert!(metrics.contains(name), "{metrics}");
    }
    let export = ["export", "run/checkpoint.bin", "--onnx", "any.onnx"];
    trainer(&export, path).success();
    trainer(&["evaluate", "any.onnx", "--scenario", "mixed"], path).success();
    for (from, out) in [("any.onnx", "second"), ("run/checkpoint.bin", "third")] {
        let run = ["--from", from, "--steps", "3", "--out", out];
        trainer(&[&train[..], &run].concat(), path).success();
    }
}

/// Options that do not go together are refused with what would.
#[test]
fn other_algorithms_are_refused() {
    let directory = tempfile::tempdir().expect("a directory");
    for (arguments, expected) in [
        (
            vec![
                "--missions",
                "random",
                "--algorithm",
                "ddpg",
                "--steps",
                "1",
            ],
            "--missions random takes --algorithm sac, or none for imitation",
        ),
        (
            vec!["--scenario", "mixed", "--from", "new", "--algorithm", "sac"],
            "--algorithm needs --missions random",
        ),
        (
            vec!["--missions", "random", "--algorithm", "sac"],
            "steps is 0 and minutes is 0",
        ),
    ] {
        let arguments = [&["train", "--out", "run"][..], &arguments].concat();
        let refused = trainer(&arguments, directory.path()).code(2);
        let error = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn a_duration_without_missions_is_refused() {
    let directory = tempfile::tempdir().expect("a directory");
    let refused = trainer(&["train", "--minutes", "1"], directory.path()).code(2);
    let message = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(message.contains("--missions random"), "{message}");
}

/// What cannot be started from is refused in one line that names the file.
#[test]
fn other_files_cannot_be_started_from() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path();
    let one_mission = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/mixed-sac.onnx");
    for (from, expected) in [
        (
            one_mission,
            "mixed-sac.onnx: format_version is 1, but a policy for any mission has 2",
        ),
        ("missing.onnx", "missing.onnx: "),
    ] {
        let arguments = [
            "train",
            "--scenario",
            "mixed",
            "--from",
            from,
            "--out",
            "run",
        ];
        let refused = trainer(&arguments, path).code(2);
        let error = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
        assert!(error.contains(expected), "{error}");
        assert_eq!(error.trim_end().lines().count(), 1, "{error}");
    }
}
