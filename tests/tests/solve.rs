//! `host-sim solve`, line by line.

use assert_cmd::{Command as TestCommand, assert::OutputAssertExt};
use end_to_end::program;
use serde_json::{Value, json};

fn solve(arguments: &[&str], input: &str) -> (Vec<Value>, String) {
    let run = TestCommand::from_std(program("host-sim"))
        .arg("solve")
        .args(arguments)
        .write_stdin(input)
        .assert();
    let bad = run
        .get_output()
        .stdout
        .windows(8)
        .any(|w| w == b"\"error\":");
    let run = run.code(if bad { 2 } else { 0 });
    let output = String::from_utf8(run.get_output().stdout.clone()).unwrap();
    let lines = output
        .lines()
        .map(|line| serde_json::from_str(line).unwrap());
    (
        lines.collect(),
        String::from_utf8(run.get_output().stderr.clone()).unwrap(),
    )
}

fn slot() -> Value {
    json!({
        "sensor_gain": vec![4e-12; 36], "user_gain": 2e-12, "sensor_power_max": 0.05,
        "user_power_max": 0.2, "noise_power": 3.1622776601683797e-13, "mse_threshold": 0.015,
    })
}

/// A bad line is answered with what is wrong with it, and the rest go on.
#[test]
fn bad_lines_do_not_stop_the_good_ones() {
    let changed = |field: &str, value: Value| {
        let mut slot = slot();
        slot[field] = value;
        slot.to_string()
    };
    let cases = [
        (slot().to_string(), None),
        ("not json".into(), Some("")),
        ("{}".into(), Some("sensor_gain")),
        (
            changed("noise_power", json!(-1.0)),
            Some("noise_power is -1"),
        ),
        (
            changed("mse_threshold", json!(0.03)),
            Some("mse_threshold is 0.03"),
        ),
        (changed("sensor_gain", json!([])), Some("sensor_gain")),
        (
            changed("sensor_gain", json!([1e-12, -1e-12])),
            Some("sensor_gain[1] is -"),
        ),
        (changed("user_gain", json!("loud")), Some("user_gain")),
        (changed("sensor_error_variance", json!(0.05)), None),
        (
            changed("sensor_error_variance", json!([0.1, 0.2])),
            Some("sensor_error_variance has 2 numbers"),
        ),
        (
            changed("sensor_phase_error_rad", json!(4)),
            Some(
                "line 11: sensor_phase_error_rad is 4, but must be a standard deviation from 0 to pi",
            ),
        ),
        (
            changed("user_error_variance", json!(-0.5)),
            Some("user_error_variance is -0.5"),
        ),
        (slot().to_string(), None),
    ];
    let input: Vec<&str> = cases.iter().map(|(line, _)| line.as_str()).collect();
    let (answers, complaint) = solve(&[], &input.join("\n"));
    assert_eq!(answers.len(), cases.len());
    for ((line, problem), answer) in cases.iter().zip(&answers) {
        match problem {
            None => assert_eq!(answer["feasible"], true, "{answer}"),
            Some(part) => {
                let error = answer["error"]
                    .as_str()
                    .unwrap_or_else(|| panic!("{line}: {answer}"));
                assert!(error.contains(part), "{line}: {error}");
            }
        }
    }
    assert!(complaint.contains("10 of 13 lines"), "{complaint}");
}

#[test]
fn single_precision_follows_double() {
    let line = slot().to_string();
    let rate = |precision| {
        solve(&["--precision", precision], &line).0[0]["rate"]
            .as_f64()
            .unwrap()
    };
    assert!((rate("f32") / rate("f64") - 1.0).abs() < 2e-4);
}

#[test]
fn a_missing_file_is_bad_input() {
    let run = program("host-sim")
        .args(["solve", "nowhere.jsonl"])
        .assert()
        .code(2);
    let complaint = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert!(complaint.contains("nowhere.jsonl"), "{complaint}");
}

/// A line that never ends does not take all memory.
#[cfg(target_os = "linux")]
#[test]
fn a_line_without_an_end_is_the_last_one() {
    let run = program("host-sim")
        .args(["solve", "/dev/zero"])
        .assert()
        .code(2);
    let output = String::from_utf8(run.get_output().stdout.clone()).unwrap();
    assert!(
        output.contains("line 1: the line is longer than 64 MiB"),
        "{output}"
    );
    assert_eq!(output.lines().count(), 1);
}
