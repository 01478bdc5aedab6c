//! Missions with the channel models of 3GPP TR 36.777 and with maps of gains, started as a user
//! would start them.

mod program;

use std::{
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

use firmware_core::{Position, channel::GroundNode};
use program::{host_sim, json, number, refusal, text};
use scenario::Scenario;
use serde_json::Value;
use tempfile::tempdir;

/// Writes a short mission with these lines in place of those on the paper's radio model.
fn mission(folder: &Path, name: &str, radio: &str, altitude_m: f64) -> PathBuf {
    let paper =
        "environment = { a = 9.613, b = 0.158 }\nexcess_loss_db = { los = 1.0, nlos = 20.0 }\n";
    let shipped = Scenario::shipped("mixed").expect("shipped").to_toml();
    assert!(shipped.contains(paper), "{shipped}");
    let altitude = format!("altitude_m = {altitude_m:?}");
    let changed = shipped
        .replace(paper, radio)
        .replace("altitude_m = 100.0", &altitude)
        .replace("slots = 60", "slots = 45");
    let file = folder.join(format!("{name}.toml"));
    fs::write(&file, changed).expect("written");
    file
}

/// Plans and flies a mission, and checks that the flight keeps the plan's promises.
fn flown(file: &Path) -> Value {
    let out = tempdir().expect("a folder");
    let planned = json(&["plan", "--scenario", text(file), "--json"]);
    let flown = json(&[
        "run",
        "--policy",
        "plan",
        "--scenario",
        text(file),
        "--out",
        text(out.path()),
        "--json",
    ]);
    for promise in ["arrived", "fair"] {
        assert_eq!(flown[promise], true, "{promise}: {flown}");
    }
    let (planned, total) = (number(&planned, "sum_rate"), number(&flown, "sum_rate"));
    assert!(total > 0.0, "{flown}");
    assert!((total / planned - 1.0).abs() < 0.02, "{planned} {total}");
    let page = fs::read_to_string(out.path().join("report.html")).expect("written");
    let names_model = page.contains("Radio model");
    assert_eq!(
        names_model,
        fs::read_to_string(file).unwrap().contains("model =")
    );
    flown
}

/// Each model is planned, flown and certified, and gives another total.
#[test]
fn a_mission_flies_with_each_model() {
    let folder = tempdir().expect("a folder");
    let mut totals = Vec::new();
    for (model, altitude_m) in [("uma-av", 90.0), ("umi-av", 60.0), ("rma-av", 35.0)] {
        let radio = format!("model = \"{model}\"\n");
        let file = mission(folder.path(), model, &radio, altitude_m);
        totals.push(number(&flown(&file), "sum_rate"));
        // What is certified at once is a bound, if a loose one.
        let arguments = [
            "bound",
            "--time-limit",
            "0",
            "--json",
            "--scenario",
            text(&file),
        ];
        let bound = json(&arguments);
        assert!(
            number(&bound, "upper") >= totals[totals.len() - 1],
            "{bound}"
        );
    }
    assert!(
        totals[0] != totals[1] && totals[1] != totals[2],
        "{totals:?}"
    );
    let rows = json(&["benchmark", "--missions", text(folder.path()), "--json"]);
    assert_eq!(rows[0]["flown"], 3, "{rows}");
    assert_eq!(rows[0]["violations"], 0, "{rows}");
}

#[test]
fn keys_that_do_not_fit_the_model_are_refused() {
    let folder = tempdir().expect("a folder");
    let paper =
        "environment = { a = 9.613, b = 0.158 }\nexcess_loss_db = { los = 1.0, nlos = 20.0 }\n";
    for (radio, altitude_m, expected) in [
        (
            format!("model = \"uma-av\"\n{paper}"),
            90.0,
            "radio.environment is given, but must not be: radio.model \"uma-av\" does not use it",
        ),
        (
            "environment = { a = 9.613, b = 0.158 }\n".to_owned(),
            90.0,
            "radio.excess_loss_db is missing, but radio.model \"probabilistic-los\" needs it",
        ),
        (
            "model = \"urban\"\n".to_owned(),
            90.0,
            "unknown variant `urban`, expected one of `probabilistic-los`, `uma-av`, `umi-av`, `rma-av`",
        ),
        (
            "model = \"umi-av\"\n".to_owned(),
            20.0,
            "mission.altitude_m is 20, but must be above 22.5 and at most 300 m for radio.model \
             \"umi-av\"",
        ),
        (
            "model = \"rma-av\"\n".to_owned(),
            301.0,
            "mission.altitude_m is 301, but must be above 10 and at most 300 m for radio.model \
             \"rma-av\"",
        ),
    ] {
        let file = mission(folder.path(), "wrong", &radio, altitude_m);
        let problem = refusal(&["plan", "--scenario", text(&file)]);
        assert!(problem.contains(expected), "{problem}");
        assert!(problem.contains("wrong.toml"), "{problem}");
    }
}

/// The entries of a map: node, number, east, north and gain.
type Entry = (&'static str, usize, f64, f64, f64);

/// Returns the gains of the channel model on a grid; those of users times `factor` of the place.
fn map_of(file: &Path, factor: impl Fn(f64, f64) -> f64) -> Vec<Entry> {
    let mission = Scenario::load(file).expect("valid").mission;
    let mut entries = Vec::new();
    let nodes = (0..mission.user_count())
        .map(|user| ("user", user, GroundNode::User(user)))
        .chain((0..mission.sensor_count()).map(|j| ("sensor", j, GroundNode::Sensor(j))));
    for (name, index, node) in nodes {
        for row in 0..=25 {
            for column in 0..=25 {
                let (east, north) = (40.0 * f64::from(column), 40.0 * f64::from(row));
                let gain = mission.power_gain(node, &Position::new(east, north)).0;
                let factor = if name == "user" {
                    factor(east, north)
                } else {
                    1.0
                };
                entries.push((name, index, east, north, gain * factor));
            }
        }
    }
    entries
}

fn write_map(file: &Path, entries: &[Entry]) {
    let mut csv = "node,index,east_m,north_m,power_gain\n".to_owned();
    for (node, index, east, north, gain) in entries {
        writeln!(csv, "{node},{index},{east},{north},{gain:e}").expect("text");
    }
    fs::write(file, csv).expect("written");
}

const PAPER: &str =
    "environment = { a = 9.613, b = 0.158 }\nexcess_loss_db = { los = 1.0, nlos = 20.0 }\n";

/// A map of the channel model's own gains gives nearly the same flight, and the plan keeps away from
/// where a map has little gain.
#[test]
fn a_map_of_gains_is_planned_with_and_flown() {
    let folder = tempdir().expect("a folder");
    let plain = mission(folder.path(), "plain", PAPER, 100.0);
    let named = format!("{PAPER}gain_map = \"gains.csv\"\n");
    let total = number(&flown(&plain), "sum_rate");
    write_map(
        &folder.path().join("gains.csv"),
        &map_of(&plain, |_, _| 1.0),
    );
    let mapped = mission(folder.path(), "mapped", &named, 100.0);
    let by_map = flown(&mapped);
    let ratio = number(&by_map, "sum_rate") / total;
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    let digest = by_map["scenario_digest"].clone();

    // Users lose 17 dB west of 500 m.
    let weak = |east: f64, _| if east < 500.0 { 0.02 } else { 1.0 };
    write_map(&folder.path().join("gains.csv"), &map_of(&plain, weak));
    let avoiding = flown(&mapped);
    assert!(number(&avoiding, "sum_rate") < 0.99 * total);
    assert_ne!(
        avoiding["scenario_digest"], digest,
        "the gains are part of the mission"
    );
    let planned = json(&["plan", "--scenario", text(&mapped), "--json"]);
    let usual = json(&["plan", "--scenario", text(&plain), "--json"]);
    let western = |plan: &Value| {
        let waypoints = plan["waypoints"].as_array().expect("waypoints");
        let west = |place: &&Value| place[0].as_f64().expect("east") < 500.0;
        waypoints.iter().filter(west).count()
    };
    assert!(western(&planned) < western(&usual), "{planned} {usual}");

    // A copy of the scenario elsewhere has the same mission.
    let scenario = Scenario::load(&mapped).expect("valid");
    let copy = tempdir().expect("a folder");
    let copied = Scenario::parse_in("copy", &scenario.to_toml(), copy.path()).expect("valid");
    assert_eq!(copied.digest(), scenario.digest());
    assert_eq!(copied.mission, scenario.mission);
    let louder = scenario.with_noise_dbm(-90.0).expect("valid");
    assert!(louder.mission.has_gain_map());
    let problem = Scenario::parse("text", &scenario.to_toml()).expect_err("no folder");
    assert!(problem.contains("radio.gain_map is "), "{problem}");

    let problem = refusal(&["bound", "--scenario", text(&mapped)]);
    assert!(
        problem.contains("missions with a map of gains cannot be certified"),
        "{problem}"
    );
    let out = folder.path().join("run");
    let on_board = |option: [&str; 2]| {
        let run = [
            "run",
            "--policy",
            "plan",
            "--scenario",
            text(&mapped),
            "--out",
            text(&out),
        ];
        refusal(&[&run[..], &option].concat())
    };
    for option in [["--precision", "f32"], ["--controller", "tcp:127.0.0.1:1"]] {
        let problem = on_board(option);
        assert!(
            problem.contains("a board's order cannot carry it"),
            "{problem}"
        );
    }
    let events = copy.path().join("events.toml");
    fs::write(
        &events,
        "[[event]]\nslot = 9\nuser = 3\nposition_m = [5, 5]\n",
    )
    .expect("written");
    let problem = on_board(["--events", text(&events)]);
    let expected =
        "event 1 (slot 9): user 3 moves or joins, but radio.gain_map has gains for the places";
    assert!(problem.contains(expected), "{problem}");

    fs::remove_file(&plain).expect("removed");
    let rows = json(&["benchmark", "--missions", text(folder.path()), "--json"]);
    assert_eq!(rows[0]["flown"], 1, "{rows}");
    assert_eq!(rows[0]["violations"], 0, "{rows}");
}

#[test]
fn a_bad_map_is_refused_with_what_would_be_right() {
    let folder = tempdir().expect("a folder");
    let plain = mission(folder.path(), "plain", PAPER, 100.0);
    let named = format!("{PAPER}gain_map = \"gains.csv\"\n");
    let mapped = mission(folder.path(), "mapped", &named, 100.0);
    let map = folder.path().join("gains.csv");
    let refused = || refusal(&["plan", "--scenario", text(&mapped)]);
    let expect = |expected: &str| {
        let problem = refused();
        assert!(
            problem.contains("mapped.toml: radio.gain_map: "),
            "{problem}"
        );
        assert!(
            problem.contains("gains.csv: ") && problem.contains(expected),
            "{problem}"
        );
    };
    expect("No such file");

    let good = map_of(&plain, |_, _| 1.0);
    let changed = |change: &dyn Fn(&mut Vec<Entry>)| {
        let mut entries = good.clone();
        change(&mut entries);
        write_map(&map, &entries);
    };
    changed(&|entries| entries.retain(|entry| (entry.0, entry.1) != ("sensor", 7)));
    expect("sensor 7 has 0 gains, but must have one at each of the 676 points of the grid");
    changed(&|entries| {
        entries.remove(30);
    });
    expect(
        "user 0 has 675 gains, but must have one at each of the 676 points of the grid (26 values",
    );
    changed(&|entries| entries[30].2 = 1000.0);
    expect("is a second gain of user 0 at east_m 1000, north_m 40");
    changed(&|entries| entries[30].4 = f64::NAN);
    expect("line 32: power_gain is `NaN`, but must be a number from 0 to 1");
    changed(&|entries| entries[30].4 = -95.0);
    expect("line 32: power_gain is `-9.5e1`, but must be a number from 0 to 1 (received over");
    changed(&|entries| entries[30].3 = f64::INFINITY);
    expect("line 32: north_m is `inf`, but must be a finite number of metres");
    changed(&|entries| entries[30].1 = 15);
    expect("line 32: index is `15`, but must be from 0 to 14: the mission has 15 users");
    changed(&|entries| entries[30].0 = "relay");
    expect("line 32: node is `relay`, but must be user or sensor");
    changed(&|entries| entries.retain(|entry| entry.2 < 1000.0));
    expect("east_m goes from 0 to 960 m, but must cover the area, 0 to 1000 m");
    changed(&|entries| entries.retain(|entry| entry.3 > 0.0));
    expect("north_m goes from 40 to 1000 m, but must cover the area, 0 to 1000 m");
    changed(&Vec::clear);
    expect("east_m goes from NaN to NaN m, but must cover the area");
    fs::write(&map, "a,b\n").expect("written");
    expect("the first line is `a,b`, but must be `node,index,east_m,north_m,power_gain`");
    let header = "node,index,east_m,north_m,power_gain\n";
    fs::write(&map, format!("{header}user,0,1,2\n")).expect("written");
    expect("line 2: has 4 values, but must have 5");
    fs::write(&map, b"PK\x03\x04\x00\x00").expect("written");
    expect("is a file of NumPy, but must be CSV with the first line");
    write_map(&map, &good);
    assert!(
        host_sim(&["plan", "--scenario", text(&mapped)])
            .status
            .success()
    );
}
