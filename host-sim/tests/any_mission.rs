//! Policies for any mission, flown as a user would fly them.

mod program;

use std::{
    fs,
    path::{Path, PathBuf},
};

use firmware_core::{
    inner::Workspace,
    policy::{
        Observation,
        sets::{
            Architecture, Precision, SetsHeader, SetsObservation, SetsProvenance, SetsWork, write,
        },
    },
};
use program::{json, number, refusal, text};
use scenario::Scenario;
use tempfile::tempdir;

/// Writes a network that was not trained: its weights are the sines of their indices.
fn untrained(folder: &Path) -> PathBuf {
    let architecture = Architecture {
        width: 32,
        hidden: 32,
        layers: 1,
    };
    let mission = Scenario::shipped("separated").expect("shipped").mission;
    let observation = Observation::at_start(&mission);
    let test = SetsObservation::new(&mission, &observation, &mut Workspace::default());
    let provenance = SetsProvenance {
        algorithm: "none".try_into().expect("short"),
        missions: "none".try_into().expect("short"),
        episodes: 0,
        seed: 0,
    };
    let header = SetsHeader::new(provenance, architecture, Precision::Half, &test);
    let weights = (0..architecture.weight_count()).map(|index| (index as f32).sin() * 0.3);
    let mut bytes = vec![0; 1 << 20];
    let length = write(
        &header,
        weights,
        &test,
        &mut SetsWork::default(),
        &mut bytes,
    );
    bytes.truncate(length.expect("a policy"));
    let file = folder.join("any.policy");
    fs::write(&file, bytes).expect("written");
    file
}

/// One file flies both shipped maps and a random one, also after changes in flight. Nothing is
/// broken, although the network was not trained: the shield sees to it.
#[test]
fn one_file_flies_every_map() {
    let folder = tempdir().expect("a folder");
    let policy = untrained(folder.path());
    let random = folder.path().join("random.toml");
    let mission = scenario::random(7, None).expect("a mission");
    fs::write(&random, mission.to_toml()).expect("written");
    let events = folder.path().join("events.toml");
    let later = "[[event]]\nslot = 9\nuser = 1\nposition_m = [500.0, 500.0]\n\
                 [[event]]\nslot = 12\nsensor = 2\nleaves = true\n";
    fs::write(&events, later).expect("written");
    let out = folder.path().join("out");
    for scenario in ["separated", "mixed", text(&random)] {
        let flown = json(&[
            "run",
            "--json",
            "--scenario",
            scenario,
            "--policy",
            text(&policy),
            "--events",
            text(&events),
            "--out",
            text(&out),
        ]);
        assert_eq!(flown["policy"], "any.policy", "{scenario}");
        assert_eq!(number(&flown, "constraint_violations"), 0.0, "{scenario}");
        assert_eq!(flown["arrived"], true, "{scenario}");
        assert_eq!(flown["fair"], true, "{scenario}");
    }
}

/// A damaged file, and one of a version to come, are refused in one line that names the file.
#[test]
fn files_that_cannot_fly_are_refused() {
    let folder = tempdir().expect("a folder");
    let policy = untrained(folder.path());
    let mut bytes = fs::read(&policy).expect("written");
    if let Some(last) = bytes.last_mut() {
        *last ^= 1;
    }
    fs::write(&policy, bytes).expect("written");
    let refused = refusal(&["run", "--policy", text(&policy)]);
    assert!(refused.contains("any.policy: checksum is"), "{refused}");
    fs::write(&policy, b"UAVP\x04\0\0\0\0\0").expect("written");
    let refused = refusal(&["run", "--policy", text(&policy)]);
    let expected = "any.policy: format version is 4, but this build reads 1, 2 and 3";
    assert!(refused.contains(expected), "{refused}");
}

/// The shipped policy is flown by name, and its ONNX file by tract: both decide alike.
#[test]
fn the_shipped_policy_flies_by_name() {
    let folder = tempdir().expect("a folder");
    let out = folder.path().join("out");
    let onnx = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/any.onnx");
    let [by_name, by_tract] = ["any", onnx].map(|policy| {
        let out = text(&out);
        let flown = json(&["run", "--json", "--policy", policy, "--out", out]);
        assert_eq!(number(&flown, "constraint_violations"), 0.0, "{policy}");
        number(&flown, "sum_rate")
    });
    assert!((by_name - by_tract).abs() < 0.01, "{by_name} {by_tract}");
    // SAC with Table I's settings, trained for this very mission, has 60.57 bit/s/Hz.
    assert!(by_name > 60.6, "{by_name}");
}
