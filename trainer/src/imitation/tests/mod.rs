//! Demonstrations, samples and short runs.

mod loss;

use firmware_core::{
    inner::Workspace,
    policy::{
        Observation, Policy,
        sets::{Precision, SetsNetwork, SetsObservation, SetsProvenance, SetsWork},
    },
    shield::{Agility, Fairness},
};
use pulp::Arch;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::{DrawnMission, Layout};

use super::{
    demonstration::{Demonstration, mission_seed},
    encoder::{Encoder, FEATURES},
    held_out::{FIRST_SEED, HeldOut},
    policy::SetPolicy,
    run::Imitation,
    sample::Sample,
    settings::{HIGH_NOISE_DBM, ImitationSettings},
    symmetry::Symmetry,
    trained::TrainedNetwork,
};
use crate::{
    nn::sets::{Architecture, SetNetwork},
    record::Threads,
};

fn quick() -> ImitationSettings {
    ImitationSettings {
        seed: 7,
        steps: 12,
        batch: 8,
        first_missions: 2,
        steps_per_mission: 3,
        planning_operations: 10_000_000,
        own_flights_from: 4,
        correction_operations: 100_000,
        architecture: Architecture {
            width: 32,
            hidden: 32,
            layers: 1,
        },
        high_noise_fraction: 0.0,
        held_out_missions: 1,
        evaluate_every: 6,
        report_every: 3,
        ..ImitationSettings::default()
    }
}

/// The planner's answers keep the rules, in the states of the plan and in those of a flight.
#[test]
fn a_demonstration_has_admissible_answers_in_every_slot() {
    let demonstration = Demonstration::new(&quick(), 0, None, None).expect("a demonstration");
    let slots = demonstration.mission.slots();
    assert_eq!(demonstration.examples.len(), 2 * slots as usize);
    let reach_m = demonstration.mission.reach_m();
    for (index, example) in demonstration.examples.iter().enumerate() {
        assert_eq!(example.slot, index as u32 % slots + 1);
        let fairness =
            Fairness::of_state(&demonstration.mission, &example.counts, example.slot - 1);
        assert!(fairness.admits(example.user.into()), "{example:?}");
        let [x, y] = [0, 1].map(|i| example.waypoint_m[i] - example.position_m[i]);
        assert!(x.hypot(y) <= reach_m * 1.001, "{example:?}");
    }
    // The flight is disturbed.
    let (plan, flight) = demonstration.examples.split_at(slots as usize);
    let differ = |(a, b): (
        &super::demonstration::Example,
        &super::demonstration::Example,
    )| a.position_m != b.position_m;
    assert!(plan.iter().zip(flight).filter(|&pair| differ(pair)).count() > slots as usize / 2);
}

/// A reflection changes no rate, so it changes no feature but the components of directions.
#[test]
fn a_reflected_mission_has_reflected_features() {
    let demonstration = Demonstration::new(&quick(), 1, None, None).expect("a demonstration");
    let example = &demonstration.examples[5];
    let area = demonstration.mission.parameters().area;
    let [x, y] = example.position_m;
    let position = firmware_core::Position::new(x, y);
    let mut encoders = [Encoder::default(), Encoder::default()];
    let symmetry = Symmetry {
        flip_east: true,
        flip_north: false,
        transpose: true,
    };
    let reflected = symmetry.mission(&demonstration.mission);
    assert_eq!(symmetry.place(&area, &position).y, area.east_m - x);
    encoders[0].encode(
        &demonstration.mission,
        &example.observation(&demonstration.mission, position),
    );
    let place = symmetry.place(&area, &position);
    encoders[1].encode(&reflected, &example.observation(&reflected, place));
    let [plain, image] = encoders.each_ref().map(Encoder::state);
    for (plain, image) in plain.to_users.iter().zip(image.to_users) {
        assert!((plain[0] + image[1]).abs() < 1e-3 && (plain[1] - image[0]).abs() < 1e-3);
    }
    // The best rate where the vehicle is.
    assert!((plain.mission[20] - image.mission[20]).abs() < 1e-5);
    assert!(plain.mission[20] != 0.0);
}

fn finished(settings: ImitationSettings, threads: Threads) -> (Vec<f32>, String) {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_owned();
    let mut run = Imitation::start(settings, None, path.clone(), threads).expect("starts");
    run.run(false).expect("runs");
    let metrics = std::fs::read_to_string(path.join("metrics.csv")).expect("metrics");
    (run.network().export(), metrics)
}

