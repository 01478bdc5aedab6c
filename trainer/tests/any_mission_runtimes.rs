//! All runtimes of a policy for any mission (tract and the allocator-free network) agree, and files
//! come back as they were written. Needs the feature `onnx`.

use firmware_core::policy::{
    onnx::SetsOnnx,
    sets::{EvaluateSets, NetworkWithWork, Precision, SetsNetwork, SetsProvenance, SetsWork},
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trainer::{
    imitation::{
        encoder::FEATURES,
        states::{Difference, random_states},
        trained::TrainedNetwork,
    },
    nn::sets::{Architecture, SetNetwork},
    onnx::sets,
};

/// Returns an untrained network of full size, whose outputs depend on all inputs.
fn network() -> TrainedNetwork {
    let architecture = Architecture::default();
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let mut parameters = SetNetwork::new(architecture, FEATURES, 3).export();
    for parameter in &mut parameters {
        *parameter += rng.random_range(-0.03..0.03);
    }
    TrainedNetwork {
        architecture,
        parameters,
        provenance: SetsProvenance {
            algorithm: "none".try_into().expect("short"),
            missions: "random".try_into().expect("short"),
            episodes: 7,
            seed: 3,
        },
    }
}

/// Outputs agree within 1e-5 of full scale, in both precisions. (`trainer probe --tract` compares the
/// shipped policy on 10,000 states, in .ci/interop/any_policy_check.py.)
#[test]
fn runtimes_agree() {
    let network = network();
    for (precision, states) in [(Precision::Half, 500), (Precision::Single, 100)] {
        let file = sets::write(&network, precision).expect("fits");
        let mut tract = SetsOnnx::load(&file).expect("sound");
        assert_eq!(tract.provenance(), &network.provenance);
        let mut work = Box::<SetsWork>::default();
        let policy = network.to_policy_file(precision).expect("fits");
        let network = SetsNetwork::load(policy, &mut work).expect("sound");
        let mut flying = NetworkWithWork { network, work };
        let mut checked = 0;
        let mut difference = Difference::default();
        let visited = random_states(states, 4, |observation| {
            let expected = flying.evaluate(observation).expect("fits");
            let got = tract.evaluate(observation).expect("runs");
            let [_, _, _, _, _, _, _, reach_m, ..] = observation.mission;
            difference.note(&got, &expected, reach_m);
            checked += 1;
            Ok(())
        });
        visited.expect("missions");
        assert_eq!(checked, states);
        assert!(difference.of_full_scale() <= 1e-5, "{difference:?}");
    }
}

/// What is read from a file is what was written; in half precision, the rounded weights.
#[test]
fn files_come_back() {
    let network = network();
    let single = sets::write(&network, Precision::Single).expect("fits");
    let (read, precision) = sets::parse(&single).expect("sound");
    assert_eq!((&read, precision), (&network, Precision::Single));
    let half = sets::write(&network, Precision::Half).expect("fits");
    let (read, precision) = sets::parse(&half).expect("sound");
    assert_eq!(precision, Precision::Half);
    assert_ne!(read, network);
    assert_eq!(sets::write(&read, Precision::Half).expect("fits"), half);
    let policy = network.to_policy_file(Precision::Half).expect("fits");
    assert_eq!(read.to_policy_file(Precision::Half).expect("fits"), policy);
    assert!(half.len() < 384 * 1024, "{}", half.len());
}

/// A file with other weights than its test vector expects is refused by both readers, and so is one
/// that is cut.
#[test]
fn unsound_files_are_refused() {
    let file = sets::write(&network(), Precision::Single).expect("fits");
    // In the middle of the weights of a linear map.
    let mut changed = file.clone();
    let at = changed.len() / 2;
    for byte in &mut changed[at..at + 64] {
        *byte = 0x3f;
    }
    let ours = sets::parse(&changed).expect_err("unsound").to_string();
    assert!(ours.contains("self-test: output"), "{ours}");
    let tract = SetsOnnx::load(&changed).expect_err("unsound").to_string();
    assert!(tract.contains("self-test: output"), "{tract}");
    for cut in [0, 100, file.len() / 2, file.len() - 1] {
        assert!(sets::parse(&file[..cut]).is_err(), "cut at {cut}");
        assert!(SetsOnnx::load(&file[..cut]).is_err(), "cut at {cut}");
    }
}

/// `models/any.policy`, which is what `host-sim run --policy any` flies, is made from
/// `models/any.onnx`.
#[test]
fn the_shipped_files_belong_together() {
    let onnx = include_bytes!("../../models/any.onnx");
    let (network, precision) = sets::parse(onnx).expect("sound");
    let policy = network.to_policy_file(precision).expect("fits");
    assert!(policy == include_bytes!("../../models/any.policy"));
    assert!(sets::write(&network, precision).expect("fits") == onnx);
}
