use std::fs;

use super::*;

fn text() -> String {
    generate(Topology::Separated, 1, 15, 36).unwrap().to_toml()
}

fn problem(text: &str) -> String {
    Scenario::parse("test", text).unwrap_err()
}

#[test]
fn a_generated_scenario_survives_its_own_file() {
    let scenario = generate(Topology::Mixed, 3, 15, 36).unwrap();
    let again = Scenario::parse("mixed", &scenario.to_toml()).unwrap();
    assert_eq!(scenario, again);
    assert_eq!(scenario.digest(), again.digest());
    assert_ne!(scenario.digest(), scenario.with_slots(61).unwrap().digest());
}

#[test]
fn errors_name_field_value_and_what_is_right() {
    let cases = [
        (
            "slots = 60",
            "slots = 0",
            "mission.slots is 0, but must be a whole number from 1 to 100000",
        ),
        (
            "slots = 60",
            "slots = -3",
            "mission.slots: invalid value: integer `-3`, expected u32",
        ),
        (
            "slots = 60",
            "slots = 60\ncolour = 1",
            "unknown field `colour`",
        ),
        ("altitude_m = 100.0", "", "missing field `altitude_m`"),
        (
            "power_max_w = 0.2",
            "power_max_w = -0.2",
            "users.power_max_w is -0.2, but must be a number above 0 and at most 1000000",
        ),
        (
            "start_m = [50.0, 50.0]",
            "start_m = [nan, 50.0]",
            "mission.start_m is [NaN, 50], but must lie in the area [0, 1000] x [0, 1000]",
        ),
        (
            "mse_threshold = 0.015",
            "mse_threshold = 0.03",
            "below 1/J = 0.0277",
        ),
        (
            "max_speed_mps = 30.0",
            "max_speed_mps = 20.0",
            "mission.destination_m is 1272.79",
        ),
        (
            "noise_dbm = -95.0",
            "noise_dbm = inf",
            "radio.noise_dbm is inf, but must be from -200 to 100 dBm",
        ),
        (
            "latitude_deg = -35.363262",
            "latitude_deg = 135.0",
            "origin.latitude_deg is 135",
        ),
        (
            "function = \"mean\"",
            "function = \"weighted-mean\"",
            "sensing.weights has 0 entries, but must have one for each of the 36 sensors",
        ),
    ];
    let good = text();
    for (old, new, expected) in cases {
        assert!(good.contains(old), "{old} is not in\n{good}");
        let problem = problem(&good.replace(old, new));
        assert!(problem.contains(expected), "{new}: {problem}");
        assert!(!problem.contains('\n'), "{problem}");
    }
}

/// The `toml` crate would drop the superfluous values of a list.
#[test]
fn no_value_of_a_list_is_dropped() {
    let whole = "but must be two numbers: east and north in metres";
    let cases = [
        (
            "start_m = [50.0, 50.0]",
            "start_m = [50.0, 50.0, 7.0]",
            format!("mission.start_m: is [50.0, 50.0, 7.0], {whole} (line 4: `[50.0, 50.0, 7.0]`)"),
        ),
        (
            "destination_m = [950.0, 950.0]",
            "destination_m = [950.0]",
            format!("mission.destination_m: is [950.0], {whole} (line 5: `[950.0]`)"),
        ),
        (
            "area_m = [1000.0, 1000.0]",
            "area_m = [1000.0, 1000.0, 120.0]",
            format!("mission.area_m: is [1000.0, 1000.0, 120.0], {whole} (line 6"),
        ),
        (
            "[385.9, 556.9]",
            "[385.9, 556.9, 1.5]",
            format!("users.positions_m[0]: is [385.9, 556.9, 1.5], {whole}"),
        ),
        (
            "start_m = [50.0, 50.0]",
            "start_m = [1, 2, 3, 4, 5, 6, 7, 8, 9]",
            format!("mission.start_m: is a list of 9 numbers, {whole}"),
        ),
        (
            "environment = { a = 9.613, b = 0.158 }",
            "environment = [9.613, 0.158, 1.0]",
            "radio.environment: invalid type: sequence, expected a table, each value with its name \
             (line 13: `[9.613, 0.158, 1.0]`)"
                .into(),
        ),
        (
            "excess_loss_db = { los = 1.0, nlos = 20.0 }",
            "excess_loss_db = [1.0, 20.0]",
            "radio.excess_loss_db: invalid type: sequence, expected a table".into(),
        ),
        (
            "field = { seed = 1, mean_c = 21.0, spread_c = 4.0, sensor_noise_c = 0.2 }",
            "field = [1, 21.0, 4.0, 0.2, 5.0]",
            "sensing.field: invalid type: sequence, expected a table".into(),
        ),
        (
            "[origin]\nlatitude_deg = -35.363262\nlongitude_deg = 149.165237\nelevation_m = 584.0",
            "",
            "origin: invalid type: sequence, expected a table".into(),
        ),
    ];
    let good = text();
    for (old, new, expected) in cases {
        assert!(good.contains(old), "{old} is not in\n{good}");
        let mut wrong = good.replace(old, new);
        if new.is_empty() {
            wrong = format!("origin = [-35.4, 149.2, 584.0, 1.0]\n{wrong}");
        }
        let problem = problem(&wrong);
        assert!(problem.starts_with(&expected), "{new}: {problem}");
        assert!(!problem.contains('\n'), "{problem}");
    }
}

