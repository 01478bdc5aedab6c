//! The whole network: against double precision, numerically differentiated, and its symmetries.

use pulp::Arch;
use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_pcg::Pcg64Mcg;

use super::{
    Activations, Architecture, BatchGradient, FeatureSizes, SetBatch, SetNetwork, batch::SetState,
    reference,
};
use crate::nn::{arch::every_arch, reference::check_gradient};

pub(super) const SMALL: Architecture = Architecture {
    width: 32,
    hidden: 48,
    layers: 2,
};
pub(super) const FEATURES: FeatureSizes = FeatureSizes {
    mission: 7,
    user: 5,
    sensor: 3,
};
pub(super) const SENSORS: usize = 3;
/// Numbers of users: the smallest and the largest of a mission, and more than a vector's lanes.
pub(super) const USERS: [usize; 5] = [1, 4, 16, 15, 9];

/// The inputs of one state.
#[derive(Clone)]
pub(super) struct State {
    pub(super) mission: Vec<f32>,
    users: Vec<f32>,
    sensors: Vec<f32>,
    to_users: Vec<[f32; 2]>,
    to_destination: [f32; 2],
}

impl State {
    pub(super) fn random(users: usize, rng: &mut Pcg64Mcg) -> Self {
        let mut numbers =
            |n: usize| -> Vec<f32> { (0..n).map(|_| rng.random_range(-1.0..1.0)).collect() };
        Self {
            mission: numbers(FEATURES.mission),
            users: numbers(users * FEATURES.user),
            sensors: numbers(SENSORS * FEATURES.sensor),
            // Long and short ways, so that the displacement's length is limited in some states.
            to_users: (0..users)
                .map(|_| {
                    [(); 2]
                        .map(|()| numbers(1)[0] * if users.is_multiple_of(2) { 9.0 } else { 0.3 })
                })
                .collect(),
            to_destination: [(); 2].map(|()| 0.3 * numbers(1)[0]),
        }
    }

    pub(super) fn view(&self) -> SetState<'_> {
        SetState {
            mission: &self.mission,
            users: &self.users,
            sensors: &self.sensors,
            to_users: &self.to_users,
            to_destination: self.to_destination,
        }
    }
}

/// Returns a network whose heads have large weights, so that they matter, and states.
fn setup() -> (SetNetwork, Vec<State>) {
    let mut rng = Pcg64Mcg::seed_from_u64(11);
    let mut network = SetNetwork::new(SMALL, FEATURES, 5);
    let mut values = network.export();
    for value in &mut values {
        *value = *value * 1.2 + rng.random_range(-0.15..0.15);
    }
    network.import(&values).expect("its own length");
    let states = USERS.map(|users| State::random(users, &mut rng)).to_vec();
    (network, states)
}

fn evaluate(arch: Arch, network: &SetNetwork, states: &[State]) -> (Vec<[f32; 2]>, Vec<f32>) {
    let mut batch = SetBatch::new(FEATURES);
    for state in states {
        batch.push(&state.view());
    }
    let mut activations = Activations::default();
    activations.forward(arch, network, &batch);
    let outputs = activations.outputs();
    (outputs.displacement.clone(), outputs.scores.clone())
}

pub(super) fn assert_close(got: &[f32], expected: &[f32]) {
    assert_eq!(got.len(), expected.len());
    for (got, expected) in got.iter().zip(expected) {
        assert!((got - expected).abs() < 2e-5, "{got} {expected}");
    }
}

#[test]
fn forward_agrees_with_double_precision() {
    let (network, states) = setup();
    let parameters: Vec<f64> = network.export().iter().map(|&x| x.into()).collect();
    let (displacement, scores) = evaluate(Arch::new(), &network, &states);
    let mut expected_scores = Vec::new();
    for (state, v) in states.iter().zip(displacement) {
        let (expected, scores) = reference::forward(SMALL, &state.view(), &parameters);
        assert_close(&v, &expected.map(|x| x as f32));
        expected_scores.extend(scores.iter().map(|&x| x as f32));
    }
    assert_close(&scores, &expected_scores);
    // Both branches of the limit on the length are taken.
    let lengths: Vec<f64> = (states.iter())
        .map(|state| reference::forward(SMALL, &state.view(), &parameters).0)
        .map(|v| v[0].hypot(v[1]))
        .collect();
    assert!(lengths.iter().any(|&l| l > 1.0 - 1e-9) && lengths.iter().any(|&l| l < 0.99));
}

