//! The figures from the shipped policies: near the bound, in the expected order, and equal to the
//! committed files.

#![cfg(feature = "onnx")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use host_sim::experiment::{
    Experiment, ExperimentContext, Settings,
    cell::{Cell, Learner, Topology, Training},
    context::{BOUNDS, BoundRow},
    report, table,
    totals::{Approach, TotalRow},
};
use planning::bound;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn figures() -> PathBuf {
    repository().join("docs/figures")
}

fn settings(out: &Path, models: PathBuf) -> Settings {
    Settings {
        out: out.to_owned(),
        models,
        trainer: None,
        seeds: 3,
        fresh: false,
    }
}

/// Measures the flights of a figure.
fn measured(experiment: Experiment) -> Vec<TotalRow> {
    let out = tempfile::tempdir().expect("a directory");
    let settings = settings(out.path(), repository().join("models"));
    let mut context = ExperimentContext::open(settings, &()).expect("bounds are readable");
    experiment
        .measure(&mut context)
        .expect("everything is shipped");
    table::read(&experiment.csv(out.path())).expect("rows")
}

/// Returns the rows of each mission, the approaches in the figure's order.
fn missions(rows: &[TotalRow]) -> impl Iterator<Item = &[TotalRow]> {
    rows.chunk_by(|a, b| {
        let mission = |row: &TotalRow| {
            (
                row.topology,
                row.mission_time_s,
                row.noise_dbm,
                row.mse_threshold,
            )
        };
        mission(a) == mission(b)
    })
}

fn rate(mission: &[TotalRow], approach: Approach) -> Option<f64> {
    let row = mission.iter().find(|row| row.approach == approach)?;
    Some(row.sum_rate)
}

/// The best of SAC's presets reaches 0.97 of the best known mission and 0.95 of the bound in every
/// cell.
#[test]
fn sac_is_near_the_bound_and_above_the_others_in_every_cell() {
    let rows = measured(Experiment::Approaches);
    assert_eq!(missions(&rows).count(), 16);
    for mission in missions(&rows) {
        let of = |approach| rate(mission, approach);
        let presets = [Approach::Sac, Approach::SacTableOne]
            .into_iter()
            .filter_map(of);
        let sac = presets.fold(0.0, f64::max);
        let search = of(Approach::Search).expect("known");
        let bound = of(Approach::Bound).expect("known");
        let cell = &mission[0];
        assert!(search <= bound, "{cell:?}");
        assert!(sac <= bound, "{cell:?}");
        assert!(sac >= 0.97 * search, "{cell:?}: {sac} of {search}");
        assert!(sac >= 0.95 * bound, "{cell:?}: {sac} of {bound}");
        for lesser in [Approach::Ddpg, Approach::StraightLine] {
            let lesser = of(lesser).expect("flown");
            assert!(sac > lesser, "{cell:?}: {sac} against {lesser}");
        }
        for row in mission {
            assert!(row.constraints_held, "{row:?}");
        }
    }
    // A higher threshold gives a higher rate; more noise gives a lower one.
    for of_kind in rows.chunk_by(|a, b| (a.topology, a.noise_dbm) == (b.topology, b.noise_dbm)) {
        let totals: Vec<f64> = missions(of_kind)
            .filter_map(|mission| rate(mission, Approach::Sac))
            .collect();
        assert_eq!(totals.len(), 4, "{of_kind:?}");
        assert!(totals.is_sorted_by(|a, b| a < b), "{totals:?}");
    }
    let sac: Vec<&TotalRow> = rows
        .iter()
        .filter(|row| row.approach == Approach::Sac)
        .collect();
    assert_eq!(sac.len(), 16);
    let (quiet, noisy) = sac.split_at(8);
    for (quiet, noisy) in quiet.iter().zip(noisy) {
        assert!(noisy.noise_dbm > quiet.noise_dbm && noisy.sum_rate < quiet.sum_rate);
    }
    as_committed(Experiment::Approaches, &rows);
}

#[test]
fn the_total_grows_with_the_mission_time() {
    let rows = measured(Experiment::MissionTime);
    let totals: Vec<f64> = missions(&rows)
        .filter_map(|mission| rate(mission, Approach::Sac))
        .collect();
    assert_eq!(totals.len(), 5);
    assert!(totals.is_sorted_by(|a, b| a < b), "{totals:?}");
    as_committed(Experiment::MissionTime, &rows);
}