#[test]
fn the_controllers_capacity_is_a_limit() {
    let problem = generate(Topology::Mixed, 1, 15, SENSORS_MAX + 1).unwrap_err();
    assert_eq!(
        problem,
        "sensors.positions_m has 65 entries, but the controller holds at most 64"
    );
    assert!(
        generate(Topology::Mixed, 1, 0, 3)
            .unwrap_err()
            .contains("at least one user")
    );
}

#[test]
fn measurements_come_from_the_csv() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = generate(Topology::Mixed, 1, 2, 3)
        .unwrap()
        .with_slots(47)
        .unwrap();
    let file = scenario
        .to_toml()
        .replace("unit = ", "measurements_csv = \"data.csv\"\nunit = ");
    let path = folder.path().join("m.toml");
    fs::write(&path, &file).unwrap();
    let missing = Scenario::load(&path).unwrap_err().to_string();
    assert!(missing.contains("sensing.measurements_csv") && missing.contains("data.csv"));

    let data = folder.path().join("data.csv");
    fs::write(&data, format!("a,b,c\n{}", "1.5,2,3\n".repeat(47))).unwrap();
    let loaded = Scenario::load(&path).unwrap();
    assert_eq!(
        loaded.sensing.measurements(&loaded.mission)[46],
        [1.5, 2.0, 3.0]
    );

    fs::write(&data, "1,2,3\n".repeat(46)).unwrap();
    let short = Scenario::load(&path).unwrap_err().to_string();
    assert!(short.contains("46 rows of measurements, but the mission has 47 slots"));
    fs::write(&data, "1,nan,3\n".repeat(47)).unwrap();
    let nan = Scenario::load(&path).unwrap_err().to_string();
    #[cfg(unix)]
    {
        let endless = file.replace("data.csv", "/dev/zero");
        fs::write(folder.path().join("endless.toml"), endless).unwrap();
        let endless = Scenario::load(&folder.path().join("endless.toml")).unwrap_err();
        assert!(
            endless.to_string().contains("longer than 64 MiB"),
            "{endless}"
        );
    }
    assert!(nan.contains("row 1, column 2 is `nan`, but must be a finite number"));
}

#[test]
fn changes_are_made_together_and_named_when_wrong() {
    let mut choice = ScenarioChoice::unchanged("mixed".into());
    let plain = Scenario::shipped("mixed").unwrap();
    assert_eq!(choice.load().unwrap(), plain);

    choice.changes.mse_threshold = Some(0.025);
    choice.changes.noise_dbm = Some(-85.0);
    choice.changes.slots = Some(70);
    let loaded = choice.load().unwrap();
    assert_eq!(loaded.mission.slots(), 70);
    assert_eq!(loaded.mission.parameters().mse_threshold, 0.025);
    let in_turn = plain.with_mse_threshold(0.025).unwrap();
    let in_turn = in_turn.with_noise_dbm(-85.0).unwrap();
    assert_eq!(loaded, in_turn.with_slots(70).unwrap());

    choice.changes.mse_threshold = Some(0.03);
    let problem = choice.load().unwrap_err();
    let asked = "mixed with --mse-threshold 0.03 --noise-dbm -85 --slots 70: ";
    assert!(problem.starts_with(asked), "{problem}");
    assert!(
        problem.contains("aircomp.mse_threshold is 0.03"),
        "{problem}"
    );
}

#[test]
fn a_made_scenario_is_as_strict_per_sensor_whatever_their_number() {
    let threshold = |sensors| {
        let made = generate(Topology::Mixed, 1, 15, sensors).unwrap();
        made.mission.parameters().mse_threshold
    };
    assert_eq!(threshold(36), 0.015);
    assert_eq!(threshold(1), 0.54);
    for sensors in 1..=SENSORS_MAX {
        let share = threshold(sensors) * sensors as f64;
        assert!((share - 0.54).abs() < 1e-3, "{sensors}: {share}");
    }
}

#[test]
fn a_layout_is_spread_over_the_area_that_is_asked_for() {
    let course = Course {
        slots: 90,
        area_m: [2000.0, 500.0],
        start_m: Some([0.0, 250.0]),
        destination_m: None,
    };
    let scenario = generate_on(Topology::Separated, 1, 15, 36, &course).unwrap();
    let p = scenario.mission.parameters();
    assert_eq!((p.area.east_m, p.area.north_m), (2000.0, 500.0));
    assert_eq!((p.start.x, p.start.y), (0.0, 250.0));
    assert_eq!((p.destination.x, p.destination.y), (1900.0, 475.0));
    assert_eq!(scenario.mission.slots(), 90);
    assert!(
        p.users
            .iter()
            .all(|user| user.x <= 900.0 && user.y >= 275.0)
    );
    for area_m in [[0.0, 1000.0], [f64::NAN, 1.0], [1e9, 1e9]] {
        let course = Course { area_m, ..course };
        let problem = generate_on(Topology::Mixed, 1, 3, 3, &course).unwrap_err();
        assert!(problem.starts_with("mission.area_m: east is "), "{problem}");
    }
    let far = Course {
        slots: 16,
        ..course
    };
    assert!(generate_on(Topology::Mixed, 1, 3, 3, &far).is_err());
}
