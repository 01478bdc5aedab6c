//! The figures from the shipped policies: near the bound, in the expected order, and equal to the
//! committed files.

#![cfg(feature = "onnx")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use host_sim::experiment::{
    Experiment, ExperimentContext, ExperimentSettings,
    approach::Approach,
    bounds::{BOUNDS, BoundRow},
    cell::{Cell, Learner, Preset, Topology, Training},
    report,
    seed_table::{SEEDS, SeedRow},
    seeds, table,
    totals::TotalRow,
};
use planning::bound;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn figures() -> PathBuf {
    repository().join("docs/figures")
}

fn settings(out: &Path, models: PathBuf) -> ExperimentSettings {
    ExperimentSettings {
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

/// SAC with the preset `tuned` reaches 0.97 of the best known mission and 0.95 of the bound in every
/// cell. How learners compare with each other is left to the verdicts.
#[test]
fn tuned_sac_is_near_the_bound_and_above_the_straight_line_in_every_cell() {
    let rows = measured(Experiment::Approaches);
    assert_eq!(missions(&rows).count(), 16);
    for mission in missions(&rows) {
        let of = |approach| rate(mission, approach);
        let sac = of(Approach::SacTuned).expect("flown");
        let search = of(Approach::Search).expect("known");
        let bound = of(Approach::Bound).expect("known");
        let cell = &mission[0];
        assert!(search <= bound, "{cell:?}");
        assert!(sac <= bound, "{cell:?}");
        assert!(sac >= 0.97 * search, "{cell:?}: {sac} of {search}");
        assert!(sac >= 0.95 * bound, "{cell:?}: {sac} of {bound}");
        let line = of(Approach::StraightLine).expect("flown");
        assert!(sac > line, "{cell:?}: {sac} against {line}");
        for row in mission {
            assert!(row.constraints_held, "{row:?}");
        }
    }
    // A higher threshold gives a higher rate; more noise gives a lower one.
    for of_kind in rows.chunk_by(|a, b| (a.topology, a.noise_dbm) == (b.topology, b.noise_dbm)) {
        let totals: Vec<f64> = missions(of_kind)
            .filter_map(|mission| rate(mission, Approach::SacTuned))
            .collect();
        assert_eq!(totals.len(), 4, "{of_kind:?}");
        assert!(totals.is_sorted_by(|a, b| a < b), "{totals:?}");
    }
    let sac: Vec<&TotalRow> = rows
        .iter()
        .filter(|row| row.approach == Approach::SacTuned)
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
        .filter_map(|mission| rate(mission, Approach::SacTuned))
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
        let svg = experiment.draw(&figures()).expect("drawn").to_svg();
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

/// `seeds.csv` names the bytes of every shipped policy of the figures, and its rows are what their
/// flights give.
#[test]
fn the_table_of_seeds_has_the_flights_of_the_shipped_policies() {
    let models = repository().join("models");
    let out = tempfile::tempdir().expect("a directory");
    let settings = settings(out.path(), models.clone());
    let context = ExperimentContext::open(settings, &()).expect("readable");
    let rows: Vec<SeedRow> = table::read(&models.join(SEEDS)).expect("committed");
    let shipped = fs::read_dir(models.join("cells")).expect("readable");
    let shipped = shipped.filter_map(|file| file.ok()?.path().extension().map(|end| end == "onnx"));
    let mut known = 0;
    for cell in Cell::all() {
        for learner in Learner::ALL {
            let training = Training::new(cell, learner, 1);
            let Some(file) = context.trainings().find(&training) else {
                continue;
            };
            known += 1;
            let stored = context.trainings().stored(&training).expect("valid");
            let stored = stored.unwrap_or_else(|| panic!("{training} is not in {SEEDS}"));
            let bytes = fs::read(&file).expect("readable");
            assert_eq!(stored.policy_sha256, seeds::sha256(&bytes), "{training}");
            if cell == Cell::table_one(Topology::Separated) {
                let flown = seeds::measure(&context, &training, &file).expect("flown");
                // Other vector instructions round a policy's outputs differently.
                let ratio = stored.sum_rate / flown.sum_rate;
                assert!((ratio - 1.0).abs() < 1e-3, "{stored:?} became {flown:?}");
                let sum_rate = stored.sum_rate;
                assert_eq!(SeedRow { sum_rate, ..flown }, *stored);
            }
        }
    }
    assert_eq!(known, shipped.filter(|is_policy| *is_policy).count());
    let mut trainings: Vec<_> = rows
        .iter()
        .map(|row| (&row.scenario_digest, &row.algorithm, &row.preset, row.seed))
        .collect();
    trainings.sort();
    trainings.dedup();
    assert_eq!(trainings.len(), rows.len(), "a training has two rows");
}

/// Finished runs become rows; the policies of seed 1 are copied, unfinished runs are named, and rows
/// whose runs are gone stay.
#[test]
fn the_table_of_seeds_is_made_from_finished_runs() {
    let folder = tempfile::tempdir().expect("a directory");
    let (models, runs) = (folder.path().join("models"), folder.path().join("runs"));
    let cell = Cell::table_one(Topology::Mixed).at_threshold(0.02);
    let learner = Learner::Ddpg(Preset::TableOne);
    let policy = repository().join(format!(
        "models/cells/{}.onnx",
        Training::new(cell, learner, 1)
    ));
    let run = |training: Training, episode: u32| {
        let run = runs.join(training.to_string());
        fs::create_dir_all(&run).expect("made");
        fs::copy(&policy, run.join("policy.onnx")).expect("copied");
        fs::write(run.join("settings.toml"), "seed = 1\nepisodes = 40\n").expect("written");
        let metrics = format!("episode,global_step\n1,60\n{episode},2400\n");
        fs::write(run.join("metrics.csv"), metrics).expect("written");
    };
    let first = Training::new(cell, learner, 1);
    let second = Training::new(cell, learner, 2);
    run(first, 40);
    run(second, 39);
    fs::create_dir_all(models.join("cells")).expect("made");
    let open = || {
        let settings = settings(folder.path(), models.clone());
        ExperimentContext::open(settings, &()).expect("readable")
    };
    let collected = seeds::collect(&open(), Some(&runs)).expect("flown");
    assert_eq!((collected.flown, collected.kept), (1, 0));
    assert_eq!(collected.copied, [first.to_string()]);
    assert_eq!(collected.unfinished, [second.to_string()]);
    let copy = models.join(format!("cells/{first}.onnx"));
    assert_eq!(fs::read(&copy).ok(), fs::read(&policy).ok());
    let rows: Vec<SeedRow> = table::read(&models.join(SEEDS)).expect("written");
    assert_eq!((rows[0].algorithm.as_str(), rows[0].seed), ("ddpg", 1));

    // A policy that is not the one that the directory's name says.
    run(second, 40);
    let problem = seeds::collect(&open(), Some(&runs)).expect_err("the seed differs");
    assert!(problem.contains("seed 1"), "{problem}");
    assert_eq!(problem.lines().count(), 1, "{problem}");

    fs::remove_dir_all(&runs).expect("there");
    fs::remove_file(&copy).expect("there");
    let collected = seeds::collect(&open(), None).expect("nothing to fly");
    assert_eq!((collected.flown, collected.kept), (0, 1));
    assert_eq!(table::read::<SeedRow>(&models.join(SEEDS)), Ok(rows));
}

/// Without a policy the stored row is used; with few seeds there is no interval, and the page says
/// how many there are.
#[test]
fn stored_results_stand_for_policies_that_are_not_there() {
    let folder = tempfile::tempdir().expect("a directory");
    let models = repository().join("models");
    let mut rows: Vec<SeedRow> = table::read(&models.join(SEEDS)).expect("committed");
    rows.retain(|row| row.seed == 1);
    let cell = Cell::table_one(Topology::Mixed);
    let learner = Learner::Sac(Preset::TableOne);
    let digest = cell.scenario().expect("valid").digest();
    let training = Training::new(cell, learner, 1);
    let first = rows.iter().find(|row| row.is_of(&training, &digest));
    let first = first.expect("there").clone();
    let with_seeds = |more: &[(u64, f64)]| {
        let more = more.iter().map(|&(seed, sum_rate)| SeedRow {
            seed,
            sum_rate,
            ..first.clone()
        });
        let rows: Vec<SeedRow> = rows.iter().cloned().chain(more).collect();
        table::write(&folder.path().join(SEEDS), &rows).expect("written");
        let settings = settings(folder.path(), folder.path().to_owned());
        fs::copy(models.join(BOUNDS), folder.path().join(BOUNDS)).expect("copied");
        let mut context = ExperimentContext::open(settings, &()).expect("readable");
        let figure = Experiment::Approaches;
        figure.measure(&mut context).expect("all is stored");
        let rows: Vec<TotalRow> = table::read(&figure.csv(folder.path())).expect("written");
        let of_training = |row: &&TotalRow| {
            row.approach == Approach::SacTableOne
                && (row.topology, row.noise_dbm) == (cell.topology, cell.noise_dbm)
                && row.mse_threshold == cell.mse_threshold
        };
        rows.iter().find(of_training).expect("there").clone()
    };
    let rate = first.sum_rate;
    let alone = with_seeds(&[]);
    assert_eq!((alone.runs, alone.stored, alone.interval_95), (1, 1, None));
    let two = with_seeds(&[(2, rate)]);
    assert_eq!((two.runs, two.stored, two.interval_95), (2, 2, None));
    let three = with_seeds(&[(2, 1.01 * rate), (3, 0.8 * rate)]);
    assert_eq!((three.runs, three.stored), (3, 3));
    assert!(three.interval_95 > Some(0.1 * rate), "{three:?}");
    assert_eq!(three.failed_seeds, "3");
    let claims = Experiment::Approaches
        .claims(folder.path())
        .expect("judged");
    let failed = claims
        .iter()
        .filter(|claim| claim.claimed.contains("No training fails"));
    let failed: Vec<_> = failed.map(|claim| claim.measured.as_str()).collect();
    assert_eq!(failed.len(), 2, "one for each preset");
    assert!(
        failed[1].contains("SAC (Table I), mixed, -95 dBm, 0.015: seed 3"),
        "{failed:?}"
    );
}

/// A comparison of learners names the presets of both, which are the same.
#[test]
fn learners_are_compared_within_a_preset() {
    for experiment in Experiment::ALL {
        for claim in experiment.claims(&figures()).expect("committed") {
            let text = format!("{} {}", claim.claimed, claim.measured);
            if text.contains("DDPG") {
                let tuned = text.contains("DDPG (tuned)") && !text.contains("(Table I)");
                let table_one = text.contains("DDPG (Table I)") && !text.contains("(tuned)");
                assert!(tuned || table_one, "{text}");
            }
        }
    }
    let page = fs::read_to_string(repository().join("docs/results.md")).expect("committed");
    for words in [
        "The policy `shipped`",
        "## Seeds",
        "certified bound (stored)",
        ", n ",
    ] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn what_is_missing_is_named_with_the_way_to_get_it() {
    let empty = tempfile::tempdir().expect("a directory");
    let settings = settings(empty.path(), empty.path().to_owned());
    let context = ExperimentContext::open(settings, &()).expect("nothing to read");
    let cell = Cell::table_one(Topology::Mixed);
    let problem = context
        .trainings()
        .policies(&[Training::new(cell, Learner::Ddpg(Preset::TableOne), 1)])
        .expect_err("nothing there");
    assert!(
        problem.contains("mixed-t60-n95-g0.015-ddpg-paper-s1.onnx"),
        "{problem}"
    );
    assert!(problem.contains("--train"), "{problem}");
    assert!(problem.contains("--models DIR"), "{problem}");
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
    let settings = ExperimentSettings {
        trainer: Some(trainer),
        ..settings(&out, folder.path().to_owned())
    };
    let context = ExperimentContext::open(settings, &()).expect("nothing to read");
    let training = Training::new(
        Cell::table_one(Topology::Mixed).lasting(70),
        Learner::Ddpg(Preset::TableOne),
        1,
    );
    for _ in 0..2 {
        let files = context.trainings().policies(&[training]).expect("trained");
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
