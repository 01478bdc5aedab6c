//! `host-sim plan`, `run --policy plan`, `scenario random` and `benchmark`, started as a user would
//! start them.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use serde_json::Value;
use tempfile::tempdir;

fn host_sim(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .args(arguments)
        .output()
        .expect("it starts")
}

fn succeeds(arguments: &[&str]) -> String {
    let output = host_sim(arguments);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(output.stdout).expect("text")
}

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&succeeds(arguments)).expect("JSON")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a printable path")
}

/// Writes a small random mission to a file.
fn random_mission(folder: &Path, seed: u64) -> String {
    let seed = seed.to_string();
    succeeds(&["scenario", "random", "--seed", &seed, "--out", text(folder)]);
    let file = folder.join(format!(
        "random-{:04}.toml",
        seed.parse::<u64>().expect("a seed")
    ));
    text(&file).to_owned()
}

#[test]
fn the_plan_is_flown_as_promised_and_close_to_the_search() {
    let folder = tempdir().expect("a folder");
    let out = text(folder.path());
    let separated = ["--scenario", "separated", "--json"];
    let planned = json(&[&["plan"][..], &separated].concat());
    let number = |value: &Value, key: &str| value[key].as_f64().expect("a number");
    assert!(number(&planned, "gap_estimate") < 0.02);
    assert_eq!(planned["waypoints"].as_array().map(Vec::len), Some(60));
    let run = |policy: &str| {
        let summary = json(&[&["run", "--policy", policy, "--out", out][..], &separated].concat());
        for promise in ["arrived", "fair"] {
            assert_eq!(summary[promise], true, "{promise}: {summary}");
        }
        for fault in [
            "mse_violations",
            "constraint_violations",
            "shield_interventions",
        ] {
            assert_eq!(summary[fault], 0, "{fault}: {summary}");
        }
        number(&summary, "sum_rate")
    };
    // The plan may still be improved in flight, and never gets worse.
    let flown = run("plan");
    assert!(
        flown >= number(&planned, "sum_rate") * (1.0 - 1e-6),
        "{flown}"
    );
    assert!(flown >= run("search") * 0.995, "{flown}");
}

/// Without a trained policy the planner flies, and achieves more than the straight line.
#[test]
fn the_planner_is_the_default_of_a_map_of_ones_own() {
    let folder = tempdir().expect("a folder");
    let mission = random_mission(folder.path(), 8);
    let out = text(folder.path());
    let run = |arguments: &[&str]| {
        let fixed = ["run", "--scenario", &mission, "--out", out, "--json"];
        json(&[&fixed[..], arguments].concat())
    };
    let (default, straight) = (run(&[]), run(&["--policy", "straight-line"]));
    assert_eq!(default["policy"], "plan");
    assert_eq!(default["constraint_violations"], 0);
    let rate = |summary: &Value| summary["sum_rate"].as_f64().expect("a number");
    assert!(rate(&default) > 1.05 * rate(&straight), "{default}");
    let multirotor = run(&["--profile", "multirotor"]);
    assert_eq!(multirotor["constraint_violations"], 0, "{multirotor}");
    assert!(rate(&multirotor) > 0.95 * rate(&default), "{multirotor}");
}

#[test]
fn the_same_mission_gives_the_same_plan() {
    let folder = tempdir().expect("a folder");
    let mission = random_mission(folder.path(), 21);
    let plan = || {
        let mut plan = json(&["plan", "--scenario", &mission, "--json"]);
        plan["seconds"] = Value::Null;
        plan
    };
    assert_eq!(plan(), plan());
}

/// The file contains take-off, speed, the waypoints of the mission at their positions, and landing.
#[test]
fn the_plan_file_is_what_qgroundcontrol_reads() {
    let folder = tempdir().expect("a folder");
    let file = folder.path().join("separated.plan");
    succeeds(&["plan", "--out", text(&file)]);
    let plan: Value =
        serde_json::from_str(&fs::read_to_string(&file).expect("written")).expect("JSON");
    assert_eq!(plan["fileType"], "Plan");
    assert_eq!(plan["version"], 1);
    let mission = &plan["mission"];
    assert_eq!(mission["version"], 2);
    let items = mission["items"].as_array().expect("items");
    assert_eq!(items.len(), 63);
    let command = |index: usize| items[index]["command"].as_u64().expect("a number");
    assert_eq!(
        [command(0), command(1), command(2), command(62)],
        [22, 178, 16, 21]
    );
    for (index, item) in items.iter().enumerate() {
        assert_eq!(item["doJumpId"], index as u64 + 1);
        assert_eq!(item["params"].as_array().map(Vec::len), Some(7));
        let frame = if index == 1 { 2 } else { 3 };
        assert_eq!(item["frame"], frame);
        if index != 1 {
            let degrees = |place: usize| item["params"][place].as_f64().expect("a number");
            assert!((degrees(4) + 35.36).abs() < 0.01 && (degrees(5) - 149.17).abs() < 0.01);
        }
    }
    assert_eq!(items[30]["Altitude"], 100.0);
}

