//! What people stumbled over who used the programs with the README alone, as tests. Further ones of
//! this kind are in `bad_input.rs` and `solve.rs`, and in the trainer's `runs.rs` and `runtimes.rs`.

use std::{fs, path::Path, process::Command};

use assert_cmd::assert::OutputAssertExt;
use end_to_end::{program, repository};
use serde_json::Value;
use tempfile::tempdir;

/// Runs a program to its good end and returns what it printed on both streams.
fn said(mut command: Command) -> (String, String) {
    let assert = command.assert().success();
    let output = assert.get_output();
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    (text(&output.stdout), text(&output.stderr))
}

fn run(out: &Path, arguments: &[&str]) -> (String, String) {
    let mut command = program("host-sim");
    command.arg("run").args(arguments).arg("--out").arg(out);
    said(command)
}

fn summary(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("summary.json")).unwrap()).unwrap()
}

/// `run`, `evaluate`, the report and the summary say it of a policy of another mission; the policy
/// of this mission is taken by itself, without a word.
#[test]
fn a_policy_of_another_mission_is_announced() {
    const WARNING: &str = "trained for another mission";
    let folder = tempdir().unwrap();
    let out = folder.path();
    let policy = ["--policy", "models/separated-sac.onnx"];
    let mission = ["--mse-threshold", "0.02"];
    let (_, errors) = run(out, &[policy, mission].concat());
    assert_eq!(errors.matches(WARNING).count(), 1, "{errors}");
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains(WARNING), "the report does not say it");
    let warning = summary(out)["policy_warning"].to_string();
    assert!(warning.contains(WARNING), "{warning}");

    let mut evaluate = program("trainer");
    evaluate.args(["evaluate", policy[1]]).args(mission);
    let (_, errors) = said(evaluate);
    assert_eq!(errors.matches(WARNING).count(), 1, "{errors}");

    let (_, errors) = run(out, &mission);
    assert!(!errors.contains(WARNING), "{errors}");
    assert!(
        !fs::read_to_string(out.join("report.html"))
            .unwrap()
            .contains(WARNING)
    );
    let flown = summary(out);
    assert_eq!(flown["policy_warning"], Value::Null);
    assert_eq!(
        flown["policy"],
        "separated-t60-n95-g0.020-sac-paper-s1.onnx"
    );
}

/// The same for the controller of a board, whose policy is a file of another format.
#[test]
fn a_boards_policy_of_another_mission_is_announced() {
    const WARNING: &str = "trained for another mission";
    let folder = tempdir().unwrap();
    let (out, file) = (folder.path().join("out"), folder.path().join("sac.policy"));
    let file = file.to_str().unwrap();
    let mut convert = program("trainer");
    convert.args(["convert", "models/separated-sac.onnx", file]);
    said(convert);
    let board = ["--precision", "f32", "--policy", file];
    let (_, errors) = run(&out, &[&board[..], &["--mse-threshold", "0.02"]].concat());
    assert_eq!(errors.matches(WARNING).count(), 1, "{errors}");
    let warning = summary(&out)["policy_warning"].to_string();
    assert!(warning.contains(WARNING), "{warning}");

    let (_, errors) = run(&out, &board);
    assert!(!errors.contains(WARNING), "{errors}");
    assert_eq!(summary(&out)["policy_warning"], Value::Null);
}

/// The total of a vehicle with inertia is compared with that of the ideal vehicle.
#[test]
fn what_dynamics_cost_is_said_against_the_ideal_flight() {
    let folder = tempdir().unwrap();
    let out = folder.path();
    let policy = ["--policy", "straight-line"];
    run(out, &policy);
    let ideal = summary(out);
    assert_eq!(ideal["ideal_sum_rate"], Value::Null);
    let (table, _) = run(out, &[&policy[..], &["--profile", "multirotor"]].concat());
    let flown = summary(out);
    assert_eq!(flown["ideal_sum_rate"], ideal["sum_rate"]);
    let rate = |of: &Value| of.as_f64().unwrap();
    let share = 100.0 * rate(&flown["sum_rate"]) / rate(&ideal["sum_rate"]);
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    for text in [&table, &page] {
        assert!(text.contains(&format!("{share:.1}")), "{share}: {text}");
        assert!(
            text.contains("the same policy with the ideal vehicle"),
            "{text}"
        );
    }
    assert!(!table.contains("cost"), "{table}");
}

/// Outside the repository the policies are not where they are looked for.
#[test]
fn experiments_elsewhere_ask_for_the_models() {
    let folder = tempdir().unwrap();
    let mut command = program("host-sim");
    command
        .current_dir(folder.path())
        .args(["experiment", "noise"]);
    let assert = command.assert().code(1);
    let errors = String::from_utf8(assert.get_output().stderr.clone()).unwrap();
    assert!(errors.contains("--models DIR"), "{errors}");
    assert_eq!(errors.lines().count(), 1, "{errors}");
}

#[test]
fn a_new_scenario_has_the_asked_slots_area_start_and_destination() {
    let mut command = program("host-sim");
    command.args(["scenario", "new", "--slots", "45", "--area-m", "600,500"]);
    command.args(["--start-m", "20,30", "--destination-m", "580,470"]);
    let (text, _) = said(command);
    for line in [
        "slots = 45",
        "area_m = [600.0, 500.0]",
        "start_m = [20.0, 30.0]",
        "destination_m = [580.0, 470.0]",
    ] {
        assert!(text.contains(line), "{line}: {text}");
    }
}

#[test]
fn the_help_of_solve_names_its_input() {
    let mut command = program("host-sim");
    command.args(["solve", "--help"]);
    let (help, _) = said(command);
    for field in [
        "sensor_gain",
        "user_gain",
        "sensor_power_max",
        "user_power_max",
        "noise_power",
        "mse_threshold",
    ] {
        assert!(help.contains(field), "{field}: {help}");
    }
}

/// Reference, numbers of equations and figures, symbols, and the contract of policy files.
#[test]
fn documents_say_what_new_users_looked_for() {
    let read = |name: &str| {
        let text = fs::read_to_string(repository().join(name)).unwrap();
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let expected: [(&str, &[&str]); 5] = [
        ("README.md", &["2025", "arXiv:2507.04807"]),
        (
            "docs/mathematics.md",
            &["2025", "arXiv:2507.04807", "is strictly positive"],
        ),
        (
            "docs/glossary.md",
            &[
                "arXiv:2507.04807",
                "| eq:p1 | (19) |",
                "| eq:opteta, eq:eta_ | (30), (31) |",
                "| fig:alg | Fig. 9 |",
                "| fig:diffint | Fig. 12 |",
                "## Symbols with two meanings",
            ],
        ),
        (
            "docs/training.md",
            &[
                "highest score **among the admissible users**",
                "In slot 1 no slot has been flown",
                "All keys in this table are required except the last",
            ],
        ),
        ("docs/results.md", &["The policy `shipped`"]),
    ];
    for (name, parts) in expected {
        let text = read(name);
        for part in parts {
            assert!(text.contains(part), "{name} does not say `{part}`");
        }
    }
}
