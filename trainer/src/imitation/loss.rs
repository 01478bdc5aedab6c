//! The loss: the length of the error of the displacement, and the cross entropy of the users' scores
//! among the users that may be served.
//!
//! Where two ways are equally good, the planner takes one in some states and the other in states that
//! look alike. The least *squared* error is then at the mean of the two, which is on neither. The
//! least length is at their median: on the way that is taken more often. But where the planner stays for
//! many slots and then leaves, the median stays for ever. Errors below half the way of a slot therefore
//! count by their square.

use super::sample::Labels;
use crate::nn::sets::{
    SetBatch,
    heads::{OutputGradients, Outputs},
};

/// The weight of the length of the displacement's error.
pub const DISPLACEMENT_WEIGHT: f32 = 3.0;
/// The length below which an error counts by its square, in units of the way of a slot.
const SMALL_ERROR: f32 = 0.5;
/// The names of the numbers that [`imitation`] reports.
pub const NAMES: [&str; 3] = [
    "losses/displacement_error",
    "losses/user_cross_entropy",
    "losses/user_accuracy",
];

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
        let (v, target) = (outputs.displacement[state], labels.displacements[state]);
        let error = [v[0] - target[0], v[1] - target[1]];
        let squares = error[0] * error[0] + error[1] * error[1] + SMALL_ERROR * SMALL_ERROR;
        let length = squares.sqrt();
        losses[0] += f64::from(length);
        gradient.displacement[state] = error.map(|error| DISPLACEMENT_WEIGHT * error / length);

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
        losses[1] += libm::log(total.into()) - beyond;
        losses[2] += f64::from(u8::from(scores[label] >= largest));
        d_scores[label] -= 1.0;
    }
}
