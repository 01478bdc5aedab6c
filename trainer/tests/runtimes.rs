//! All runtimes of a policy (tract, the allocator-free MLP and double precision) agree and reject
//! invalid files. Needs the feature `onnx`.

use environment::Allocation;
use environment::Environment;
use firmware_core::policy::{
    mlp::Mlp,
    onnx::{OnnxError, OnnxPolicy},
};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;
use trainer::{
    actor::Actor,
    evaluate::fly,
    learner::Learner,
    onnx,
    sac::Sac,
    settings::{Algorithm, Preset, TrainingSettings},
};

/// Returns an untrained policy of full size.
fn actor(name: &str) -> Actor {
    let scenario = Scenario::shipped(name).expect("shipped");
    let settings = TrainingSettings::preset(Preset::Paper, Algorithm::Sac, 3);
    let environment = Environment::new(scenario.mission.clone(), &settings.environment_settings());
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let learner = Sac::new(&settings, environment.dimensions(), &mut rng);
    Actor::new(learner.deterministic(), &scenario, &settings, 0)
}

/// Outputs agree within 1e-5 of full scale on 10,000 observations.
#[test]
fn runtimes_agree() {
    let actor = actor("separated");
    let mut tract = OnnxPolicy::load(&onnx::write(&actor)).expect("sound");
    let mlp = Mlp::load(actor.to_policy_file().expect("fits")).expect("sound");
    assert_eq!(tract.provenance(), &actor.provenance);
    assert_eq!(mlp.provenance(), &actor.provenance);
    let mut rng = Pcg64Mcg::seed_from_u64(4);
    for _ in 0..10_000 {
        let observation = actor.random_observation(&mut rng);
        let expected = actor.evaluate(&observation);
        let got = [
            tract.evaluate(&observation).expect("runs"),
            mlp.evaluate(&observation).to_vec(),
        ];
        for got in got {
            assert_eq!(got.len(), expected.len());
            for (i, (got, expected)) in got.iter().zip(&expected).enumerate() {
                let scale = if i < 2 { 30.0 } else { 1.0 };
                let error = (f64::from(*got) - expected).abs();
                assert!(error <= 1e-5 * scale, "output {i}: {got} {expected}");
            }
        }
    }
}

/// Over a mission, both runtimes serve the same users and reach the same rate.
#[test]
fn runtimes_fly_alike() {
    for name in ["separated", "mixed"] {
        let mission = Scenario::shipped(name).expect("shipped").mission;
        let actor = actor(name);
        let tract = OnnxPolicy::load(&onnx::write(&actor)).expect("sound");
        let mlp = Mlp::load(actor.to_policy_file().expect("fits")).expect("sound");
        let (tract, mlp) = (
            fly(&mission, tract, Allocation::Exact).expect("flies"),
            fly(&mission, mlp, Allocation::Exact).expect("flies"),
        );
        assert_eq!(tract.served_users, mlp.served_users);
        assert!((tract.sum_rate - mlp.sum_rate).abs() < 1e-3);
        assert!(tract.arrived && tract.fair);
    }
}

#[test]
fn what_is_read_back_is_what_was_written() {
    let actor = actor("mixed");
    let bytes = onnx::write(&actor);
    let back = onnx::read::parse(&bytes).expect("sound");
    assert_eq!(back, actor);
    assert_eq!(onnx::write(&back), bytes);
}

#[test]
fn unsound_files_are_refused_with_a_reason() {
    let sound = actor("separated");
    let refuse = |bytes: &[u8]| {
        let tract = OnnxPolicy::load(bytes).expect_err("unsound");
        let ours = onnx::read::parse(bytes).expect_err("unsound");
        assert!(!tract.to_string().contains('\n'), "{tract}");
        (tract, format!("{ours:#}"))
    };
    let (tract, _) = refuse(b"not a network");
    assert!(matches!(tract, OnnxError::Network { .. }), "{tract}");

    // Weights that do not reproduce the test vector.
    let mut bytes = onnx::write(&sound);
    let mut wrong = sound.clone();
    wrong.layers[1].bias[3] += 1.0;
    let wrong = onnx::write(&wrong);
    let bias: Vec<u8> = sound.layers[1]
        .bias
        .iter()
        .flat_map(|x| x.to_le_bytes())
        .collect();
    let at = bytes
        .windows(bias.len())
        .position(|w| w == bias)
        .expect("is there");
    bytes[at..at + bias.len()].copy_from_slice(&wrong[at..at + bias.len()]);
    let (tract, ours) = refuse(&bytes);
    assert!(matches!(tract, OnnxError::SelfTest { .. }), "{tract}");
    assert!(ours.contains("self-test: output "), "{ours}");

    // A missing metadata key; its replacement has the same length, so the file stays well formed.
    let bytes = onnx::write(&sound);
    let mut other = bytes.clone();
    let key = b"test_observation";
    let at = bytes
        .windows(key.len())
        .position(|w| w == key)
        .expect("is there");
    other[at] = b'b';
    let (tract, ours) = refuse(&other);
    assert_eq!(
        tract,
        OnnxError::Missing {
            keys: "test_observation".into()
        }
    );
    assert!(
        ours.contains("metadata_props has no test_observation"),
        "{ours}"
    );

    // All missing keys come in one message.
    let key = b"scenario_digest";
    let at = other.windows(key.len()).position(|w| w == key);
    other[at.expect("is there")] = b'x';
    let (tract, ours) = refuse(&other);
    let words = "metadata_props has no scenario_digest, test_observation";
    assert!(tract.to_string().contains(words), "{tract}");
    assert!(ours.contains(words), "{ours}");

    // Another input name.
    let mut other = bytes.clone();
    while let Some(at) = other.windows(11).position(|w| w == b"observation") {
        let named = other[at - 1] == 11;
        other[at] = if named { b'x' } else { b'y' };
    }
    assert!(OnnxPolicy::load(&other).is_err());

    for cut in [1, 100, bytes.len() / 2, bytes.len() - 1] {
        assert!(OnnxPolicy::load(&bytes[..cut]).is_err(), "cut at {cut}");
        assert!(onnx::read::parse(&bytes[..cut]).is_err(), "cut at {cut}");
    }
}