#[test]
fn a_run_does_not_depend_on_threads_and_learns() {
    let expected = finished(quick(), Threads::default());
    let threads = Threads {
        gradient: 3,
        planning: 2,
    };
    assert_eq!(finished(quick(), threads), expected);
    let longer = ImitationSettings {
        steps: 300,
        batch: 16,
        report_every: 100,
        evaluate_every: 300,
        warmup_steps: 10,
        learning_rate: 2e-3,
        ..quick()
    };
    let (_, metrics) = finished(longer, Threads::default());
    // The error of the displacement, and the cross entropy of the user.
    for column in [2, 3] {
        let losses: Vec<f64> = (metrics.lines().skip(1))
            .filter_map(|line| line.split(',').nth(column)?.parse().ok())
            .collect();
        assert!(losses[2] < 0.9 * losses[0], "{metrics}");
    }
}

#[test]
fn a_resumed_run_has_the_same_bytes() {
    let (expected, metrics) = finished(quick(), Threads::default());
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_owned();
    let half = ImitationSettings {
        // The learning rate must be that of the whole run.
        final_rate_fraction: 1.0,
        ..quick()
    };
    let whole = finished(half.clone(), Threads::default());
    assert_ne!(whole.0, expected, "{metrics}");
    let first = ImitationSettings { steps: 6, ..half };
    let threads = Threads::default();
    let mut run = Imitation::start(first, None, path.clone(), threads).expect("starts");
    run.run(false).expect("runs");
    let mut run = Imitation::resume(path.clone(), Some(12), None, threads).expect("resumes");
    run.run(false).expect("runs");
    let metrics = std::fs::read_to_string(path.join("metrics.csv")).expect("metrics");
    assert_eq!((run.network().export(), metrics), whole);
}

/// Missions are those of the distribution, and as many as asked for have the hardest layout.
#[test]
fn a_fraction_of_the_missions_is_uniform() {
    let settings = ImitationSettings {
        uniform_fraction: 0.5,
        ..quick()
    };
    let is = |seed: u64, layout| {
        let expected = scenario::random(seed, layout).expect("a mission").mission;
        settings.mission(seed).expect("a mission") == expected
    };
    let uniform = |&seed: &u64| is(seed, Some(Layout::Uniform));
    let count = (9_000..9_060).filter(uniform).count();
    assert!((20..=40).contains(&count), "{count}");
    assert!((9_000..9_060).all(|seed| uniform(&seed) || is(seed, None)));
}

/// As many missions as asked for have much noise, and are otherwise those of the distribution.
#[test]
fn a_fraction_of_the_missions_has_much_noise() {
    let settings = ImitationSettings {
        high_noise_fraction: 0.5,
        ..quick()
    };
    let mut noisy = 0;
    for seed in 9_000..9_060 {
        let mission = settings.mission(seed).expect("a mission");
        let usual = quick().mission(seed).expect("a mission");
        let mut parameters = mission.parameters().clone();
        parameters.noise_power = usual.parameters().noise_power;
        assert_eq!(&parameters, usual.parameters());
        if mission != usual {
            let noise_dbm = 10.0 * mission.parameters().noise_power.0.log10() + 30.0;
            assert!(HIGH_NOISE_DBM.contains(&noise_dbm), "{noise_dbm}");
            noisy += 1;
        }
    }
    assert!((20..=40).contains(&noisy), "{noisy}");
}

/// A mission that the network flies badly has a larger weight, and its examples are drawn as many
/// times as often.
#[test]
fn missions_that_are_flown_badly_are_drawn_more_often() {
    let settings = quick();
    let network = SetNetwork::new(settings.architecture, FEATURES, 1);
    let usual = Demonstration::new(&settings, 2, None, None).expect("a demonstration");
    assert_eq!(usual.weight, 1.0);
    let untrained = Demonstration::new(&settings, 2, Some(&network), None).expect("flown");
    assert!(untrained.weight > 1.5, "{}", untrained.weight);
    let expected = untrained.weight / (untrained.weight + usual.weight);
    let demonstrations = [usual, untrained];
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let count = 4_000;
    let second = (0..count).filter(|_| Sample::draw(&demonstrations, &mut rng).demonstration == 1);
    let fraction = second.count() as f64 / f64::from(count);
    assert!((fraction - expected).abs() < 0.03, "{fraction} {expected}");
}

