use super::*;
use crate::{
    fixture::{DIMENSIONS, column, double, filled},
    nn::{
        arch::every_arch,
        reference::{check_gradient, forward},
    },
};

/// Compares eq:Q, including its target, with its definition in double precision.
#[test]
fn the_critic_loss_and_its_gradient_match_finite_differences() {
    let (mut sac, replay, mut rng) = filled::<Sac>();
    replay.sample(&mut rng, &mut sac.batch);
    sac.evaluate_bellman_target(&mut rng);
    let (n, width, users) = (sac.batch.len, sac.batch.width, DIMENSIONS.users);
    let noise = sac.sample.noise.clone();
    let policy = sac.state.policy.network.clone();
    for s in 0..n {
        let next = column(&sac.batch.next_observation, width, s);
        let output = forward(&policy, &double(&policy), &next);
        let epsilon = [noise[s], noise[width + s]].map(f64::from);
        let allowed = sac.batch.next_admissible[s];
        let (a, log_prob, p) = head::reference::sample(&output, epsilon, allowed);
        let input: Vec<f64> = next.iter().chain(&a).copied().collect();
        let q = sac
            .state
            .targets
            .each_ref()
            .map(|t| forward(t, &double(t), &input));
        let least: Vec<f64> = (0..users).map(|m| q[0][m].min(q[1][m])).collect();
        let counted = f64::from(sac.batch.next_entropy_mask[s]) * log_prob;
        let cost = head::reference::cost(counted, &p, &least, [0.1, 0.1]);
        let target = f64::from(sac.batch.reward[s]) - 0.9 * f64::from(sac.batch.follows[s]) * cost;
        assert!((f64::from(sac.target[s]) - target).abs() < 1e-4);
    }
    for i in 0..2 {
        let network = sac.state.critics[i].network.clone();
        let loss = sac.update_critic(i);
        let batch = &sac.batch;
        let reference = |parameters: &[f64]| {
            let error = |s: usize| {
                let mut input = column(&batch.observation, width, s);
                input.extend(column(&batch.action, width, s));
                let q = forward(&network, parameters, &input);
                q[usize::from(batch.user[s])] - f64::from(sac.target[s])
            };
            (0..n).map(|s| 0.5 * error(s).powi(2)).sum::<f64>() / n as f64
        };
        assert!((f64::from(loss) - reference(&double(&network))).abs() < 1e-5);
        let gradient = &sac.gradient[..network.parameters().len()];
        check_gradient(network.parameters(), gradient, 400, reference);
    }
}

/// Compares eq:pi with finite differences, through the reparameterized displacement and the exact
/// sum over users.
#[test]
fn the_policy_loss_and_its_gradient_match_finite_differences() {
    let (mut sac, replay, mut rng) = filled::<Sac>();
    replay.sample(&mut rng, &mut sac.batch);
    sac.batch.admissible[0] = 0b0101;
    let network = sac.state.policy.network.clone();
    let loss = sac.update_policy(&mut rng);
    let (n, width, users) = (sac.batch.len, sac.batch.width, DIMENSIONS.users);
    let critics = sac
        .state
        .critics
        .each_ref()
        .map(|c| (c.network.clone(), double(&c.network)));
    let reference = |parameters: &[f64]| {
        let cost = |s: usize| {
            let state = column(&sac.batch.observation, width, s);
            let output = forward(&network, parameters, &state);
            let epsilon = [sac.sample.noise[s], sac.sample.noise[width + s]].map(f64::from);
            let allowed = sac.batch.admissible[s];
            let (a, log_prob, p) = head::reference::sample(&output, epsilon, allowed);
            let input: Vec<f64> = state.iter().chain(&a).copied().collect();
            let q = critics
                .each_ref()
                .map(|(network, p)| forward(network, p, &input));
            let least: Vec<f64> = (0..users).map(|m| q[0][m].min(q[1][m])).collect();
            let counted = f64::from(sac.batch.entropy_mask[s]) * log_prob;
            head::reference::cost(counted, &p, &least, [0.1, 0.1])
        };
        (0..n).map(cost).sum::<f64>() / n as f64
    };
    assert!((f64::from(loss) - reference(&double(&network))).abs() < 1e-5);
    let gradient = &sac.gradient[..network.parameters().len()];
    check_gradient(network.parameters(), gradient, 400, reference);
}

/// The temperature falls while the entropy is above its target (eq:beta).
#[test]
fn temperatures_move_towards_their_target_entropy() {
    for (target, falls) in [(-9.0, true), (3.0, false)] {
        let (mut sac, replay, mut rng) = filled::<Sac>();
        sac.settings.displacement_entropy = target;
        sac.settings.user_entropy_fraction = if falls { 0.1 } else { 1.0 };
        let before = sac.temperatures();
        for _ in 0..20 {
            sac.learn(&replay, &mut rng);
        }
        let after = sac.temperatures();
        assert_eq!(after.displacement < before.displacement, falls);
        assert_eq!(after.user < before.user, falls);
    }
}

/// Compares the gradient of eq:beta over `ln alpha` with finite differences.
#[test]
fn the_temperature_gradient_is_the_derivative_of_its_loss() {
    let loss = |log_alpha: f64, surplus: f64| log_alpha.exp() * surplus;
    for (initial, surplus) in [(0.1_f32, 0.7_f32), (2.0, -1.3)] {
        let log = f64::from(crate::nn::ln(initial));
        let h = 1e-6;
        let numeric = (loss(log + h, surplus.into()) - loss(log - h, surplus.into())) / (2.0 * h);
        assert!((f64::from(initial * surplus) - numeric).abs() < 1e-6);
        let mut temperature = Temperature::new(initial);
        temperature.descend(Arch::new(), 1e-3, surplus);
        // Adam's first step has the learning rate's size, against the gradient.
        let moved = f64::from(temperature.log_alpha) - log;
        assert!((moved + 1e-3 * numeric.signum()).abs() < 1e-5);
    }
}

/// Results are the same bits with every set of vector instructions.
#[test]
fn same_seed_same_bytes_with_any_vector_instructions() {
    let run = |arch: Arch| {
        let (mut sac, replay, mut rng) = filled::<Sac>();
        sac.arch = arch;
        let states = States {
            len: 1,
            width: padded(1),
            observation: vec![0.25; DIMENSIONS.observation * padded(1)],
            admissible: vec![0b1011; padded(1)],
        };
        let mut actions = [Action::default()];
        for _ in 0..60 {
            sac.explore(&states, &mut rng, &mut actions);
            sac.learn(&replay, &mut rng);
        }
        (sac.state.clone(), sac.losses, actions)
    };
    let plain = run(Arch::Scalar);
    for arch in every_arch() {
        assert_eq!(run(arch), plain, "{arch:?}");
    }
}
