//! Worlds that are not known exactly, flown as a user would fly them.

mod program;

use std::{
    fs,
    path::{Path, PathBuf},
};

use program::{host_sim, json, number, refusal, text};
use scenario::Scenario;
use serde_json::Value;
use tempfile::tempdir;

/// Writes the mission `mixed` with this `[uncertainty]` table.
fn mission(folder: &Path, uncertainty: &str) -> PathBuf {
    let shipped = Scenario::shipped("mixed").expect("shipped").to_toml();
    let file = folder.join("world.toml");
    fs::write(&file, format!("{shipped}\n[uncertainty]\n{uncertainty}\n")).expect("written");
    file
}

fn run(uncertainty: &str, more: &[&str]) -> (Value, String) {
    let folder = tempdir().expect("a folder");
    let file = mission(folder.path(), uncertainty);
    let out = folder.path().join("out");
    let mut arguments = vec!["run", "--json"];
    arguments.extend(["--scenario", text(&file), "--out", text(&out)]);
    arguments.extend(more);
    if !more.contains(&"--policy") {
        arguments.extend(["--policy", "straight-line"]);
    }
    if !more.contains(&"--symbols") {
        arguments.extend(["--symbols", "200"]);
    }
    let summary = json(&arguments);
    (
        summary,
        fs::read_to_string(out.join("slots.csv")).expect("slots.csv"),
    )
}

/// Issue 18's list of bad values, and what else a table can get wrong: one line with file, field,
/// value and what would be right.
#[test]
fn bad_values_are_named() {
    let folder = tempdir().expect("a folder");
    for (uncertainty, words) in [
        (
            "sensor_error_variance = -0.1",
            "uncertainty.sensor_error_variance is -0.1, but must be a relative variance from 0 to 10",
        ),
        (
            "sensor_error_variance = [0.1, 0.2]",
            "uncertainty.sensor_error_variance has 2 entries, but must be one number or have one for each of the 36 nodes",
        ),
        (
            "sensor_error_variance = \"much\"",
            "uncertainty.sensor_error_variance: invalid type: string \"much\", expected a number or a list of numbers",
        ),
        (
            "user_error_variance = nan",
            "uncertainty.user_error_variance is NaN",
        ),
        (
            "sensor_phase_error_rad = 3.2",
            "uncertainty.sensor_phase_error_rad is 3.2, but must be a standard deviation from 0 to pi rad",
        ),
        (
            "silence_probability = 1.1",
            "uncertainty.silence_probability is 1.1, but must be a probability from 0 to 1",
        ),
        (
            "silence_probability = -0.1",
            "uncertainty.silence_probability is -0.1",
        ),
        (
            "state_loss_probability = 2.0",
            "uncertainty.state_loss_probability is 2, but must be a probability",
        ),
        (
            "rician_k_db = inf",
            "uncertainty.rician_k_db is inf, but must be from -40 to 60 dB",
        ),
        (
            "fading_decorrelation_m = 1.0",
            "there is no fading without uncertainty.rician_k_db",
        ),
        ("shadowing_db = -1.0", "uncertainty.shadowing_db is -1"),
        (
            "position_error_m = -1.0",
            "uncertainty.position_error_m is -1",
        ),
        (
            "wind_mps = 100.0",
            "uncertainty.wind_mps is 100, but must be a speed from 0 to 30 m/s",
        ),
        (
            "motion = { model = \"random-waypoint\" }",
            "uncertainty.motion.speed_mps is missing, but uncertainty.motion.model \"random-waypoint\" needs it",
        ),
        (
            "motion = { model = \"file\", csv = \"a.csv\", speed_mps = 3.0 }",
            "uncertainty.motion.speed_mps is given, but must not be",
        ),
        (
            "motion = { model = \"file\", csv = \"none.csv\" }",
            "uncertainty.motion.csv: ",
        ),
        (
            "motion = { model = \"brown\", speed_mps = 3.0 }",
            "unknown variant `brown`",
        ),
        ("sensor_error = 0.1", "unknown field `sensor_error`"),
    ] {
        let file = mission(folder.path(), uncertainty);
        let error = refusal(&["run", "--scenario", text(&file)]);
        assert!(error.contains("world.toml: "), "{error}");
        assert!(error.contains(words), "{uncertainty}: {error}");
    }
}

/// An event that moves a user is refused where `motion` moves the users.
#[test]
fn an_event_and_a_motion_of_one_node_are_refused() {
    let folder = tempdir().expect("a folder");
    let events = folder.path().join("events.toml");
    fs::write(
        &events,
        "[[event]]\nslot = 9\nuser = 3\nposition_m = [1.0, 2.0]\n",
    )
    .expect("written");
    let file = mission(
        folder.path(),
        "motion = { model = \"gauss-markov\", speed_mps = 2.0 }",
    );
    let error = refusal(&["run", "--scenario", text(&file), "--events", text(&events)]);
    let words = "events.toml: slot 9: user 3 is at [1, 2] m, but the scenario's uncertainty.motion moves it, too";
    assert!(error.contains(words), "{error}");
}

