//! `host-sim bound`, and the flight of the mission that it finds.

use assert_cmd::assert::OutputAssertExt;
use end_to_end::program;
use serde_json::Value;
use tempfile::tempdir;

fn json(arguments: &[&str]) -> Value {
    let output = program("host-sim").args(arguments).assert().success();
    serde_json::from_slice(&output.get_output().stdout).unwrap()
}

#[test]
fn the_search_policy_flies_the_lower_bound() {
    for scenario in ["separated", "mixed"] {
        let bound = json(&["bound", "--scenario", scenario, "--json"]);
        let number = |key: &str| bound[key].as_f64().unwrap();
        assert!(number("lower") <= number("upper"));
        assert!(number("gap") <= 0.02);
        let folder = tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        let run = ["run", "--scenario", scenario, "--policy", "search"];
        let summary = json(&[&run[..], &["--json", "--out", out]].concat());
        let flown = summary["sum_rate"].as_f64().unwrap();
        assert!((flown / number("lower") - 1.0).abs() < 1e-6);
        assert_eq!(summary["arrived"], true);
        assert_eq!(summary["fair"], true);
        assert_eq!(summary["mse_violations"], 0);
        assert_eq!(summary["constraint_violations"], 0);
        assert_eq!(summary["shield_interventions"], 0);
    }
}

#[test]
fn a_mission_that_carries_nothing_is_said_to() {
    let output = program("host-sim")
        .args(["bound", "--mse-threshold", "1e-6"])
        .assert()
        .success();
    let words = String::from_utf8_lossy(&output.get_output().stdout).into_owned();
    assert!(
        words.contains("no reachable position meets the MSE threshold"),
        "{words}"
    );
    assert!(words.contains("gap       0.000 %"), "{words}");
}

#[test]
fn nonsense_is_refused_in_one_line() {
    let cases: [(&[&str], &str); 5] = [
        (&["--gap", "1.5"], "--gap is 1.5"),
        (&["--gap", "NaN"], "--gap is NaN"),
        (
            &["--mse-threshold", "0.03"],
            "separated with --mse-threshold 0.03: aircomp.mse_threshold is 0.03",
        ),
        (
            &["--slots", "100000"],
            "the mission has 100000 slots, but the bound supports at most 1000",
        ),
        (
            &["--slots", "1001"],
            "the mission has 1001 slots, but the bound supports at most 1000",
        ),
    ];
    for (arguments, expected) in cases {
        let output = program("host-sim")
            .arg("bound")
            .args(arguments)
            .assert()
            .code(2);
        let complaint = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
        assert!(complaint.contains(expected), "{complaint}");
        assert_eq!(complaint.trim_end().lines().count(), 1, "{complaint}");
    }
}