/// Every parameter, with a loss that has a gradient in every output.
#[test]
fn gradients_match_finite_differences() {
    let (network, states) = setup();
    let weight = |i: usize| ((i * 37 % 11) as f64 - 5.0) / 5.0;
    let mut gradients = BatchGradient::new(&network, 2);
    let (gradient, losses) = gradients.gradient(
        Arch::new(),
        &network,
        states.len(),
        |range, batch| {
            range.clone().for_each(|i| batch.push(&states[i].view()));
            range
        },
        |range, batch, outputs, gradient, losses| {
            let mut total = 0.0;
            for (index, state) in range.clone().enumerate() {
                for i in 0..2 {
                    let v = outputs.displacement[index][i];
                    gradient.displacement[index][i] = v + weight(state + i) as f32;
                    total += f64::from(v * (0.5 * v + weight(state + i) as f32));
                }
                for (m, user) in batch.users_of(index).enumerate() {
                    let s = outputs.scores[user];
                    gradient.scores[user] = s + weight(state * m) as f32;
                    total += f64::from(s * (0.5 * s + weight(state * m) as f32));
                }
            }
            losses.resize(1, 0.0);
            losses[0] += total;
        },
    );
    let loss = |parameters: &[f64]| {
        let mut total = 0.0;
        for (n, state) in states.iter().enumerate() {
            let (v, scores) = reference::forward(SMALL, &state.view(), parameters);
            total += (0..2)
                .map(|i| v[i] * (0.5 * v[i] + weight(n + i)))
                .sum::<f64>();
            let scores = scores.iter().enumerate();
            total += scores
                .map(|(m, s)| s * (0.5 * s + weight(n * m)))
                .sum::<f64>();
        }
        total / states.len() as f64
    };
    let at: Vec<f64> = network.export().iter().map(|&x| x.into()).collect();
    assert!((loss(&at) - losses[0]).abs() < 1e-5, "{losses:?}");
    let gradient = network.layout().without_padding(gradient);
    let parameters = network.export();
    // Each group has a scale of its own, so that the small ones are checked as well.
    let mut start = 0;
    for part in network.layout().parts() {
        let sizes = match part {
            super::layout::Part::Linear(l) => vec![l.inputs * l.outputs, l.outputs],
            super::layout::Part::Scales(_, count) => vec![count],
        };
        for len in sizes {
            let range = start..start + len;
            start += len;
            let mut at = at.clone();
            check_gradient(
                &parameters[range.clone()],
                &gradient[range.clone()],
                len.min(40),
                |changed| {
                    at[range.clone()].copy_from_slice(changed);
                    loss(&at)
                },
            );
        }
    }
    assert_eq!(start, parameters.len());
}

#[test]
fn users_permute_scores_and_sensors_change_nothing() {
    let (network, states) = setup();
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    for state in states {
        let (v, scores) = evaluate(Arch::new(), &network, std::slice::from_ref(&state));
        let users = state.to_users.len();
        let mut order: Vec<usize> = (0..users).collect();
        order.shuffle(&mut rng);
        let rows = |all: &[f32], len: usize, order: &[usize]| -> Vec<f32> {
            let row = |&i: &usize| all[i * len..(i + 1) * len].to_vec();
            order.iter().flat_map(row).collect()
        };
        let permuted = State {
            users: rows(&state.users, FEATURES.user, &order),
            to_users: order.iter().map(|&i| state.to_users[i]).collect(),
            sensors: rows(&state.sensors, FEATURES.sensor, &[2, 0, 1]),
            ..state
        };
        let (permuted_v, permuted_scores) = evaluate(Arch::new(), &network, &[permuted]);
        assert_close(&permuted_v[0], &v[0]);
        let expected: Vec<f32> = order.iter().map(|&i| scores[i]).collect();
        assert_close(&permuted_scores, &expected);
    }
}

/// A state has the same bits alone and in a batch, with every kind of vectors.
#[test]
fn a_state_does_not_depend_on_its_batch_nor_on_the_machine() {
    let (network, states) = setup();
    let together = evaluate(Arch::Scalar, &network, &states);
    let mut alone = (Vec::new(), Vec::new());
    for state in &states {
        let (v, scores) = evaluate(Arch::Scalar, &network, std::slice::from_ref(state));
        alone.0.extend(v);
        alone.1.extend(scores);
    }
    assert_eq!(together, alone);
    for arch in every_arch() {
        assert_eq!(evaluate(arch, &network, &states), together, "{arch:?}");
    }
}

fn gradient_with(arch: Arch, network: &SetNetwork, states: &[State], threads: usize) -> Vec<f32> {
    let mut gradients = BatchGradient::new(network, threads);
    let (gradient, _) = gradients.gradient(
        arch,
        network,
        70,
        |range, batch| range.for_each(|i| batch.push(&states[i % states.len()].view())),
        |_, _, outputs, gradient, _| {
            gradient.displacement.copy_from_slice(&outputs.displacement);
            gradient.scores.copy_from_slice(&outputs.scores);
        },
    );
    gradient.to_vec()
}

#[test]
fn gradients_do_not_depend_on_threads_nor_on_the_machine() {
    let (network, states) = setup();
    let expected = gradient_with(Arch::Scalar, &network, &states, 1);
    for threads in 1..=4 {
        for arch in every_arch() {
            let got = gradient_with(arch, &network, &states, threads);
            assert!(got == expected, "{arch:?}, {threads} threads");
        }
    }
}

#[test]
fn parameters_are_exported_and_imported_without_padding() {
    let (network, states) = setup();
    let values = network.export();
    let mut other = SetNetwork::new(SMALL, FEATURES, 6);
    assert_eq!(other.import(&values[1..]), Err(values.len()));
    other.import(&values).expect("the right length");
    assert_eq!(other.parameters(), network.parameters());
    let arch = Arch::new();
    assert_eq!(
        evaluate(arch, &other, &states),
        evaluate(arch, &network, &states)
    );
    // The first weights are those of the sensors' first output.
    assert_eq!(values[..3], network.parameters()[..3]);
    assert_eq!(values[3..6], network.parameters()[16..19]);
}

#[test]
fn the_default_size_is_known() {
    let features = FeatureSizes {
        mission: 40,
        user: 30,
        sensor: 4,
    };
    let network = SetNetwork::new(Architecture::default(), features, 1);
    let (d, f) = (64, 192);
    let linear = |i: usize, o: usize| (i + 1) * o;
    let block = 2 * d + linear(d, 3 * d) + linear(d, d) + linear(d, f) + linear(f, d);
    let ends = linear(4, d) + linear(d, d) + linear(40 + 2 * d, d) + linear(30, d);
    let heads = d + linear(d, d) + linear(d, 4) + linear(2 * d, d) + linear(d, 2);
    assert_eq!(network.exported_len(), 3 * block + ends + heads);
}
