// SPDX-License-Identifier: MIT OR Apache-2.0
//! Tests of the file format.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::{string::ToString, vec, vec::Vec as StdVec};

use super::{
    missions::{mission, parameters, state},
    network::ARCHITECTURES,
    reference,
};
use crate::policy::{ContainerError, container, format_version, mlp::Mlp, sets::*};

fn text<const N: usize>(text: &str) -> heapless::String<N> {
    heapless::String::try_from(text).expect("short")
}

fn provenance() -> SetsProvenance {
    SetsProvenance {
        algorithm: text("imitation"),
        missions: text("random"),
        episodes: 20_000,
        seed: 7,
    }
}

/// What a file is made of.
pub(super) struct Parts {
    pub(super) header: SetsHeader,
    pub(super) weights: StdVec<f32>,
    pub(super) test: SetsObservation,
}

pub(super) fn parts(architecture: Architecture, precision: Precision) -> Parts {
    let mut random = Pcg64Mcg::seed_from_u64(21);
    let weights = reference::weights(&mut random, &architecture);
    let p = parameters(&mut random);
    let test = state(&mut random, &p).observe(&mission::<f32>(&p));
    Parts {
        header: SetsHeader::new(provenance(), architecture, precision, &test),
        weights,
        test,
    }
}

impl Parts {
    pub(super) fn write(&self) -> Result<StdVec<u8>, SetsWriteError> {
        let mut file = vec![0; 2_000_000];
        let weights = self.weights.iter().copied();
        let mut work = SetsWork::default();
        let length = write(&self.header, weights, &self.test, &mut work, &mut file)?;
        file.truncate(length);
        Ok(file)
    }
}

pub(super) fn file() -> StdVec<u8> {
    parts(ARCHITECTURES[3], Precision::Half)
        .write()
        .expect("sound")
}

pub(super) fn load(file: StdVec<u8>) -> Result<SetsNetwork<StdVec<u8>>, SetsLoadError> {
    SetsNetwork::load(file, &mut SetsWork::default())
}

/// With a matching checksum: only what comes after it is at fault.
fn sealed(mut file: StdVec<u8>) -> StdVec<u8> {
    container::seal(&mut file, FORMAT_VERSION).expect("a preamble");
    file
}

/// A file holds header and network; in half precision its weights are rounded.
#[test]
fn files_are_written_and_loaded() {
    for architecture in ARCHITECTURES {
        for precision in [Precision::Half, Precision::Single] {
            let parts = parts(architecture, precision);
            let file = parts.write().expect("sound");
            assert_eq!(format_version(&file), Ok(2));
            let network = load(file).expect("sound");
            assert_eq!(network.header(), &parts.header);
            assert_eq!(network.provenance(), &provenance());
            let rounded = |&weight: &f32| match precision {
                Precision::Half => half::to_single(half::from_single(weight)),
                Precision::Single => weight,
            };
            let weights: StdVec<f32> = parts.weights.iter().map(rounded).collect();
            let mut work = SetsWork::default();
            let output = network.evaluate(&parts.test, &mut work).expect("fits");
            let (displacement_m, _) = reference::evaluate(&architecture, &weights, &parts.test);
            for (got, expected) in output.displacement_m.into_iter().zip(displacement_m) {
                let error = (f64::from(got) - expected).abs();
                assert!(error < 1e-5 * f64::from(parts.test.reach_m()), "{error}");
            }
        }
    }
}

/// The file of the intended size fits into 384 KiB.
#[test]
fn the_intended_file_is_small_enough() {
    let file = parts(ARCHITECTURES[0], Precision::Half)
        .write()
        .expect("sound");
    assert!(file.len() < 384 * 1024, "{}", file.len());
}

/// Any single damaged byte is found, and so is every cut.
#[test]
fn damage_is_found() {
    let file = file();
    for at in (0..file.len()).step_by(13) {
        let mut damaged = file.clone();
        damaged[at] ^= 0x10;
        assert!(load(damaged).is_err(), "byte {at}");
        assert!(load(file[..at].to_vec()).is_err(), "cut at {at}");
    }
}

/// Files with random damage and a matching checksum are refused or loaded, without a panic; what is
/// loaded can be evaluated.
#[test]
fn damage_behind_the_checksum_does_no_harm() {
    let sound = file();
    let test = parts(ARCHITECTURES[3], Precision::Half).test;
    let mut random = Pcg64Mcg::seed_from_u64(22);
    let (mut refused, mut loaded) = (0, 0);
    for round in 0..3000 {
        let mut file = sound.clone();
        // The header is short: half of the rounds damage only its bytes and the first weights.
        let most = if round % 2 == 0 { 120 } else { file.len() };
        for _ in 0..random.random_range(1..4) {
            let at = random.random_range(10..most);
            file[at] = random.random_range(0..=255);
        }
        if random.random_range(0..8) == 0 {
            file.truncate(random.random_range(10..=sound.len()));
        }
        match load(sealed(file)) {
            Ok(network) => {
                let output = network.evaluate(&test, &mut SetsWork::default());
                assert!(output.is_some());
                loaded += 1;
            }
            Err(_) => refused += 1,
        }
    }
    assert!(refused > 1000 && loaded > 50, "{refused} {loaded}");
}

