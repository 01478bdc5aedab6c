//! The same mission with the vehicle in another process, over UDP.

use std::{
    fs,
    net::UdpSocket,
    process::{Child, Command, Stdio},
};

use assert_cmd::assert::OutputAssertExt;
use end_to_end::program;
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

/// A UDP port that nobody listened on a moment ago.
fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port()
}

/// Four times as fast as real time: the test ends soon, and the client's patience, which runs in
/// the vehicle's time, is not shorter than a busy machine's.
const SPEED: &str = "4";

#[test]
fn the_mission_is_flown_over_udp() {
    let folder = tempdir().unwrap();
    let port = free_port();
    let mut vehicle = program("host-sim");
    vehicle.args(["vehicle", "--speed", SPEED, "--listen"]);
    vehicle.arg(format!("udpin:127.0.0.1:{port}"));
    let _vehicle = Server::start(vehicle);
    let run = program("host-sim")
        .args([
            "run",
            "--json",
            "--policy",
            "straight-line",
            "--speed",
            SPEED,
            "--link",
        ])
        .arg(format!("udpout:127.0.0.1:{port}"))
        .arg("--out")
        .arg(folder.path())
        .assert()
        .success();
    let summary: Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    for promise in ["arrived", "fair"] {
        assert_eq!(summary[promise], true, "{summary}");
    }
    assert_eq!(summary["mse_violations"], 0, "{summary}");
    assert_eq!(summary["constraint_violations"], 0, "{summary}");
    // Its own flight in simulated time is the measure: the same way-points, nearly the same rate.
    let here = program("host-sim")
        .args(["run", "--json", "--policy", "straight-line", "--out"])
        .arg(folder.path().join("here"))
        .assert()
        .success();
    let here: Value = serde_json::from_slice(&here.get_output().stdout).unwrap();
    let ratio = summary["sum_rate"].as_f64().unwrap() / here["sum_rate"].as_f64().unwrap();
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
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
