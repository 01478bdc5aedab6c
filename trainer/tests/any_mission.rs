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
}

#[test]
fn a_duration_without_missions_is_refused() {
    let directory = tempfile::tempdir().expect("a directory");
    let refused = trainer(&["train", "--minutes", "1"], directory.path()).code(2);
    let message = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(message.contains("--missions random"), "{message}");
}
