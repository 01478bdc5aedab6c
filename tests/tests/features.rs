//! The features of `firmware-core`: every sensible combination compiles without warnings, and a
//! program that takes none of them builds only what it needs.

use std::{collections::BTreeSet, process::Command};

use end_to_end::repository;

/// Combinations that differ: `planner` and `link` include `policy`, and the modules `onboard` and
/// `console` appear where several features meet. `onnx` is built by the other crates.
const COMBINATIONS: [&str; 15] = [
    "",
    "policy",
    "gain-map",
    "planner",
    "learned-gains",
    "link",
    "planner link",
    "autopilot",
    "autopilot policy",
    "autopilot planner",
    "autopilot link",
    "autopilot planner link",
    "autopilot planner link gain-map learned-gains",
    "defmt embassy-time",
    "autopilot planner link defmt embassy-time",
];

fn cargo(arguments: &[&str]) -> Command {
    let mut command = Command::new(option_env!("CARGO").unwrap_or("cargo"));
    command.args(arguments).current_dir(repository());
    command
}

#[test]
fn every_combination_of_features_compiles_without_warnings() {
    let mut problems = Vec::new();
    for features in COMBINATIONS {
        let mut check = cargo(&["check", "--locked", "--package", "firmware-core", "--lib"]);
        // A directory of its own: the flag would have everything in the usual one built again.
        check.args(["--no-default-features", "--target-dir", "target/features"]);
        check.args(["--features", features]);
        let output = check.env("RUSTFLAGS", "-D warnings").output();
        let output = output.expect("cargo starts");
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            problems.push(format!("features \"{features}\": {said}"));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn without_features_the_core_depends_on_four_crates() {
    let tree = |features: &[&str]| {
        let listed = [
            "tree",
            "--locked",
            "--package",
            "firmware-core",
            "--depth",
            "1",
        ];
        let plain = ["--prefix", "none", "--edges", "normal,build"];
        let output = cargo(&[&listed[..], &plain[..], features].concat()).output();
        let output = output.expect("cargo starts");
        let text = String::from_utf8(output.stdout).expect("UTF-8");
        let names = text.lines().filter_map(|line| line.split(' ').next());
        names.map(str::to_owned).collect::<BTreeSet<String>>()
    };
    let expected = ["firmware-core", "heapless", "libm", "nalgebra", "serde"];
    let expected: BTreeSet<String> = expected.map(str::to_owned).into();
    assert_eq!(tree(&["--no-default-features"]), expected);
    let all = tree(&[]);
    assert!(
        all.contains("mavlink") && all.is_superset(&expected),
        "{all:?}"
    );
}
