//! The main job, as a person would start it.

use std::{fs, path::Path};

use assert_cmd::assert::OutputAssertExt;
use end_to_end::program;
use serde_json::Value;
use tempfile::tempdir;

/// Flies into `out` and returns the summary that was printed.
fn fly(out: &Path, arguments: &[&str]) -> Value {
    let output = program("host-sim")
        .arg("run")
        .args(arguments)
        .arg("--json")
        .arg("--out")
        .arg(out)
        .assert()
        .success();
    serde_json::from_slice(&output.get_output().stdout).unwrap()
}

/// What every flown mission owes.
fn assert_sound(summary: &Value) {
    assert_eq!(summary["slots"], 60, "{summary}");
    for promise in ["arrived", "fair"] {
        assert_eq!(summary[promise], true, "{promise}: {summary}");
    }
    for fault in ["mse_violations", "constraint_violations"] {
        assert_eq!(summary[fault], 0, "{fault}: {summary}");
    }
    let users = summary["users"].as_array().unwrap();
    assert_eq!(users.len(), 15, "{summary}");
    for user in users {
        assert!(user["slots"].as_u64().unwrap() >= 4, "{summary}");
    }
}

#[test]
fn the_straight_line_keeps_every_promise_on_both_topologies_and_vehicles() {
    let folder = tempdir().unwrap();
    for scenario in ["separated", "mixed"] {
        for profile in ["ideal", "multirotor"] {
            let arguments = [
                "--scenario",
                scenario,
                "--profile",
                profile,
                "--policy",
                "straight-line",
            ];
            let out = folder.path().join(format!("{scenario}-{profile}"));
            let summary = fly(&out, &arguments);
            assert_sound(&summary);
            let ratio = summary["empirical_mse_ratio"].as_f64().unwrap();
            let error = summary["empirical_mse_ratio_standard_error"]
                .as_f64()
                .unwrap();
            assert!((ratio - 1.0).abs() < 3.0 * error, "{summary}");
            for file in ["summary.json", "slots.csv", "report.html", "mavlink.tlog"] {
                assert!(fs::metadata(out.join(file)).unwrap().len() > 0, "{file}");
            }
            let written = fs::read_to_string(out.join("summary.json")).unwrap();
            assert_eq!(serde_json::from_str::<Value>(&written).unwrap(), summary);
        }
    }
}

/// The main job: the shipped policies keep every promise, and earn more than the straight line.
#[test]
fn the_shipped_policies_beat_the_straight_line() {
    let folder = tempdir().unwrap();
    for scenario in ["separated", "mixed"] {
        let rate = |policy: &str| {
            let summary = fly(folder.path(), &["--scenario", scenario, "--policy", policy]);
            assert_sound(&summary);
            (
                summary["sum_rate"].as_f64().unwrap(),
                summary["policy"].clone(),
            )
        };
        let (straight, _) = rate("straight-line");
        let (learned, policy) = rate("shipped");
        assert_eq!(policy, format!("{scenario}-sac.onnx"));
        assert!(
            learned > straight,
            "{scenario}: {learned} against {straight}"
        );
    }
}

/// Whatever the policy, a vehicle with inertia arrives.
#[test]
fn a_multirotor_arrives_from_wherever_it_hovered() {
    let folder = tempdir().unwrap();
    for policy in ["fixed", "shipped"] {
        let arguments = ["--profile", "multirotor", "--policy", policy];
        assert_sound(&fly(folder.path(), &arguments));
    }
}

/// 20,000 symbols in every slot: the empirical MSE of the mission within 3 standard errors.
#[test]
fn the_signals_agree_with_the_formula() {
    let folder = tempdir().unwrap();
    let arguments = ["--symbols", "20000", "--policy", "straight-line"];
    let summary = fly(folder.path(), &arguments);
    let ratio = summary["empirical_mse_ratio"].as_f64().unwrap();
    let error = summary["empirical_mse_ratio_standard_error"]
        .as_f64()
        .unwrap();
    assert!(error < 1e-3, "{error}");
    assert!((ratio - 1.0).abs() < 3.0 * error, "{ratio} +- {error}");
}

/// Removes what is measured with a clock.
fn without_times(summary: &mut Value) {
    let fields = summary.as_object_mut().unwrap();
    assert!(fields.remove("plan_us").is_some() && fields.remove("allocate_us").is_some());
}