#[test]
fn each_fault_is_named() {
    let message = |file: StdVec<u8>| load(file).expect_err("unsound").to_string();
    let sound = file();
    assert!(message(b"ONNX".to_vec()).contains("UAVP"));
    let mut other = sound.clone();
    other[4] = 9;
    assert_eq!(
        message(other),
        "format version is 9, but this build reads 2"
    );
    let mut other = sound.clone();
    other[100] ^= 1;
    assert!(message(other).contains("the file is damaged"));
    let end = sound.len();
    // The last number is a score; before it are the displacement and the columns.
    let mut other = sound.clone();
    other[end - 4..].copy_from_slice(&3.5_f32.to_le_bytes());
    assert!(message(sealed(other)).starts_with("self-test: output "));
    let mut other = sound.clone();
    other[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    let message_of_nan = message(sealed(other));
    assert!(
        message_of_nan.starts_with("test number "),
        "{message_of_nan}"
    );
    let parts = parts(ARCHITECTURES[3], Precision::Half);
    let users = parts.test.user_count;
    let test_bytes = 4 * (MISSION_COLUMNS + users * (USER_COLUMNS + 1) + 2)
        + 4 * parts.test.sensor_count * SENSOR_COLUMNS;
    // An infinity in half precision as the last weight.
    let mut other = sound.clone();
    other[end - test_bytes - 2..end - test_bytes].copy_from_slice(&0x7c00_u16.to_le_bytes());
    let last = parts.weights.len() - 1;
    assert_eq!(
        message(sealed(other)),
        std::format!("weight {last} is not finite")
    );
    let mut other = sound.clone();
    let reach = end - test_bytes + 4 * 7;
    other[reach..reach + 4].copy_from_slice(&0.0_f32.to_le_bytes());
    assert!(message(sealed(other)).starts_with("reach_m of the test vector is 0"));
    let mut other = sound.clone();
    other.extend([0; 4]);
    assert!(message(sealed(other)).contains("bytes of weights and test vector"));
    let mut other = sound.clone();
    // The length of the first text exceeds its capacity.
    other[10] = 200;
    assert_eq!(message(sealed(other)), "the header cannot be decoded");
}

/// What cannot be loaded is not written.
#[test]
fn unsound_parts_are_not_written() {
    let sound = || parts(ARCHITECTURES[3], Precision::Half);
    let message = |parts: Parts| parts.write().expect_err("unsound").to_string();
    for (architecture, words) in [
        ((22, 31, 2), "the width is 22, but must be a multiple of 4"),
        ((0, 31, 2), "the width is 0"),
        ((100, 31, 2), "the width is 100"),
        ((20, 0, 2), "the width of the hidden layer is 0"),
        ((20, 289, 2), "the width of the hidden layer is 289"),
        ((20, 31, 0), "the number of layers is 0"),
        ((20, 31, 5), "the number of layers is 5, but must be 1 to 4"),
    ] {
        let (width, hidden, layers) = architecture;
        let mut parts = sound();
        parts.header.architecture = Architecture {
            width,
            hidden,
            layers,
        };
        let message = message(parts);
        assert!(message.starts_with(words), "{message}");
    }
    let mut parts = sound();
    parts.weights.pop();
    assert!(message(parts).contains("bytes of weights"));
    let mut parts = sound();
    parts.weights[5] = 1e5;
    assert_eq!(message(parts), "weight 5 is not finite");
    let mut parts = sound();
    let empty = SetsObservation::default();
    parts.header = SetsHeader::new(provenance(), ARCHITECTURES[3], Precision::Half, &empty);
    assert_eq!(
        message(parts),
        "the test vector has 0 users, but must have 1 to 16"
    );
    // The header is for another test vector.
    let mut parts = sound();
    parts.test.user_count -= 1;
    assert!(parts.write().is_err());
    let parts = sound();
    let (header, test) = (&parts.header, &parts.test);
    let length = file().len();
    for capacity in [0, 5, 30, 100, length - 1] {
        let (mut work, mut file) = (SetsWork::default(), vec![0; capacity]);
        let outcome = write(
            header,
            parts.weights.iter().copied(),
            test,
            &mut work,
            &mut file,
        );
        assert_eq!(outcome, Err(SetsWriteError::TooLong { capacity }));
    }
}

/// A file of one version is not taken for one of the other.
#[test]
fn versions_are_not_mixed_up() {
    let error = Mlp::load(file()).expect_err("another version").to_string();
    assert_eq!(error, "format version is 2, but this build reads 1");
    assert_eq!(format_version(b"UAV"), Err(ContainerError::NotAPolicy));
    let mut other = file();
    container::seal(&mut other, 1).expect("a preamble");
    assert!(matches!(
        load(other),
        Err(SetsLoadError::Container(ContainerError::Version {
            got: 1,
            expected: 2
        }))
    ));
}

/// A number of columns that this build does not have is named.
#[test]
fn other_columns_are_refused() {
    let sound = file();
    let header = parts(ARCHITECTURES[3], Precision::Half).header;
    let mut memory = [0; 200];
    let encoded = postcard::to_slice(&header, &mut memory).expect("encoded");
    assert_eq!(sound[10..10 + encoded.len()], *encoded);
    // Columns and counts of the test vector are the last five numbers, each below 128.
    let columns = 10 + encoded.len() - 5;
    let mut other = sound.clone();
    other[columns] += 1;
    let error = load(sealed(other)).expect_err("other columns").to_string();
    assert_eq!(
        error,
        "the policy observes 45 columns of a mission, but this build has 44"
    );
    let mut other = sound.clone();
    other[columns + 3] = 17;
    let error = load(sealed(other)).expect_err("too many users").to_string();
    assert_eq!(error, "the test vector has 17 users, but must have 1 to 16");
}
