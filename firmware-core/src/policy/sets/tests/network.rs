// SPDX-License-Identifier: MIT OR Apache-2.0
//! Tests of the network.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::vec::Vec as StdVec;

use super::{
    missions::{mission, parameters, state},
    reference,
};
use crate::policy::sets::*;

/// The intended sizes, the smallest, the largest, and one whose hidden layer is no multiple of
/// anything.
pub(super) const ARCHITECTURES: [Architecture; 4] = [
    Architecture {
        width: 64,
        hidden: 192,
        layers: 3,
    },
    Architecture {
        width: 4,
        hidden: 1,
        layers: 1,
    },
    Architecture {
        width: 96,
        hidden: 288,
        layers: 4,
    },
    Architecture {
        width: 20,
        hidden: 31,
        layers: 2,
    },
];

fn bytes(weights: &[f32]) -> StdVec<[u8; 4]> {
    weights.iter().map(|weight| weight.to_le_bytes()).collect()
}

fn evaluate(
    architecture: &Architecture,
    weights: &[[u8; 4]],
    observation: &SetsObservation,
) -> SetsOutput {
    let mut work = SetsWork::default();
    work.evaluate(architecture, weights, observation)
        .expect("the right number of weights")
}

/// The largest difference, of the displacement as a fraction of the reach, of the scores as one of
/// the largest.
fn difference(
    observation: &SetsObservation,
    output: &SetsOutput,
    (displacement, scores): &(StdVec<f64>, StdVec<f64>),
) -> f64 {
    let reach_m = f64::from(observation.reach_m());
    let largest = scores
        .iter()
        .fold(1.0_f64, |largest, score| largest.max(score.abs()));
    let displacement = displacement.iter().zip(output.displacement_m);
    let displacement = displacement.map(|(a, b)| (a - f64::from(b)).abs() / reach_m);
    let scores = scores.iter().zip(output.user_scores);
    let scores = scores.map(|(a, b)| (a - f64::from(b)).abs() / largest);
    displacement.chain(scores).fold(0.0, f64::max)
}

/// Every architecture agrees with the definition, for every number of users.
#[test]
fn outputs_agree_with_the_definition() {
    let mut random = Pcg64Mcg::seed_from_u64(11);
    let mut uncut = 0;
    for architecture in &ARCHITECTURES {
        let weights = reference::weights(&mut random, architecture);
        let stored = bytes(&weights);
        for users in 1..=16 {
            let mut p = parameters(&mut random);
            while p.users.len() != users {
                p = parameters(&mut random);
            }
            let state = state(&mut random, &p);
            let mut observation = state.observe(&mission::<f32>(&p));
            if users % 2 == 0 {
                // Far enough that not every displacement is cut.
                observation.mission[7] = 2000.0;
            }
            let output = evaluate(architecture, &stored, &observation);
            let expected = reference::evaluate(architecture, &weights, &observation);
            let difference = difference(&observation, &output, &expected);
            assert!(difference < 1e-5, "{architecture:?} {users}: {difference}");
            let [east_m, north_m] = output.displacement_m;
            let reach_m = observation.reach_m();
            assert!(east_m.hypot(north_m) <= reach_m * 1.00001);
            uncut += usize::from(east_m.hypot(north_m) < reach_m * 0.99);
            assert_eq!(output.user_scores[users..], [0.0; 16][users..]);
        }
    }
    assert!((5..64).contains(&uncut), "{uncut}");
}

/// What is in rows beyond the users and sensors, and in the memory, has no effect.
#[test]
fn padding_and_memory_are_inert() {
    let mut random = Pcg64Mcg::seed_from_u64(12);
    let architecture = &ARCHITECTURES[0];
    let stored = bytes(&reference::weights(&mut random, architecture));
    let mut used = SetsWork::default();
    for _ in 0..20 {
        let p = parameters(&mut random);
        let mut observation = state(&mut random, &p).observe(&mission::<f32>(&p));
        let output = evaluate(architecture, &stored, &observation);
        let (users, sensors) = (observation.user_count, observation.sensor_count);
        observation.users[users..].as_flattened_mut().fill(f32::NAN);
        observation.sensors[sensors..].as_flattened_mut().fill(77.0);
        assert_eq!(evaluate(architecture, &stored, &observation), output);
        let again = used.evaluate(architecture, &stored, &observation);
        assert_eq!(again, Some(output));
        // The same observation with a NaN, which must not remain in the memory.
        observation.users[0][3] = f32::NAN;
        observation.sensors[0][0] = f32::NAN;
        let broken = used
            .evaluate(architecture, &stored, &observation)
            .expect("fits");
        assert!(broken.displacement_m[0].is_nan());
    }
}

/// Permuting users permutes scores and leaves the displacement, permuting sensors leaves all.
#[test]
fn permutations_permute_scores() {
    let mut random = Pcg64Mcg::seed_from_u64(13);
    let architecture = &ARCHITECTURES[0];
    let stored = bytes(&reference::weights(&mut random, architecture));
    for _ in 0..20 {
        let p = parameters(&mut random);
        let observation = state(&mut random, &p).observe(&mission::<f32>(&p));
        let output = evaluate(architecture, &stored, &observation);
        let users = observation.user_count;
        let mut order: StdVec<usize> = (0..users).collect();
        order.rotate_left(random.random_range(0..users));
        order.swap(0, users / 2);
        let mut permuted = observation.clone();
        for (place, &user) in order.iter().enumerate() {
            permuted.users[place] = observation.users[user];
        }
        permuted.sensors[..observation.sensor_count].reverse();
        let result = evaluate(architecture, &stored, &permuted);
        let scores = |output: &SetsOutput| output.user_scores.map(f64::from);
        let expected = (
            output.displacement_m.map(f64::from).to_vec(),
            order.iter().map(|&user| scores(&output)[user]).collect(),
        );
        let difference = difference(&observation, &result, &expected);
        assert!(difference < 1e-5, "{difference}");
    }
}

/// Weights that are too few are not evaluated.
#[test]
fn missing_weights_are_found() {
    let mut random = Pcg64Mcg::seed_from_u64(14);
    let architecture = &ARCHITECTURES[3];
    let stored = bytes(&reference::weights(&mut random, architecture));
    let p = parameters(&mut random);
    let observation = state(&mut random, &p).observe(&mission::<f32>(&p));
    let mut work = SetsWork::default();
    for count in [0, 1, 500, stored.len() - 1] {
        let output = work.evaluate(architecture, &stored[..count], &observation);
        assert_eq!(output, None);
    }
}

/// An observation without rows, which no mission has, gives finite numbers.
#[test]
fn empty_sets_are_evaluated() {
    let mut random = Pcg64Mcg::seed_from_u64(15);
    let architecture = &ARCHITECTURES[3];
    let stored = bytes(&reference::weights(&mut random, architecture));
    let mut observation = SetsObservation::default();
    observation.mission[7] = 30.0;
    let output = evaluate(architecture, &stored, &observation);
    assert!(output.displacement_m.iter().all(|x| x.is_finite()));
    assert_eq!(output.user_scores, [0.0; USERS]);
}