/// slots.csv without its last two columns, which are times.
fn slots_without_times(out: &Path) -> Vec<String> {
    let text = fs::read_to_string(out.join("slots.csv")).unwrap();
    assert!(
        text.lines()
            .next()
            .unwrap()
            .ends_with(",plan_us,allocate_us")
    );
    let keep = |line: &str| line.rsplitn(3, ',').last().unwrap().to_owned();
    text.lines().map(keep).collect()
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let folder = tempdir().unwrap();
    let outs = ["a", "b", "c"].map(|name| folder.path().join(name));
    let mut summaries = [("1", &outs[0]), ("1", &outs[1]), ("2", &outs[2])]
        .map(|(seed, out)| fly(out, &["--seed", seed]));
    summaries.iter_mut().for_each(without_times);
    assert_eq!(summaries[0].to_string(), summaries[1].to_string());
    assert_eq!(slots_without_times(&outs[0]), slots_without_times(&outs[1]));
    let logs = outs
        .each_ref()
        .map(|out| fs::read(out.join("mavlink.tlog")).unwrap());
    assert_eq!(logs[0], logs[1]);
    // The signals follow the seed; the flight does not.
    let ratio = "empirical_mse_ratio";
    assert_ne!(summaries[0][ratio], summaries[2][ratio]);
    assert_eq!(summaries[0]["sum_rate"], summaries[2]["sum_rate"]);
}

/// A policy trained at one threshold, noise and length flies at another as asked.
#[test]
fn the_scenario_can_be_changed_from_the_command_line() {
    let folder = tempdir().unwrap();
    let changes = ["--mse-threshold", "0.025", "--noise-dbm", "-85"];
    let changed = fly(&folder.path().join("changed"), &changes);
    assert_sound(&changed);
    assert_eq!(changed["mse_threshold"], 0.025);
    // The policy of the figures that was trained for this very mission.
    assert_eq!(
        changed["policy"],
        "separated-t60-n85-g0.025-sac-paper-s1.onnx"
    );
    let plain = fly(&folder.path().join("plain"), &["--mse-threshold", "0.025"]);
    let rate = |summary: &Value| summary["sum_rate"].as_f64().unwrap();
    assert!(rate(&changed) < rate(&plain), "more noise, less rate");
    let longer = fly(&folder.path().join("longer"), &["--slots", "61"]);
    assert_eq!(longer["slots"], 61);
}

/// With a key on both ends the same mission is flown: the summary differs in the counters of
/// authentication only, which are absent without a key.
#[cfg(unix)]
#[test]
fn a_key_of_the_ground_link_changes_nothing_but_its_counters() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempdir().unwrap();
    let key = folder.path().join("ground.key");
    fs::write(&key, "5a".repeat(32) + "\n").unwrap();
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
    let key = key.display().to_string();
    for precision in ["f64", "f32"] {
        let arguments = ["--policy", "straight-line", "--precision", precision];
        let fly = |name: &str, more: &[&str]| {
            let out = folder.path().join(format!("{name}-{precision}"));
            let mut summary = fly(&out, &[&arguments[..], more].concat());
            for timing in ["plan_us", "allocate_us"] {
                summary.as_object_mut().unwrap().remove(timing);
            }
            summary
        };
        let open = fly("open", &[]);
        assert!(open["link"].get("security").is_none(), "{open}");
        let mut keyed = fly("keyed", &["--ground-key", &key]);
        let link = keyed["link"].as_object_mut().unwrap();
        let security = link.remove("security").unwrap();
        for end in ["vehicle", "ground"] {
            assert_eq!(security[end]["sessions"], 1, "{security}");
            for refused in [
                "unauthenticated",
                "forged",
                "other_session",
                "replayed",
                "reflected",
            ] {
                assert_eq!(security[end][refused], 0, "{security}");
            }
        }
        // The ground receives the vehicle's counters as further messages.
        let messages = |summary: &Value| summary["link"]["ground"]["messages"].as_u64().unwrap();
        assert_eq!(messages(&keyed), messages(&open) + 60);
        keyed["link"]["ground"]["messages"] = open["link"]["ground"]["messages"].clone();
        assert_eq!(keyed, open);
    }
}