#[test]
fn nonsense_is_refused_in_one_line() {
    let folder = tempdir().expect("a folder");
    let cases: [(&[&str], &str); 5] = [
        (
            &[
                "benchmark",
                "--first",
                "1",
                "--missions",
                "../benchmarks",
                "--page",
                "no/such/p.html",
            ],
            "--page no/such/p.html: must be a file in a directory that exists",
        ),
        (&["plan", "--out", "x.txt"], "must end in .plan"),
        (&["plan", "--scenario", "nowhere.toml"], "nowhere.toml"),
        (&["scenario", "random", "--count", "2"], "needs --out DIR"),
        (
            &["benchmark", "--missions", text(folder.path())],
            "contains no scenario",
        ),
    ];
    for (arguments, expected) in cases {
        let output = host_sim(arguments);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {errors}");
        assert!(errors.contains(expected), "{errors}");
        assert_eq!(errors.lines().count(), 1, "{errors}");
    }
}

/// Two missions are certified and flown; a second call repeats no flight.
#[test]
fn the_benchmark_compares_policies_with_bounds_and_resumes() {
    let folder = tempdir().expect("a folder");
    for seed in [21, 30] {
        random_mission(folder.path(), seed);
    }
    let missions = text(folder.path());
    succeeds(&["benchmark", "--missions", missions, "--certify"]);
    let bounds = fs::read_to_string(folder.path().join("bounds.csv")).expect("written");
    assert_eq!(bounds.lines().count(), 3, "{bounds}");
    let results = folder.path().join("results.csv");
    let arguments = [
        "benchmark",
        "--missions",
        missions,
        "--results",
        text(&results),
        "--json",
    ];
    let found = json(&arguments);
    let number = |row: usize, key: &str| found[row][key].as_f64().expect("a number");
    assert_eq!(found[0]["policy"], "plan");
    assert_eq!(found[0]["counted"], 2);
    assert_eq!(found[0]["violations"], 0);
    assert!(
        number(0, "worst") > 0.98 && number(0, "mean") <= 1.0,
        "{found}"
    );
    assert!(number(1, "mean") < number(0, "mean"), "{found}");
    let flights = || fs::read_to_string(&results).expect("written");
    let before = flights();
    assert_eq!(before.lines().count(), 5);
    assert_eq!(json(&arguments), found);
    assert_eq!(flights(), before);

    let document = folder.path().join("table.md");
    fs::write(
        &document,
        "above\n<!-- benchmark ideal --><!-- /benchmark ideal -->\nbelow\n",
    )
    .expect("written");
    let table = ["--results", text(&results), "--document", text(&document)];
    succeeds(&[&["benchmark", "--missions", missions], &table[..]].concat());
    let written = fs::read_to_string(&document).expect("readable");
    let rows: Vec<&str> = written.lines().filter(|row| row.starts_with('|')).collect();
    assert_eq!(rows.len(), 4, "{written}");
    assert!(rows[2].starts_with("| plan | 2 | 2 | 0.9"), "{written}");
    let columns = |row: &str| row.matches('|').count();
    assert!(rows.iter().all(|row| columns(row) == columns(rows[0])));

    // The same flights by groups, under another name.
    fs::write(
        &document,
        "<!-- benchmark ideal -->kept<!-- /benchmark ideal -->\n\
         <!-- benchmark two groups --><!-- /benchmark two groups -->\n",
    )
    .expect("written");
    let groups = [&table[..], &["--groups", "--table", "two", "--json"]].concat();
    let by_group = json(&[&["benchmark", "--missions", missions], &groups[..]].concat());
    assert_eq!(by_group[0]["group"], "all");
    assert_eq!(by_group[0]["mean"], found[0]["mean"]);
    assert_eq!(by_group[1]["policy"], "straight-line");
    let names = by_group.as_array().expect("rows");
    let has = |name: &str| names.iter().any(|row| row["group"] == name);
    assert!(!has("layouts unknown"), "{by_group}");
    let layouts = ["uniform", "clustered", "ring", "line", "corner"];
    assert!(layouts.iter().any(|layout| has(&format!("users {layout}"))));
    let written = fs::read_to_string(&document).expect("readable");
    assert!(written.contains("-->kept<!--"), "{written}");
    let rows: Vec<&str> = written.lines().filter(|row| row.starts_with('|')).collect();
    assert_eq!(rows.len(), 2 + names.len(), "{written}");
    assert!(rows[2].starts_with("| all | plan | 2 | 0.9"), "{written}");

    // With a body, the flights of the ideal vehicle are known already.
    let page = folder.path().join("page.html");
    let written = ["--results", text(&results), "--page", text(&page), "--json"];
    let with_body = ["benchmark", "--missions", missions, "--profile", "px4"];
    let found = json(&[&with_body[..], &written].concat());
    let of_ideal = found[0]["ideal_mean"].as_f64().expect("a number");
    assert!(0.9 < of_ideal && of_ideal < 1.0, "{found}");
    assert_eq!(flights().lines().count(), before.lines().count() + 4);
    let page = fs::read_to_string(&page).expect("written");
    for expected in [
        "of ideal",
        "random-0021",
        "fraction of the certified bound",
        "px4",
    ] {
        assert!(page.contains(expected), "{expected}");
    }
}

