// SPDX-License-Identifier: MIT OR Apache-2.0
//! Tests of the file format and of the network.

use super::{format::*, *};
use crate::test_missions::table_one;
use crate::{
    Mission,
    policy::{Provenance, container},
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::{string::ToString, vec, vec::Vec as StdVec};

const SIZES: [u16; 4] = [19, 30, 23, 17];

fn text<const N: usize>(text: &str) -> heapless::String<N> {
    heapless::String::try_from(text).expect("short")
}

fn header() -> Header {
    Header {
        provenance: Provenance {
            users: 15,
            max_speed_mps: 30.0,
            slot_duration_s: 1.0,
            area_m: [1000.0, 1000.0],
            algorithm: text("sac"),
            scenario: text("separated"),
            scenario_digest: text(&"0123456789abcdef".repeat(4)),
            episodes: 4000,
            seed: 1,
        },
        functions: Functions::default(),
        reach_m: 30.0,
        sizes: heapless::Vec::from_slice(&SIZES).expect("short"),
    }
}

/// The network as the module's header defines it, in double precision.
fn reference(functions: Functions, numbers: &[f32], observation: &[f32]) -> StdVec<f64> {
    let limited = |limit, x: f64| match limit {
        Limit::Tanh => x.tanh(),
        Limit::Clip => x.clamp(-1.0, 1.0),
    };
    let number = |i: usize| f64::from(numbers[i]);
    let mut x: StdVec<f64> = (0..19)
        .map(|i| (f64::from(observation[i]) - number(i)) * number(19 + i))
        .collect();
    let mut at = 38;
    for (layer, pair) in SIZES.windows(2).enumerate() {
        let (inputs, outputs) = (usize::from(pair[0]), usize::from(pair[1]));
        x = (0..outputs)
            .map(|o| {
                let bias = number(at + inputs * outputs + o);
                let sum: f64 = (0..inputs)
                    .map(|i| number(at + o * inputs + i) * x[i])
                    .sum();
                match functions.activation {
                    _ if layer == 2 => sum + bias,
                    Activation::Relu => (sum + bias).max(0.0),
                    Activation::Tanh => (sum + bias).tanh(),
                }
            })
            .collect();
        at += outputs * (inputs + 1);
    }
    for u in &mut x[..2] {
        *u = 30.0 * limited(functions.displacement, *u);
    }
    if let Some(limit) = functions.scores {
        x[2..]
            .iter_mut()
            .for_each(|score| *score = limited(limit, *score));
    }
    x
}

fn numbers() -> StdVec<f32> {
    numbers_for(Functions::default())
}

fn numbers_for(functions: Functions) -> StdVec<f32> {
    let mut rng = Pcg64Mcg::seed_from_u64(6);
    let count = header().number_count();
    let mut numbers: StdVec<f32> = (0..count)
        .map(|_| rng.random_range(-0.3_f32..0.3))
        .collect();
    let start = count - 17 - 19;
    let observation = numbers[start..start + 19].to_vec();
    let expected = reference(functions, &numbers, &observation);
    for (slot, value) in numbers[start + 19..].iter_mut().zip(expected) {
        *slot = value as f32;
    }
    numbers
}

fn file() -> StdVec<u8> {
    let mut file = vec![0; 20_000];
    let length = write(&header(), numbers().into_iter(), &mut file).expect("sound");
    file.truncate(length);
    file
}

/// With a matching checksum: only what comes after it is at fault.
fn sealed(mut file: StdVec<u8>) -> StdVec<u8> {
    container::seal(&mut file, FORMAT_VERSION).expect("a preamble");
    file
}

#[test]
fn outputs_agree_with_double_precision() {
    let limits = [Limit::Tanh, Limit::Clip];
    for activation in [Activation::Relu, Activation::Tanh] {
        for displacement in limits {
            for scores in [None, Some(Limit::Tanh), Some(Limit::Clip)] {
                outputs_agree(Functions {
                    activation,
                    displacement,
                    scores,
                });
            }
        }
    }
}

fn outputs_agree(functions: Functions) {
    let mut file = vec![0; 20_000];
    let numbers = numbers_for(functions);
    let header = Header {
        functions,
        ..header()
    };
    let length = write(&header, numbers.iter().copied(), &mut file).expect("sound");
    file.truncate(length);
    let version = crate::policy::format_version(&file);
    let is_default = functions == Functions::default();
    assert_eq!(version, Ok(if is_default { 1 } else { 3 }));
    let policy = Mlp::load(file).expect("sound");
    assert_eq!(policy.header(), &header);
    let mut rng = Pcg64Mcg::seed_from_u64(8);
    for _ in 0..1000 {
        let observation: StdVec<f32> = (0..19).map(|_| rng.random_range(-3.0..3.0)).collect();
        let expected = reference(functions, &numbers, &observation);
        let got = policy.evaluate(&observation);
        assert_eq!(got.len(), expected.len());
        for (i, (got, expected)) in got.iter().zip(&expected).enumerate() {
            let scale = if i < 2 { 30.0 } else { 1.0 };
            assert!(
                (f64::from(*got) - expected).abs() < 1e-5 * scale,
                "{i}: {got} {expected}"
            );
        }
    }
}

/// Any single damaged byte is found, and so is every cut.
#[test]
fn damage_is_found() {
    let file = file();
    for at in (0..file.len()).step_by(13) {
        let mut damaged = file.clone();
        damaged[at] ^= 0x10;
        assert!(Mlp::load(damaged).is_err(), "byte {at}");
        assert!(Mlp::load(&file[..at]).is_err(), "cut at {at}");
    }
}

#[test]
fn each_fault_is_named() {
    let message = |file: StdVec<u8>| Mlp::load(file).expect_err("unsound").to_string();
    let sound = file();
    assert!(message(b"ONNX".to_vec()).contains("UAVP"));
    let mut other = sound.clone();
    other[4] = 9;
    assert_eq!(
        message(other),
        "format version is 9, but this build reads 1"
    );
    let end = sound.len();
    let mut other = sound.clone();
    other[end - 4..].copy_from_slice(&3.5_f32.to_le_bytes());
    assert!(message(sealed(other)).starts_with("self-test: output 16 is "));
    let mut other = sound.clone();
    other[end - 400..end - 396].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(message(sealed(other)).contains("NaN"));
    let mut other = sound.clone();
    other.extend([0; 4]);
    assert!(message(sealed(other)).contains("bytes of numbers"));
    let mut wrong = header();
    wrong.provenance.users = 14;
    let error = write(&wrong, numbers().into_iter(), &mut vec![0; 20_000]);
    assert!(matches!(
        error,
        Err(WriteError::Unsound(LoadError::Shape { users: 14, .. }))
    ));
}

#[test]
fn a_policy_for_another_mission_is_refused_with_both_values() {
    let provenance = header().provenance;
    assert_eq!(provenance.check(&table_one::<f64>()), Ok(()));
    assert_eq!(provenance.check(&table_one::<f32>()), Ok(()));
    let slow = Provenance {
        max_speed_mps: 20.0,
        ..provenance
    };
    let message = slow
        .check(&table_one::<f64>())
        .expect_err("slow")
        .to_string();
    let expected = "the policy is for max_speed_mps = 20, but the mission has 30";
    assert_eq!(message, expected);
}

/// A policy holds its mission's values in single precision, which is no mismatch.
#[test]
fn rounding_to_single_precision_is_not_a_mismatch() {
    let mut parameters = table_one::<f64>().parameters().clone();
    parameters.max_speed_mps = 30.1;
    let mission = Mission::new(parameters).expect("valid");
    let with_speed = |max_speed_mps: f32| Provenance {
        max_speed_mps,
        ..header().provenance
    };
    assert_eq!(with_speed(30.1).check(&mission), Ok(()));
    assert!(with_speed(30.100_1).check(&mission).is_err());
}

/// Wherever a file begins in memory, aligned to words or not, its policy gives the same bits.
#[test]
fn alignment_does_not_matter() {
    let file = file();
    let observation: StdVec<f32> = (0..19).map(|n| 0.3 * n as f32 - 2.0).collect();
    let evaluate = |offset: usize| {
        let mut shifted = vec![0; offset];
        shifted.extend(&file);
        let policy = Mlp::load(&shifted[offset..]).expect("sound");
        policy.evaluate(&observation)
    };
    let expected = evaluate(0);
    assert!(expected.iter().any(|x| x.abs() > 0.01), "{expected:?}");
    for offset in 1..4 {
        assert_eq!(evaluate(offset), expected, "{offset}");
    }
}

/// Layers are 1 to [`WIDTH_MAX`] wide, from users + 4 to users + 2, and the reach is a number above 0.
#[test]
fn a_header_that_makes_no_policy_is_refused() {
    let with_sizes = |sizes: &[u16]| {
        let sizes = heapless::Vec::from_slice(sizes).expect("short");
        Header { sizes, ..header() }.check()
    };
    let most_layers = [19, 8, 8, 8, 8, 8, 17];
    assert_eq!(most_layers.len(), LAYERS_MAX + 1);
    for sound in [
        &[19, 17][..],
        &[19, 1, 17],
        &[19, 256, 256, 17],
        &most_layers,
    ] {
        assert_eq!(with_sizes(sound), Ok(()));
    }
    for unsound in [
        &[][..],
        &[19],
        &[17],
        &[19, 0, 17],
        &[19, 257, 17],
        &[18, 17],
        &[19, 18],
    ] {
        let error = with_sizes(unsound).expect_err("unsound");
        assert!(matches!(error, LoadError::Shape { .. }), "{error}");
    }
    for reach_m in [0.0, -30.0, f32::INFINITY, f32::NAN] {
        let wrong = Header {
            reach_m,
            ..header()
        };
        let error = wrong.check().expect_err("unsound");
        assert!(matches!(error, LoadError::Reach { .. }), "{error}");
    }
}

/// The self-test measures displacements by the reach and scores by the largest of them.
#[test]
fn a_test_vector_is_compared_at_its_own_scale() {
    let sound = file();
    let first_output = sound.len() - 4 * 17;
    let load_with_error = |index: usize, error: f32| {
        let at = first_output + 4 * index;
        let mut other = sound.clone();
        let expected = f32::from_le_bytes(other[at..at + 4].try_into().expect("four bytes"));
        other[at..at + 4].copy_from_slice(&(expected + error).to_le_bytes());
        Mlp::load(sealed(other)).map(|_| ())
    };
    for index in 0..17 {
        let full_scale = if index < 2 { 30.0 } else { 1.0 };
        for (fraction, close) in [(0.5, true), (2.0, false)] {
            let outcome = load_with_error(index, fraction * SELF_TEST_TOLERANCE * full_scale);
            assert_eq!(outcome.is_ok(), close, "{index}: {outcome:?}");
        }
    }
}

/// The numbers of a policy are not part of what `Debug` prints.
#[test]
fn debug_prints_the_header() {
    let policy = Mlp::load(file()).expect("sound");
    let text = std::format!("{policy:?}");
    assert_eq!(
        text,
        std::format!("Mlp {{ header: {:?}, .. }}", policy.header())
    );
}