/// The committed CSV file contains these numbers. Processors with other vector instructions round a
/// policy's outputs differently, which may move a waypoint by a tiny distance.
fn as_committed(experiment: Experiment, rows: &[TotalRow]) {
    let committed: Vec<TotalRow> = table::read(&experiment.csv(&figures())).expect("committed");
    assert_eq!(committed.len(), rows.len());
    for (old, new) in committed.iter().zip(rows) {
        assert_eq!(old.approach, new.approach);
        assert!(
            (old.sum_rate / new.sum_rate - 1.0).abs() < 1e-3,
            "{old:?} became {new:?}"
        );
    }
}

#[test]
fn drawings_and_page_are_those_of_the_committed_tables() {
    let text = |path: PathBuf| fs::read_to_string(path).expect("committed");
    for experiment in Experiment::ALL {
        let svg = experiment.draw(&figures()).expect("drawn");
        roxmltree::Document::parse(&svg).expect("well-formed");
        let name = format!("{}.svg", experiment.name());
        assert!(svg == text(figures().join(&name)), "{name} is stale");
    }
    let page = report::results(&figures(), "figures/").expect("written");
    assert!(
        page == text(repository().join("docs/results.md")),
        "docs/results.md is stale"
    );
}

#[test]
fn known_bounds_are_what_is_certified_now() {
    let known: Vec<BoundRow> =
        table::read(&repository().join("models").join(BOUNDS)).expect("committed");
    for cell in Cell::all() {
        let digest = cell.scenario().expect("valid").digest();
        let known = known.iter().any(|row| row.scenario_digest == digest);
        assert!(known, "{cell} is not among the bounds");
    }
    let cell = Cell::table_one(Topology::Separated);
    let scenario = cell.scenario().expect("valid");
    let digest = scenario.digest();
    let row = known
        .iter()
        .find(|row| row.scenario_digest == digest)
        .expect("known");
    let now = bound::certify(&scenario.mission, &bound::BoundSettings::default(), |_| {});
    let now = now.expect("bounded");
    assert_eq!((row.upper, row.lower), (now.upper, now.lower));
    for row in known {
        let gap = (row.upper - row.lower) / row.upper;
        assert!((0.0..=0.02).contains(&gap), "{row:?}");
    }
}

#[test]
fn what_is_missing_is_named_with_the_way_to_get_it() {
    let empty = tempfile::tempdir().expect("a directory");
    let settings = settings(empty.path(), empty.path().to_owned());
    let context = ExperimentContext::open(settings, &()).expect("nothing to read");
    let cell = Cell::table_one(Topology::Mixed);
    let problem = context
        .policies(&[Training::new(cell, Learner::Ddpg, 1)])
        .expect_err("nothing there");
    assert!(
        problem.contains("mixed-t60-n95-g0.015-ddpg-paper-s1.onnx"),
        "{problem}"
    );
    assert!(problem.contains("--train"), "{problem}");
}

/// A replacement for the trainer: records its arguments, and copies a shipped policy.
#[cfg(unix)]
#[test]
fn what_is_missing_is_trained_once() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a directory");
    let calls = folder.path().join("calls");
    let policy = repository().join("models/mixed-ddpg.onnx");
    let script = format!(
        "#!/bin/sh\necho \"$@\" >> '{}'\nwhile [ \"$1\" != --out ]; do shift; done\n\
         mkdir -p \"$2\" && cp '{}' \"$2/policy.onnx\"\n",
        calls.display(),
        policy.display()
    );
    let trainer = folder.path().join("trainer");
    fs::write(&trainer, script).expect("written");
    fs::set_permissions(&trainer, fs::Permissions::from_mode(0o755)).expect("allowed");
    let out = folder.path().join("out");
    let settings = Settings {
        trainer: Some(trainer),
        ..settings(&out, folder.path().to_owned())
    };
    let context = ExperimentContext::open(settings, &()).expect("nothing to read");
    let training = Training::new(
        Cell::table_one(Topology::Mixed).lasting(70),
        Learner::Ddpg,
        1,
    );
    for _ in 0..2 {
        let files = context.policies(&[training]).expect("trained");
        assert_eq!(files, [out.join(format!("policies/{training}.onnx"))]);
        assert_eq!(fs::read(&files[0]).ok(), fs::read(&policy).ok());
    }
    let calls = fs::read_to_string(&calls).expect("called");
    assert_eq!(calls.lines().count(), 1, "{calls}");
    assert!(
        calls.contains("mixed-t70-n95.toml --mse-threshold 0.015 --algorithm ddpg"),
        "{calls}"
    );
}