/// `run --bound` takes the bound of a file beside the scenario, or computes it, and states the
/// fraction that the flight reached.
#[test]
fn a_flight_is_compared_with_its_certified_bound() {
    let folder = tempdir().expect("a folder");
    let mission = random_mission(folder.path(), 30);
    let out = folder.path().join("out");
    let flown = || {
        let options = ["--policy", "plan", "--bound", "--json", "--out", text(&out)];
        json(&[&["run", "--scenario", &mission][..], &options].concat())
    };
    let computed = flown();
    assert_eq!(computed["certified_bound"]["file"], Value::Null);
    succeeds(&["benchmark", "--missions", text(folder.path()), "--certify"]);
    let read = flown();
    let file = read["certified_bound"]["file"].as_str().expect("a file");
    assert!(file.ends_with("bounds.csv"), "{file}");
    for summary in [computed, read] {
        let number = |value: &Value| value.as_f64().expect("a number");
        let upper = number(&summary["certified_bound"]["upper"]);
        let fraction = number(&summary["fraction_of_bound"]);
        assert!((0.98..=1.0).contains(&fraction), "{summary}");
        assert!((number(&summary["sum_rate"]) / upper - fraction).abs() < 1e-12);
        let report = fs::read_to_string(out.join("report.html")).expect("written");
        assert!(report.contains("certified bound"));
    }
}

/// Planning that is cut off at once has the fair straight line; more time gives a better plan, and
/// a directory provides the policy that was trained for the mission, or none.
#[test]
fn policies_with_little_time_or_from_a_directory_fly() {
    let folder = tempdir().expect("a folder");
    let total = |arguments: &[&str]| {
        let out = folder.path().join("out");
        let run = ["run", "--json", "--out", text(&out)];
        let summary = json(&[&run, arguments].concat());
        assert_eq!(summary["constraint_violations"], 0);
        let policy = summary["policy"].as_str().expect("a name").to_owned();
        (summary["sum_rate"].as_f64().expect("a number"), policy)
    };
    let policy = |policy: &str| total(&["--policy", policy]);
    let at_once = policy("plan-once:0").0;
    let (within, name) = policy("plan-once:0.2");
    assert_eq!(name, "plan-once:0.2");
    let (once, name) = policy("plan-once");
    assert_eq!(name, "plan-once");
    assert!(
        at_once <= within && within <= once && at_once < once,
        "{at_once} {within} {once}"
    );

    let refused = |policy: &str, expected: &str| {
        let output = host_sim(&["run", "--policy", policy]);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains(expected), "{errors}");
    };
    for wrong in ["-1", "soon", "1e9", "NaN"] {
        let expected = format!("the time of planning is {wrong}, but must be 0 to 3600 seconds");
        refused(&format!("plan-once:{wrong}"), &expected);
    }
    let models = folder.path().join("models");
    fs::create_dir(&models).expect("created");
    refused(text(&models), "was trained for the mission separated");
    #[cfg(feature = "onnx")]
    {
        for name in ["mixed-sac.onnx", "separated-ddpg.onnx"] {
            let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
            fs::copy(shipped.join(name), models.join(name)).expect("copied");
        }
        let of_file = policy(text(&models.join("separated-ddpg.onnx"))).0;
        assert_eq!(
            policy(text(&models)),
            (of_file, "separated-ddpg.onnx".into())
        );
    }
}

/// A run's own `slots.csv` and a `.plan` file are flown again as they were: by number, slot by slot.
#[test]
fn waypoints_that_were_planned_elsewhere_are_flown() {
    let folder = tempdir().expect("a folder");
    let [first, again, plan] =
        ["first", "again", "mission.plan"].map(|name| folder.path().join(name));
    let run =
        |policy: &str, out: &Path| json(&["run", "--json", "--policy", policy, "--out", text(out)]);
    let flown = run("straight-line", &first);
    let slots = first.join("slots.csv");
    let flown_again = run(text(&slots), &again);
    assert_eq!(flown_again["policy"], "slots.csv");
    let total = |summary: &Value| summary["sum_rate"].as_f64().expect("a number");
    assert!((total(&flown_again) / total(&flown) - 1.0).abs() < 1e-6);

    succeeds(&["plan", "--out", text(&plan)]);
    let planned = run("plan", &first);
    let from_file = run(text(&plan), &again);
    assert!(
        (total(&from_file) / total(&planned) - 1.0).abs() < 2e-3,
        "{from_file}"
    );
    assert_eq!(from_file["constraint_violations"], 0);

    let refused = host_sim(&["run", "--slots", "70", "--policy", text(&plan)]);
    assert_eq!(refused.status.code(), Some(2));
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        said.contains("mission.plan: has 60 waypoints, but the mission has 70 slots"),
        "{said}"
    );
}
