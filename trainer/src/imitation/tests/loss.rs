//! The loss: its gradient, and what it teaches.

use pulp::Arch;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::quick;
use crate::{
    imitation::{
        demonstration::Demonstration,
        encoder::{Encoder, FEATURES},
        loss,
        sample::{Labels, Sample},
    },
    nn::{
        Adam,
        sets::{
            Activations, SetBatch, SetNetwork,
            backward::Gradients,
            batch::SetState,
            heads::{OutputGradients, Outputs},
        },
    },
};

fn loss_of(labels: &Labels, batch: &SetBatch, outputs: &Outputs) -> (f64, OutputGradients) {
    let mut gradient = OutputGradients::default();
    gradient.clear(batch.len(), batch.users());
    let mut losses = Vec::new();
    loss::imitation(labels, batch, outputs, &mut gradient, &mut losses);
    (losses[1] + losses[2], gradient)
}

#[test]
fn the_gradient_of_the_loss_matches_differences_and_ignores_forbidden_users() {
    let settings = quick();
    let demonstrations = [Demonstration::new(&settings, 2, None, None).expect("a demonstration")];
    let (mut batch, mut labels) = (SetBatch::new(FEATURES), Labels::default());
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    for _ in 0..40 {
        let sample = Sample::draw(&demonstrations, &mut rng);
        let mut encoder = Encoder::default();
        sample.push(
            &demonstrations,
            &settings,
            &mut encoder,
            &mut batch,
            &mut labels,
        );
    }
    assert!(labels.admissible.contains(&false), "nothing is forbidden");
    let network = SetNetwork::new(settings.architecture, FEATURES, 1);
    let mut activations = Activations::default();
    activations.forward(Arch::new(), &network, &batch);
    let outputs = activations.outputs();
    let (_, gradient) = loss_of(&labels, &batch, outputs);
    let h = 1e-2;
    for user in 0..batch.users() {
        let at = |shift: f32| {
            let mut outputs = outputs.clone();
            outputs.scores[user] += shift;
            loss_of(&labels, &batch, &outputs).0
        };
        let slope = (at(h) - at(-h)) / f64::from(2.0 * h);
        assert!((slope - f64::from(gradient.scores[user])).abs() < 1e-3);
        assert!(labels.admissible[user] || gradient.scores[user] == 0.0);
    }
    for (state, k) in (0..batch.len()).flat_map(|state| [(state, 0), (state, 1), (state, 2)]) {
        let at = |north: f32, logit: f32| {
            let mut outputs = outputs.clone();
            outputs.candidates[state][k].displacement[1] += north;
            outputs.candidates[state][k].logit += logit;
            loss_of(&labels, &batch, &outputs).0
        };
        // The loss bends within a tenth of the way of a slot.
        let h = 2e-3;
        let got = gradient.candidates[state][k];
        let slope = (at(h, 0.0) - at(-h, 0.0)) / f64::from(2.0 * h);
        assert!((slope - f64::from(got.displacement[1])).abs() < 1e-3);
        let slope = (at(0.0, h) - at(0.0, -h)) / f64::from(2.0 * h);
        assert!((slope - f64::from(got.logit)).abs() < 1e-3);
    }
}

/// Two answers in the same state are learned as two candidates, not as their average.
#[test]
fn candidates_learn_one_way_each() {
    let answers = [[1.0_f32, 0.0], [-1.0, 0.0]];
    let labels = Labels {
        displacements: answers.to_vec(),
        users: vec![0; 2],
        admissible: vec![true; 2],
    };
    let mut batch = SetBatch::new(FEATURES);
    let (mission, user) = (vec![0.1; FEATURES.mission], vec![0.2; FEATURES.user]);
    for _ in answers {
        batch.push(&SetState {
            mission: &mission,
            users: &user,
            sensors: &[0.3; FEATURES.sensor],
            to_users: &[[0.0; 2]],
            to_destination: [0.0; 2],
        });
    }
    let settings = quick();
    let mut network = SetNetwork::new(settings.architecture, FEATURES, 3);
    let (mut adam, mut activations) = (Adam::new(network.layout().len), Activations::default());
    let mut gradients = Gradients::default();
    for _ in 0..400 {
        activations.forward(Arch::new(), &network, &batch);
        let (_, of_outputs) = loss_of(&labels, &batch, activations.outputs());
        let mut gradient = vec![0.0; network.layout().len];
        gradients.backward(
            Arch::new(),
            &network,
            &batch,
            &mut activations,
            &of_outputs,
            &mut gradient,
        );
        network.update(|parameters| adam.step(Arch::new(), 3e-3, parameters, &gradient));
    }
    activations.forward(Arch::new(), &network, &batch);
    let outputs = activations.outputs();
    for answer in answers {
        let nearest = (outputs.candidates[0].iter())
            .map(|c| (c.displacement[0] - answer[0]).hypot(c.displacement[1] - answer[1]))
            .fold(f32::MAX, f32::min);
        assert!(nearest < 0.1, "{:?}", outputs.candidates[0]);
    }
    assert!(outputs.displacement(0)[0].abs() > 0.8);
}