/// The missions that results are stated for have other seeds than those that a run learns from or
/// chooses its best network by.
#[test]
fn no_run_learns_from_missions_of_the_benchmark() {
    let first_of_runs = mission_seed(0, 0);
    let held_out = FIRST_SEED..FIRST_SEED + 1_000_000;
    assert!(held_out.end <= first_of_runs);
    let mut seeds = std::collections::BTreeSet::new();
    for folder in ["../benchmarks", "../benchmarks/fresh"] {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
        for entry in std::fs::read_dir(folder).expect("a directory") {
            let path = entry.expect("readable").path();
            if path.extension().is_some_and(|kind| kind == "toml") {
                let stem = path.file_stem().and_then(|stem| stem.to_str());
                let seed = stem.and_then(|stem| stem.strip_prefix("random-"));
                seeds.insert(seed.and_then(|seed| seed.parse().ok()).expect("a seed"));
            }
        }
    }
    assert_eq!(seeds.len(), 400);
    for seed in seeds {
        assert!(seed < first_of_runs && !held_out.contains(&seed), "{seed}");
    }
}

/// A run without some layouts has missions of the others, its own where that has none of them; and
/// so have the evaluations that its best network is chosen by.
#[test]
fn a_run_has_no_missions_with_layouts_that_are_left_out() {
    let without = |left_out_layouts: &[Layout]| ImitationSettings {
        left_out_layouts: left_out_layouts.to_vec(),
        ..quick()
    };
    let left_out = [Layout::Ring, Layout::Line];
    let settings = without(&left_out);
    let mut unchanged = 0;
    for index in 0..30 {
        let seed = mission_seed(settings.seed, index);
        let mission = settings.mission(seed).expect("a mission");
        let plain = quick().mission(seed).expect("a mission");
        let uniform = DrawnMission::new(seed, Some(Layout::Uniform), &[]).expect("a mission");
        let drawn = DrawnMission::new(seed, None, &left_out).expect("a mission");
        let layouts = [drawn.layouts.users, drawn.layouts.sensors];
        assert!(!layouts.iter().any(|layout| left_out.contains(layout)));
        let is_uniform = plain == uniform.scenario.mission;
        assert!(mission == drawn.scenario.mission || is_uniform && mission == plain);
        unchanged += usize::from(mission == plain);
    }
    assert!((10..30).contains(&unchanged), "{unchanged}");
    let flown = |left_out: &[Layout]| {
        let held_out = HeldOut::new(6, left_out).expect("missions");
        let network = SetNetwork::new(quick().architecture, FEATURES, 1);
        let flights = held_out.fly(Arch::new(), &network).expect("flies");
        let layouts = flights
            .iter()
            .filter_map(|flown| flown.properties.layouts)
            .flat_map(|layouts| [layouts.users, layouts.sensors]);
        layouts.collect::<Vec<_>>()
    };
    assert!(flown(&[]).iter().any(|layout| left_out.contains(layout)));
    assert!(
        !flown(&left_out)
            .iter()
            .any(|layout| left_out.contains(layout))
    );
    // Where no mission is drawn anywhere in the area, none is forced to be.
    let cornered = without(&[Layout::Uniform, Layout::Ring, Layout::Line]);
    assert!(cornered.mission(1).is_ok());

    let refused = |settings: ImitationSettings| settings.check().expect_err("it is not valid");
    assert!(refused(without(&Layout::ALL)).contains("left_out_layouts must leave"));
    let scenario = scenario::Scenario::shipped("separated").expect("shipped");
    let adapting = ImitationSettings {
        left_out_layouts: vec![Layout::Ring],
        ..ImitationSettings::adapting(&scenario)
    };
    assert!(refused(adapting).contains("left_out_layouts must be empty"));
    assert_eq!(quick().distribution(), "random");
    assert_eq!(
        without(&[Layout::Line, Layout::Ring]).distribution(),
        "random without ring, line"
    );

    // A settings file states the layouts; one of earlier versions leaves none out.
    let text = toml::to_string(&settings).expect("settings");
    assert!(
        text.contains(r#"left_out_layouts = ["ring", "line"]"#),
        "{text}"
    );
    assert_eq!(toml::from_str::<ImitationSettings>(&text), Ok(settings));
    let earlier = toml::to_string(&quick()).expect("settings");
    let earlier = earlier.replace("left_out_layouts = []\n", "");
    assert!(!earlier.contains("left_out"), "{earlier}");
    assert_eq!(toml::from_str::<ImitationSettings>(&earlier), Ok(quick()));
}

/// A run for one mission learns from it alone, comes nearer to its plan, and can be resumed.
#[test]
fn a_network_is_adapted_to_one_mission() {
    let scenario = scenario::Scenario::shipped("separated").expect("shipped");
    let settings = ImitationSettings {
        steps: 120,
        batch: 32,
        first_missions: 2,
        planning_operations: 20_000_000,
        correction_operations: 100_000,
        evaluate_every: 60,
        report_every: 20,
        learning_rate: 3e-3,
        architecture: quick().architecture,
        ..ImitationSettings::adapting(&scenario)
    };
    let demonstration = Demonstration::new(&settings, 3, None, None).expect("a demonstration");
    assert_eq!(demonstration.mission, scenario.mission);
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_owned();
    let threads = Threads::default();
    let half = ImitationSettings {
        steps: 60,
        final_rate_fraction: 1.0,
        ..settings.clone()
    };
    let mut run = Imitation::start(half, None, path.clone(), threads).expect("starts");
    let first = run.run(false).expect("runs").expect("evaluated");
    let mut run = Imitation::resume(path.clone(), Some(120), None, threads).expect("resumes");
    let best = run.run(false).expect("runs").expect("evaluated");
    assert!(best >= first && best > 0.8, "{first} {best}");
    let network =
        crate::any_mission::read_network(&path.join("checkpoint.bin"), false).expect("saved");
    assert_eq!(network.provenance.missions, "one");
    let unknown = ImitationSettings {
        scenario: Some("slots = 3".into()),
        ..settings
    };
    assert!(Imitation::start(unknown, None, path, threads).is_err());
}

/// The network that flies computes what the network that learns does, in 10 states of each of 20
/// missions, within 1e-5 of full scale.
#[test]
fn the_exported_network_computes_the_same() {
    let architecture = Architecture::default();
    let network = SetNetwork::new(architecture, FEATURES, 3);
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let mut parameters = network.export();
    for parameter in &mut parameters {
        *parameter += rng.random_range(-0.03..0.03);
    }
    let trained = TrainedNetwork {
        architecture,
        parameters: parameters.clone(),
        provenance: SetsProvenance {
            algorithm: "none".try_into().expect("short"),
            missions: "none".try_into().expect("short"),
            episodes: 1,
            seed: 3,
        },
    };
    let mut learning = network;
    learning.import(&parameters).expect("its own length");
    let mut work = SetsWork::default();
    let file = trained.to_policy_file(Precision::Single).expect("a file");
    let flying = SetsNetwork::load(file, &mut work).expect("loads");
    for seed in 0..20 {
        let mission = scenario::random(5_000 + seed, None)
            .expect("a mission")
            .mission;
        let p = mission.parameters();
        for slot in 1..=10 {
            let east_m = rng.random_range(0.0..p.area.east_m);
            let north_m = rng.random_range(0.0..p.area.north_m);
            let observation = Observation {
                slot,
                counts: &[],
                rate: 0.0,
                mse: 0.0,
                position: firmware_core::Position::new(east_m, north_m),
                agility: Agility::ideal(&mission),
            };
            let sets = SetsObservation::new(&mission, &observation, &mut Workspace::default());
            let got = flying.evaluate(&sets, &mut work).expect("evaluates");
            let mut policy = SetPolicy::new(&learning, mission.clone(), Arch::new());
            let expected = policy.decide(&observation);
            let scale = expected
                .user_scores
                .iter()
                .fold(1.0, |a: f64, b| a.max(b.abs()));
            for (got, expected) in got.user_scores.iter().zip(&expected.user_scores) {
                assert!((f64::from(*got) - expected).abs() < 1e-5 * scale);
            }
            let [east_m, north_m] = got.displacement_m.map(f64::from);
            let difference =
                (expected.displacement.x - east_m).hypot(expected.displacement.y - north_m);
            assert!(difference < 1e-5 * mission.reach_m(), "{difference}");
        }
    }
}
