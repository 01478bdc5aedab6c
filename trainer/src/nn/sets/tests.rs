//! The whole network: against double precision, numerically differentiated, and its symmetries.

use firmware_core::policy::sets::CANDIDATES;
use pulp::Arch;
use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_pcg::Pcg64Mcg;

use super::{
    Activations, Architecture, BatchGradient, FeatureSizes, SetBatch, SetNetwork, batch::SetState,
    heads::Candidate, reference,
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

/// Returns displacement and logit of every candidate of every state, and the scores.
fn evaluate(arch: Arch, network: &SetNetwork, states: &[State]) -> (Vec<[f32; 3]>, Vec<f32>) {
    let mut batch = SetBatch::new(FEATURES);
    for state in states {
        batch.push(&state.view());
    }
    let mut activations = Activations::default();
    activations.forward(arch, network, &batch);
    let outputs = activations.outputs();
    let numbers = |c: &Candidate| [c.displacement[0], c.displacement[1], c.logit];
    let candidates = outputs.candidates.as_flattened().iter().map(numbers);
    (candidates.collect(), outputs.scores.clone())
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
    let (candidates, scores) = evaluate(Arch::new(), &network, &states);
    let mut expected_scores = Vec::new();
    let mut lengths = Vec::new();
    let mut chosen = Vec::new();
    for (state, got) in states.iter().zip(candidates.chunks(CANDIDATES)) {
        let (expected, scores) = reference::forward(SMALL, &state.view(), &parameters);
        for (got, (v, logit)) in got.iter().zip(&expected) {
            assert_close(got, &[v[0], v[1], *logit].map(|x| x as f32));
            lengths.push(v[0].hypot(v[1]));
        }
        let logit = |k: &usize| expected[*k].1;
        chosen.extend((0..CANDIDATES).max_by(|a, b| logit(a).total_cmp(&logit(b))));
        expected_scores.extend(scores.iter().map(|&x| x as f32));
    }
    assert_close(&scores, &expected_scores);
    // Both branches of the limit on the length are taken.
    assert!(lengths.iter().any(|&l| l > 1.0 - 1e-9) && lengths.iter().any(|&l| l < 0.99));
    let mut batch = SetBatch::new(FEATURES);
    states.iter().for_each(|state| batch.push(&state.view()));
    let mut activations = Activations::default();
    activations.forward(Arch::new(), &network, &batch);
    assert_eq!(activations.outputs().chosen, chosen);
    assert!(chosen.iter().any(|&k| k != chosen[0]), "{chosen:?}");
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
                let candidates = outputs.candidates[index].iter().enumerate();
                for ((k, candidate), gradient) in candidates.zip(&mut gradient.candidates[index]) {
                    for i in 0..2 {
                        let v = candidate.displacement[i];
                        gradient.displacement[i] = v + weight(state + i + k) as f32;
                        total += f64::from(v * (0.5 * v + weight(state + i + k) as f32));
                    }
                    gradient.logit = weight(state + k) as f32;
                    total += f64::from(candidate.logit * weight(state + k) as f32);
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
            let (candidates, scores) = reference::forward(SMALL, &state.view(), parameters);
            for (k, (v, logit)) in candidates.iter().enumerate() {
                let terms = (0..2).map(|i| v[i] * (0.5 * v[i] + weight(n + i + k)));
                total += terms.sum::<f64>() + logit * weight(n + k);
            }
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
        assert_close(permuted_v.as_flattened(), v.as_flattened());
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
            let pairs = outputs.candidates.iter().zip(&mut gradient.candidates);
            for (candidate, gradient) in pairs.flat_map(|(c, g)| c.iter().zip(g)) {
                gradient.displacement = candidate.displacement;
                gradient.logit = candidate.logit;
            }
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
    let heads = d + linear(d, d) + linear(d, 15) + linear(2 * d, d) + linear(d, 4);
    assert_eq!(network.exported_len(), 3 * block + ends + heads);
}
