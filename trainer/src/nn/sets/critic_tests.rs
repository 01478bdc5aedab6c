//! A critic: against double precision, and numerically differentiated by its parameters and by the
//! displacement.

use pulp::Arch;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{
    Activations, FeatureSizes, Heads, SetBatch, SetNetwork,
    backward::Gradients,
    heads::OutputGradients,
    reference,
    tests::{FEATURES, SMALL, State, USERS, assert_close},
};
use crate::nn::reference::check_gradient;

const CRITIC_FEATURES: FeatureSizes = FeatureSizes {
    mission: FEATURES.mission + 2,
    ..FEATURES
};

/// A critic with large weights, states, and a displacement in each.
struct Setup {
    network: SetNetwork,
    states: Vec<State>,
    displacements: Vec<[f32; 2]>,
}

impl Setup {
    fn new() -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let mut network = SetNetwork::with_heads(SMALL, CRITIC_FEATURES, Heads::Critic, 3);
        let mut values = network.export();
        for value in &mut values {
            *value = *value * 1.2 + rng.random_range(-0.15..0.15);
        }
        network.import(&values).expect("its own length");
        let mut random = || rng.random_range(-1.0..1.0);
        Self {
            network,
            displacements: USERS.map(|_| [random(), random()]).to_vec(),
            states: USERS.map(|users| State::random(users, &mut rng)).to_vec(),
        }
    }

    fn batch(&self) -> SetBatch {
        let mut states = SetBatch::new(FEATURES);
        self.states
            .iter()
            .for_each(|state| states.push(&state.view()));
        let mut batch = SetBatch::new(CRITIC_FEATURES);
        batch.extend_missions(&states, &self.displacements);
        batch
    }

    fn parameters(&self) -> Vec<f64> {
        self.network.export().iter().map(|&x| x.into()).collect()
    }

    /// The values of a state in double precision.
    fn expected(&self, state: usize, displacement: [f64; 2], parameters: &[f64]) -> Vec<f64> {
        let mission = self.states[state].mission.iter().map(|&x| f64::from(x));
        let mission: Vec<f64> = mission.chain(displacement).collect();
        reference::values(SMALL, &self.states[state].view(), &mission, parameters)
    }

    /// A loss with a gradient in every value, in double precision.
    fn loss(&self, state: usize, displacement: [f64; 2], parameters: &[f64]) -> f64 {
        let values = self.expected(state, displacement, parameters);
        let terms = values.iter().enumerate();
        terms.map(|(m, q)| q * (0.5 * q + weight(state, m))).sum()
    }

    fn total(&self, parameters: &[f64]) -> f64 {
        let states = 0..self.states.len();
        states
            .map(|state| self.loss(state, self.displacements[state].map(f64::from), parameters))
            .sum()
    }

    /// The activations, and the gradient of the loss by the values.
    fn forward(&self, batch: &SetBatch) -> (Activations, OutputGradients) {
        let mut activations = Activations::default();
        activations.forward(Arch::new(), &self.network, batch);
        let mut gradient = OutputGradients::default();
        for state in 0..batch.len() {
            for (m, user) in batch.users_of(state).enumerate() {
                let q = activations.outputs().scores[user];
                gradient.scores.push(q + weight(state, m) as f32);
            }
        }
        (activations, gradient)
    }
}

fn weight(state: usize, user: usize) -> f64 {
    ((state * 37 + user * 5) % 11) as f64 / 5.0 - 1.0
}

#[test]
fn values_agree_with_double_precision() {
    let setup = Setup::new();
    let (activations, _) = setup.forward(&setup.batch());
    let parameters = setup.parameters();
    let expected: Vec<f32> = (0..setup.states.len())
        .flat_map(|state| {
            let displacement = setup.displacements[state].map(f64::from);
            setup.expected(state, displacement, &parameters)
        })
        .map(|x| x as f32)
        .collect();
    assert_close(&activations.outputs().scores, &expected);
}

#[test]
fn the_gradient_of_the_parameters_matches_differences() {
    let setup = Setup::new();
    let batch = setup.batch();
    let (mut activations, outputs) = setup.forward(&batch);
    let mut gradient = vec![0.0; setup.network.layout().len];
    Gradients::default().backward(
        Arch::new(),
        &setup.network,
        &batch,
        &mut activations,
        &outputs,
        &mut gradient,
    );
    let gradient = setup.network.layout().without_padding(&gradient);
    let parameters = setup.network.export();
    check_gradient(&parameters, &gradient, 300, |at| setup.total(at));
}

/// The displacement's gradient, which goes back to the actor, and the other features' are the same with
/// and without the gradient of the parameters.
#[test]
fn the_gradient_of_the_displacement_matches_differences() {
    let setup = Setup::new();
    let (network, batch) = (&setup.network, setup.batch());
    let (mut activations, outputs) = setup.forward(&batch);
    let mut gradients = Gradients::default();
    let arch = Arch::new();
    gradients.backward_to_missions(arch, network, &batch, &mut activations, &outputs);
    let parameters = setup.parameters();
    let layout = network.layout();
    for (state, displacement) in setup.displacements.iter().enumerate() {
        let got = &gradients.mission(layout, state)[FEATURES.mission..];
        check_gradient(displacement, got, 2, |at| {
            setup.loss(state, [at[0], at[1]], &parameters)
        });
    }
    let mut with_parameters = Gradients::default();
    let (mut activations, _) = setup.forward(&batch);
    let mut gradient = vec![0.0; layout.len];
    with_parameters.backward(
        arch,
        network,
        &batch,
        &mut activations,
        &outputs,
        &mut gradient,
    );
    for state in 0..batch.len() {
        let [a, b] = [&gradients, &with_parameters].map(|g| g.mission(layout, state));
        assert_eq!(a, b);
    }
}
