//! Nonsense in: exit code 2, one line that says what is wrong and what would be right, nothing
//! left behind.

use std::{fs, path::Path};

use assert_cmd::assert::OutputAssertExt;
use end_to_end::{program, repository};
use tempfile::tempdir;

/// Runs with these arguments and expects a refusal whose line holds all of `expected`.
fn refused(arguments: &[&str], expected: &[&str]) {
    let folder = tempdir().unwrap();
    let out = folder.path().join("run");
    let output = program("host-sim")
        .args(arguments)
        .arg("--out")
        .arg(&out)
        .assert()
        .code(2)
        .get_output()
        .clone();
    let complaint = String::from_utf8(output.stderr).unwrap();
    for part in expected {
        assert!(complaint.contains(part), "`{part}` is not in: {complaint}");
    }
    assert!(!complaint.contains("panicked"), "{complaint}");
    // clap's refusals of an option's value say more than one line.
    if complaint.starts_with("error: invalid value") {
        assert!(complaint.contains("--help"), "{complaint}");
    } else {
        assert_eq!(complaint.lines().count(), 1, "{complaint}");
    }
    assert!(output.stdout.is_empty());
    assert!(!out.exists(), "something was left behind");
}

/// A policy file that is missing is no policy that fits no mission.
#[test]
fn a_benchmark_names_a_missing_policy() {
    let output = program("host-sim")
        .current_dir(repository())
        .args(["benchmark", "--first", "1", "--policy", "missing.policy"])
        .assert()
        .code(2)
        .get_output()
        .clone();
    let complaint = String::from_utf8(output.stderr).unwrap();
    let expected = "error: --policy missing.policy: No such file";
    assert!(complaint.starts_with(expected), "{complaint}");
    assert_eq!(complaint.lines().count(), 1, "{complaint}");
    assert!(output.stdout.is_empty());
}

/// A log that cannot be written is refused before the flight.
#[test]
fn a_flight_log_that_cannot_be_written_is_named() {
    let expected = "error: --mcap nowhere/flight.mcap: No such file";
    refused(&["run", "--mcap", "nowhere/flight.mcap"], &[expected]);
    let folder = tempdir().unwrap();
    let path = folder.path().to_str().unwrap();
    refused(&["run", "--mcap", path], &[path, "is a directory"]);
}