/// An empty table is today's world: the same files, and nothing about knowledge in them.
#[test]
fn an_empty_table_changes_nothing() {
    let (summary, slots) = run("", &[]);
    assert_eq!(summary.get("knowledge"), None);
    assert!(!slots.contains("perfect_rate"), "{slots}");
}

/// The errors of a channel break `Gamma` in every slot of a vehicle that ignores them, and in none of
/// one that knows them, at the cost of some rate.
#[test]
fn robust_flights_keep_gamma_and_naive_ones_do_not() {
    const MANY: [&str; 2] = ["--symbols", "4000"];
    let errors =
        "sensor_error_variance = 0.05\nuser_error_variance = 0.05\nsensor_phase_error_rad = 0.3";
    let (robust, slots) = run(errors, &MANY);
    let header = slots.lines().next().expect("a header");
    assert!(
        header.ends_with(
            "plan_us,allocate_us,perfect_rate_bit_s_hz,empirical_mse_standard_error,at_error_floor"
        ),
        "{header}"
    );
    let (naive, _) = run(errors, &["--symbols", "4000", "--ignore-errors"]);
    let of = |summary: &Value, key| number(&summary["knowledge"], key);
    assert_eq!((of(&robust, "outage"), of(&naive, "outage")), (0.0, 1.0));
    assert!(of(&naive, "empirical_outage") > 0.9);
    assert!(of(&robust, "empirical_outage") < 0.05);
    assert_eq!(naive["knowledge"]["errors_ignored"], true);
    let lost = of(&robust, "rate_lost");
    let total = number(&robust, "sum_rate");
    assert!(lost > 0.0 && lost < total, "{lost} of {total}");
    assert!((total + lost - of(&robust, "perfect_sum_rate")).abs() < 1e-9);
    for summary in [&robust, &naive] {
        let ratio = number(summary, "empirical_mse_ratio");
        let deviation = number(summary, "empirical_mse_ratio_standard_error");
        assert!(
            (ratio - 1.0).abs() < 3.0 * deviation,
            "{ratio} +- {deviation}"
        );
    }
}

/// Where the estimates are too poor for `Gamma`, the record says so, and does not name a lack of power.
#[test]
fn an_error_floor_is_told_from_a_lack_of_power() {
    let (summary, slots) = run("sensor_phase_error_rad = 1.4", &[]);
    assert_eq!(number(&summary["knowledge"], "error_floor_slots"), 60.0);
    assert!(
        slots.lines().skip(1).all(|line| line.ends_with(",true")),
        "{slots}"
    );
    let (summary, _) = run("silence_probability = 1.0", &[]);
    assert_eq!(number(&summary["knowledge"], "error_floor_slots"), 0.0);
    assert_eq!(number(&summary["knowledge"], "outage"), 1.0);
}

/// States that are lost or late are replaced by aged ones, and the constraints hold.
#[test]
fn a_bad_ground_link_is_flown_on_aged_states() {
    let (known, _) = run("", &[]);
    for (link, expected) in [
        ("state_loss_probability = 0.2", 3.0..=22.0),
        ("state_delay_s = 0.4", 0.0..=0.0),
    ] {
        let (summary, slots) = run(link, &[]);
        let aged = slots
            .lines()
            .filter(|line| line.contains(",predicted,"))
            .count();
        assert!(expected.contains(&(aged as f64)), "{link}: {aged}");
        assert_eq!(summary["constraint_violations"], 0, "{link}");
        assert_eq!(summary["mse_violations"], 0, "{link}");
        assert!(
            number(&summary, "sum_rate") <= number(&known, "sum_rate"),
            "{link}"
        );
    }
}

/// A state that comes later than the vehicle waits is of no use: to the failsafe the ground is silent.
#[test]
fn states_that_are_always_too_late_are_a_silent_ground() {
    let folder = tempdir().expect("a folder");
    let file = mission(folder.path(), "state_delay_s = 0.6");
    let out = folder.path().join("out");
    let flown = host_sim(&["run", "--scenario", text(&file), "--out", text(&out)]);
    let errors = String::from_utf8_lossy(&flown.stderr);
    assert_eq!(flown.status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("aborted after 10 of 60 slots: ground link silent"),
        "{errors}"
    );
}

/// Walking users, displaced nodes, fading and shadowing at once: the flight arrives and is fair, the
/// same again with the same seed and another one with another seed.
#[test]
fn a_whole_unkind_world_is_flown() {
    let world = |seed: u32| {
        format!(
            "seed = {seed}\nrician_k_db = 9.0\nshadowing_db = 4.0\nsilence_probability = 0.02\n\
             position_error_m = 15.0\nmotion = {{ model = \"random-waypoint\", speed_mps = 5.0 }}\n\
             sensor_error_variance = 0.02\nstate_loss_probability = 0.05"
        )
    };
    let flown = |seed| {
        let (summary, _) = run(&world(seed), &["--policy", "plan"]);
        for promise in ["arrived", "fair"] {
            assert_eq!(summary[promise], true, "{promise}: {summary}");
        }
        assert_eq!(summary["constraint_violations"], 0);
        assert!(number(&summary, "mission_changes") > 100.0);
        number(&summary, "sum_rate")
    };
    let total = flown(1);
    assert_eq!(total, flown(1));
    assert_ne!(total, flown(2));
}
