//! The loss: the negative logarithm of the probability of the planner's displacement, and the cross
//! entropy of the users' scores among the users that may be served.
//!
//! Where two ways are equally good, the planner takes one in some states and the other in states that
//! look alike. A single displacement would learn their average, which is on neither. The network
//! therefore has several candidates `v_k` with probabilities `pi_k` (the softmax of their logits), and the
//! loss is that of a mixture:
//!
//! ```text
//! -ln sum_k pi_k exp(-w |e_k|),   |e_k| = sqrt(|v_k - v*|^2 + h^2)
//! ```
//!
//! Each candidate is drawn to the waypoints that it is responsible for. With one candidate, the loss
//! is `w |e|`: its least length is at the median of the answers, on the way that is taken more often.
//! Where the planner stays for many slots and then leaves, the median stays for ever, so errors below
//! `h`, half the way of a slot, count by their square.

use firmware_core::policy::sets::CANDIDATES;

use super::sample::Labels;
use crate::nn::sets::{
    SetBatch,
    heads::{OutputGradients, Outputs},
};

/// `w`, the inverse of the scale of the displacement's error.
pub const DISPLACEMENT_WEIGHT: f32 = 4.0;
/// `h`, the length below which an error counts by its square, in units of the way of a slot.
const SMALL_ERROR: f32 = 0.2;
/// The names of the numbers that [`imitation`] reports.
pub const NAMES: [&str; 4] = [
    "losses/displacement_error",
    "losses/displacement_nll",
    "losses/user_cross_entropy",
    "losses/user_accuracy",
];

/// The error of a displacement.
struct Error {
    error: [f32; 2],
    length: f32,
}

impl Error {
    fn new(v: [f32; 2], target: [f32; 2]) -> Self {
        let error = [v[0] - target[0], v[1] - target[1]];
        let squares = error[0] * error[0] + error[1] * error[1] + SMALL_ERROR * SMALL_ERROR;
        Self {
            error,
            length: squares.sqrt(),
        }
    }
}

/// Returns the softmax of numbers, and the logarithm of the sum of their exponentials.
fn softmax(x: [f32; CANDIDATES]) -> ([f32; CANDIDATES], f64) {
    let largest = x.into_iter().fold(f32::MIN, f32::max);
    let exponentials = x.map(|x| libm::expf(x - largest));
    let total: f32 = exponentials.iter().sum();
    let log_total = f64::from(largest) + libm::log(total.into());
    (exponentials.map(|x| x / total), log_total)
}

/// Adds the losses of a batch to `losses` (in the order of [`NAMES`]) and writes their gradient.
pub fn imitation(
    labels: &Labels,
    batch: &SetBatch,
    outputs: &Outputs,
    gradient: &mut OutputGradients,
    losses: &mut Vec<f64>,
) {
    losses.resize(NAMES.len(), 0.0);
    for state in 0..batch.len() {
        let target = labels.displacements[state];
        let candidates = &outputs.candidates[state];
        let errors = candidates.map(|candidate| Error::new(candidate.displacement, target));
        let mut evidence = [0.0; CANDIDATES];
        for (k, (candidate, error)) in candidates.iter().zip(&errors).enumerate() {
            evidence[k] = candidate.logit - DISPLACEMENT_WEIGHT * error.length;
        }
        let (prior, log_prior) = softmax(candidates.map(|candidate| candidate.logit));
        let (responsibility, log_evidence) = softmax(evidence);
        losses[0] += f64::from(errors[outputs.chosen[state]].length);
        losses[1] += log_prior - log_evidence;
        for (k, gradient) in gradient.candidates[state].iter_mut().enumerate() {
            let slope = responsibility[k] * DISPLACEMENT_WEIGHT / errors[k].length;
            gradient.displacement = errors[k].error.map(|error| slope * error);
            gradient.logit = prior[k] - responsibility[k];
        }

        let users = batch.users_of(state);
        let scores = &outputs.scores[users.clone()];
        let admissible = &labels.admissible[users.clone()];
        let d_scores = &mut gradient.scores[users];
        let label = labels.users[state];
        let among = || (0..scores.len()).filter(|&user| admissible[user] || user == label);
        let largest = among().map(|user| scores[user]).fold(f32::MIN, f32::max);
        for user in among() {
            d_scores[user] = libm::expf(scores[user] - largest);
        }
        let total: f32 = d_scores.iter().sum();
        d_scores.iter_mut().for_each(|share| *share /= total);
        let beyond = f64::from(scores[label] - largest);
        losses[2] += libm::log(total.into()) - beyond;
        losses[3] += f64::from(u8::from(scores[label] >= largest));
        d_scores[label] -= 1.0;
    }
}