/// A scenario with one thing changed.
fn scenario_with(folder: &Path, old: &str, new: &str) -> String {
    let text = fs::read_to_string(repository().join("scenarios/separated.toml")).unwrap();
    assert!(text.contains(old), "{old}");
    let path = folder.join("changed.toml");
    fs::write(&path, text.replacen(old, new, 1)).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_missing_scenario_is_named() {
    refused(
        &["run", "--scenario", "nowhere/mission.toml"],
        &[
            "error: nowhere/mission.toml: No such file",
            "the shipped scenarios are separated, mixed and slow",
        ],
    );
}

#[test]
fn each_wrong_field_is_named_with_its_value_and_range() {
    let text = fs::read_to_string(repository().join("scenarios/separated.toml")).unwrap();
    let users = &text[text.find("[users]").unwrap()..text.find("[sensors]").unwrap()];
    let none = "[users]\npower_max_w = 0.2\npositions_m = []\n";
    let cases: [(&str, &str, &[&str]); 8] = [
        (
            "altitude_m =",
            "altitud_m =",
            &["unknown field `altitud_m`", "line 10"],
        ),
        (
            "power_max_w = 0.2",
            "power_max_w = -0.2",
            &["users.power_max_w is -0.2", "above 0"],
        ),
        (
            "[385.9, 556.9]",
            "[nan, 556.9]",
            &["users.positions_m[0] is [NaN, 556.9]", "[0, 1000]"],
        ),
        (
            "mse_threshold = 0.015",
            "mse_threshold = 0.028",
            &["mse_threshold is 0.028", "1/J = 0.0277"],
        ),
        (
            "max_speed_mps = 30.0",
            "max_speed_mps = 20.0",
            &["mission.destination_m is 1272.79", "1220 m"],
        ),
        (users, none, &["users.positions_m is empty"]),
        (
            "slots = 60",
            "slots = \"sixty\"",
            &["mission.slots", "expected u32", "line 5"],
        ),
        ("[mission]", "[mission", &["line 4"]),
    ];
    for (old, new, expected) in cases {
        let folder = tempdir().unwrap();
        let file = scenario_with(folder.path(), old, new);
        let mut expected = expected.to_vec();
        expected.push("changed.toml: ");
        refused(&["run", "--scenario", &file], &expected);
    }
}

#[test]
fn more_sensors_than_the_controller_holds_are_refused() {
    let folder = tempdir().unwrap();
    let row = "    [600.0, 300.0],\n";
    let more = format!("[sensors]\npositions_m = [\n{}", row.repeat(60));
    let file = scenario_with(folder.path(), "[sensors]\npositions_m = [\n", &more);
    refused(
        &["run", "--scenario", &file],
        &["sensors.positions_m has 96 entries", "at most 64"],
    );
}

/// What the mission's radios cannot send is not flown as if they could.
#[test]
fn a_fixed_power_above_its_limit_is_refused() {
    refused(
        &["run", "--inner", "fixed-user-power:5"],
        &["--inner fixed-user-power:5", "users.power_max_w = 0.2 W"],
    );
}

/// A device that never ends is no input file.
#[cfg(target_os = "linux")]
#[test]
fn a_file_without_an_end_is_refused() {
    refused(
        &["run", "--scenario", "/dev/zero"],
        &["/dev/zero", "longer than 64 MiB"],
    );
}

#[test]
fn a_policy_file_that_is_none_is_refused() {
    let folder = tempdir().unwrap();
    for name in ["broken.onnx", "broken.policy"] {
        let path = folder.path().join(name);
        fs::write(&path, b"this is no policy").unwrap();
        refused(&["run", "--policy", path.to_str().unwrap()], &[name]);
        let missing = folder.path().join(format!("missing-{name}"));
        refused(
            &["run", "--policy", missing.to_str().unwrap()],
            &["missing-"],
        );
    }
    refused(&["run", "--policy", "clever"], &["clever", "straight-line"]);
}

#[test]
fn an_output_folder_that_is_a_file_is_refused_and_kept() {
    let folder = tempdir().unwrap();
    let file = folder.path().join("out");
    fs::write(&file, "mine").unwrap();
    let run = program("host-sim")
        .args(["run", "--out"])
        .arg(&file)
        .assert()
        .code(2);
    let complaint = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert!(complaint.contains("--out"), "{complaint}");
    assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
}

#[test]
fn a_scenario_that_is_there_is_not_replaced_unasked() {
    let folder = tempdir().unwrap();
    let file = folder.path().join("mine.toml");
    let make = |arguments: &[&str]| {
        let mut command = program("host-sim");
        command.args(["scenario", "new", "--out"]).arg(&file);
        command.args(arguments).assert()
    };
    make(&["--sensors", "12"]).success();
    let made = fs::read_to_string(&file).unwrap();
    assert!(made.contains("mse_threshold = 0.045"), "{made}");
    let refusal = make(&["--seed", "2"]).code(2);
    let complaint = String::from_utf8(refusal.get_output().stderr.clone()).unwrap();
    assert!(complaint.contains("mine.toml exists already; use --overwrite"));
    assert_eq!(fs::read_to_string(&file).unwrap(), made);
    make(&["--seed", "2", "--overwrite", "--mse-threshold", "0.02"]).success();
    let made = fs::read_to_string(&file).unwrap();
    assert!(made.contains("mse_threshold = 0.02\n"), "{made}");
}

/// A key file that is not one is refused before anything flies, and its content is not shown.
#[cfg(unix)]
#[test]
fn a_ground_key_that_is_none() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempdir().unwrap();
    for (content, mode, expected) in [
        (
            "5a".repeat(31),
            0o600,
            "64 hexadecimal digits and nothing else",
        ),
        (
            "5a".repeat(40),
            0o600,
            "64 hexadecimal digits and nothing else",
        ),
        ("5a".repeat(32), 0o644, "mode 644 gives others access"),
    ] {
        let path = folder.path().join("ground.key");
        fs::write(&path, &content).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        let file = path.display().to_string();
        refused(&["run", "--ground-key", &file], &[&file, expected]);
        let device = [
            "run",
            "--precision",
            "f32",
            "--policy",
            "plan",
            "--ground-key",
            &file,
        ];
        refused(&device, &[&file, expected]);
    }
    refused(&["run", "--ground-key", "no-such.key"], &["no-such.key"]);
    refused(&["run", "--ground-key", "/dev/zero"], &["/dev/zero"]);
}
