//! The same mission with the vehicle in another process, over UDP.

use std::{
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    thread,
};

use assert_cmd::assert::OutputAssertExt;
use end_to_end::{free_port, program};
use serde_json::Value;
use tempfile::tempdir;

/// A process that ends with the test, however that ends.
struct Server(Child);

impl Server {
    fn start(mut command: Command) -> Self {
        Self(command.stderr(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Four times as fast as real time: the test ends soon, and the client's patience, which runs in
/// the vehicle's time, is not shorter than a busy machine's.
const SPEED: &str = "4";

/// A vehicle of this profile, at a port of its own.
fn vehicle(profile: &str, speed: &str, arguments: &[&str]) -> (Server, String) {
    let port = free_port();
    let mut vehicle = program("host-sim");
    vehicle.args(["vehicle", "--profile", profile, "--speed", speed]);
    vehicle.args(arguments).arg("--listen");
    vehicle.arg(format!("udpin:127.0.0.1:{port}"));
    (Server::start(vehicle), format!("udpout:127.0.0.1:{port}"))
}

fn flown(folder: &Path, arguments: &[&str]) -> Value {
    let run = program("host-sim")
        .args(["run", "--json", "--policy", "straight-line"])
        .args(arguments)
        .arg("--out")
        .arg(folder)
        .assert()
        .success();
    serde_json::from_slice(&run.get_output().stdout).unwrap()
}

/// The default mission with this vehicle in a process of its own, over UDP: arrives, fair, nothing
/// broken, at least 0.96 of the ideal flight's rate and 3 m of the plan. The clipping parameters of
/// those that have some are set for the flight.
fn fly_over_udp(folder: &Path, ideal_rate: f64, profile: &str, speed: &str) {
    let (_vehicle, link) = vehicle(profile, speed, &[]);
    let arguments = ["--profile", profile, "--speed", speed, "--link", &link];
    let arguments = [&arguments[..], &["--set-params"]].concat();
    let summary = flown(&folder.join(profile), &arguments);
    for promise in ["arrived", "fair", "completed"] {
        assert_eq!(summary[promise], true, "{profile}: {summary}");
    }
    assert_eq!(summary["mse_violations"], 0, "{profile}: {summary}");
    assert_eq!(summary["constraint_violations"], 0, "{profile}: {summary}");
    let number = |name: &str| summary[name].as_f64().unwrap();
    assert!(number("sum_rate") > 0.96 * ideal_rate, "{summary}");
    assert!(number("planned_vs_flown_median_m") < 3.0, "{summary}");
    // Sixty slots of a second each, on the vehicle's clock, whatever the link did.
    assert_eq!(number("duration_s"), 60.0, "{summary}");
}

fn ideal_rate(folder: &Path) -> f64 {
    let summary = flown(&folder.join("here"), &[]);
    summary["sum_rate"].as_f64().unwrap()
}

const PROFILES: [&str; 4] = ["ideal", "multirotor", "arducopter", "px4"];

/// All four at once: eight processes, which is a load on a machine with two cores.
#[test]
fn the_mission_is_flown_over_udp_with_every_vehicle() {
    let folder = tempdir().unwrap();
    let ideal = ideal_rate(folder.path());
    thread::scope(|scope| {
        for profile in PROFILES {
            let folder = folder.path();
            scope.spawn(move || fly_over_udp(folder, ideal, profile, SPEED));
        }
    });
}

/// One after the other, ten times as fast as real time.
#[test]
fn the_mission_is_flown_fast_with_every_vehicle() {
    let folder = tempdir().unwrap();
    let ideal = ideal_rate(folder.path());
    for profile in PROFILES {
        fly_over_udp(folder.path(), ideal, profile, "10");
    }
}

/// Without `--set-params` nothing is changed: the mission would be too slow to arrive, is not
/// started, and the words say what to do. The doctor names each parameter and its value.
#[test]
fn a_clipped_vehicle_is_slow_and_the_words_say_why() {
    let folder = tempdir().unwrap();
    let (_vehicle, link) = vehicle("arducopter", "20", &[]);
    let doctor = program("host-sim")
        .args(["doctor", "--speed", "20", "--link", &link, "--tlog"])
        .arg(folder.path().join("doctor.tlog"))
        .assert()
        .code(1);
    let words = String::from_utf8(doctor.get_output().stdout.clone()).unwrap();
    for advice in [
        "WPNAV_SPEED is 1000: it clips speed; set it to 3500",
        "WPNAV_ACCEL is 250: it clips acceleration; set it to 1000",
        "ANGLE_MAX is 3000: it clips the tilt angle and therefore the speed; set it to 4500",
        "PSC_JERK_XY is 5: it clips jerk; set it to 20",
    ] {
        assert!(words.contains(advice), "{advice}: {words}");
    }
    let run = program("host-sim")
        .args([
            "run",
            "--profile",
            "arducopter",
            "--policy",
            "straight-line",
        ])
        .arg("--out")
        .arg(folder.path())
        .assert()
        .code(1);
    let complaint = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    let advice = "set WPNAV_SPEED to 3500";
    assert!(complaint.contains(advice), "{complaint}");
}

#[cfg(unix)]
#[test]
fn a_key_must_be_private_and_the_right_one() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempdir().unwrap();
    let key = |name: &str, digit: &str, mode: u32| {
        let path = folder.path().join(name);
        fs::write(&path, digit.repeat(64)).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        path.display().to_string()
    };
    let (ours, theirs) = (key("ours", "a", 0o600), key("theirs", "b", 0o600));
    let open = key("open", "c", 0o644);
    let out = folder.path().join("run").display().to_string();
    let run = |arguments: &[&str], code: i32| {
        let run = program("host-sim")
            .args(["run", "--policy", "straight-line", "--out", &out])
            .args(arguments)
            .assert()
            .code(code);
        let complaint = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        assert!(!complaint.contains("cccc") && !complaint.contains("aaaa"));
        complaint
    };
    assert!(run(&["--signing-key", &open], 2).contains("mode 644 gives others access"));
    // Both ends with the same key: signed there and back, in simulated time.
    run(&["--signing-key", &ours], 0);
    // Without a clock, and again from the saved state: the vehicle, which has forgotten everything,
    // takes over the later time.
    let state = folder.path().join("state.json").display().to_string();
    let kept = [
        "--signing-key",
        &ours,
        "--signing-clock",
        "unknown",
        "--signing-state",
        &state,
    ];
    let mut times = Vec::new();
    for _ in 0..2 {
        run(&kept, 0);
        let saved: Value = serde_json::from_slice(&fs::read(&state).unwrap()).unwrap();
        times.push(saved["time"].as_u64().unwrap());
    }
    assert!(times[0] < times[1], "{times:?}");
    fs::write(&state, "{}").unwrap();
    assert!(run(&kept, 2).contains("state of signatures"));
    assert!(run(&kept[2..], 2).contains("--signing-key"));
    let (_vehicle, link) = vehicle("ideal", "20", &["--signing-key", &theirs]);
    let arguments = ["--speed", "20", "--link", &link, "--signing-key", &ours];
    let complaint = run(&arguments, 1);
    assert!(
        complaint.contains("no heartbeat of an autopilot in 30 s"),
        "{complaint}"
    );
}

/// Nobody there: said what is waited for, one error at the end, nothing else.
#[test]
fn doctor_and_upload_say_what_they_wait_for_and_end() {
    let link = format!("udpout:127.0.0.1:{}", free_port());
    for command in ["doctor", "upload"] {
        let run = program("host-sim")
            .args([command, "--speed", "20", "--link", &link])
            .assert()
            .code(1);
        let words = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        let lines: Vec<&str> = words.lines().collect();
        assert_eq!(lines.len(), 2, "{words}");
        assert!(lines[0].contains("s for an autopilot at udpout"), "{words}");
        assert!(
            lines[1].starts_with("error: no heartbeat of an autopilot in 30 s"),
            "{words}"
        );
        assert!(run.get_output().stdout.is_empty());
    }
}

/// Where the link itself knows what is wrong, the complaint says that.
#[test]
fn a_refused_connection_is_said() {
    let link = format!("tcpout:127.0.0.1:{}", free_port());
    for command in ["doctor", "upload"] {
        let run = program("host-sim")
            .args([command, "--speed", "20", "--link", &link])
            .assert()
            .code(1);
        let words = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        let complaint = words.lines().last().unwrap();
        assert!(
            complaint.starts_with("error: no heartbeat of an autopilot in 30 s")
                && complaint.contains(&format!("{link}: Connection refused")),
            "{words}"
        );
    }
}

/// A ground station beside that is not there holds nothing up, and is said once, after the flight.
#[test]
fn a_ground_station_that_was_never_reached_is_noted() {
    let folder = tempdir().unwrap();
    let link = format!("tcpout:127.0.0.1:{}", free_port());
    let run = program("host-sim")
        .args(["run", "--policy", "straight-line", "--also", &link])
        .arg("--out")
        .arg(folder.path())
        .assert()
        .success();
    let words = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert_eq!(words.lines().count(), 1, "{words}");
    let note = format!("note: no ground station was reached at {link}");
    assert!(words.starts_with(&note), "{words}");
}

#[test]
fn nobody_at_the_other_end_is_an_error_that_ends() {
    let folder = tempdir().unwrap();
    let link = format!("udpout:127.0.0.1:{}", free_port());
    let out = folder.path().join("run");
    let run = program("host-sim")
        .args(["run", "--speed", "20", "--link", &link, "--out"])
        .arg(&out)
        .assert()
        .code(1);
    let complaint = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert!(
        complaint.contains("no heartbeat of an autopilot in 30 s"),
        "{complaint}"
    );
    assert!(!out.join("summary.json").exists());
    // The log of what was tried is kept.
    assert!(fs::metadata(out.join("mavlink.tlog")).is_ok());
}

#[test]
fn a_link_that_means_nothing_is_bad_usage() {
    for link in [
        "udp:1.2.3.4:5",
        "tcpout:localhost",
        "serial:",
        "udpin:127.0.0.1:99999",
    ] {
        let run = program("host-sim")
            .args(["run", "--link", link])
            .assert()
            .code(2);
        let complaint = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        assert!(
            complaint.contains("expected builtin, udpout:HOST:PORT"),
            "{complaint}"
        );
    }
}
