//! From the last layers' outputs to the action.
//!
//! With the outputs `o` of the displacement head and the pulls of the user head, all displacements in
//! units of the way of a slot:
//!
//! ```text
//! p = sum_m softmax_m(3 pull_m) (user_m - vehicle)
//! u = sigmoid(o_2) p + sigmoid(o_3) (destination - vehicle) + (o_0, o_1)
//! v = u / max(1, ||u||)
//! ```

use super::{
    super::product::padded,
    batch::SetBatch,
    functions::{exp, sigmoid},
    layout::{DISPLACEMENT_OUTPUTS, USER_OUTPUTS},
};

/// The factor of the pulls, so that a small change of a weight can move the attended user.
pub const PULL_SCALE: f32 = 3.0;
/// Distance between rows of the displacement head's outputs.
const DISPLACEMENT_STRIDE: usize = padded(DISPLACEMENT_OUTPUTS);
/// Distance between rows of the user head's outputs, also of a critic's.
const USER_STRIDE: usize = padded(USER_OUTPUTS);
const _: () = assert!(USER_STRIDE == padded(1));

/// The outputs of a batch.
#[derive(Clone, Debug, Default)]
pub struct Outputs {
    /// `v` of every state: the displacement in units of the way of a slot, at most 1 long.
    pub displacement: Vec<[f32; 2]>,
    /// The score of every user of all states.
    pub scores: Vec<f32>,
    /// The softmax of the pulls.
    shares: Vec<f32>,
    /// `p` of every state.
    points: Vec<[f32; 2]>,
    /// `||u||` of every state.
    lengths: Vec<f32>,
}

/// The gradient of the loss with respect to the outputs.
#[derive(Clone, Debug, Default)]
pub struct OutputGradients {
    /// Of `v` of every state.
    pub displacement: Vec<[f32; 2]>,
    /// Of the score of every user of all states.
    pub scores: Vec<f32>,
}

impl Outputs {
    /// Takes the values of a critic, as scores, from its head's last layer.
    pub fn forward_values(&mut self, batch: &SetBatch, users: &[f32]) {
        self.scores.clear();
        self.scores
            .extend((0..batch.users()).map(|user| users[user * USER_STRIDE]));
    }

    /// Computes the outputs from those of the two heads' last layers.
    pub fn forward(&mut self, batch: &SetBatch, displacement: &[f32], users: &[f32]) {
        self.forward_values(batch, users);
        self.shares.resize(batch.users(), 0.0);
        self.displacement.clear();
        self.points.clear();
        self.lengths.clear();
        for state in 0..batch.len() {
            let range = batch.users_of(state);
            let shares = &mut self.shares[range.clone()];
            for (share, user) in shares.iter_mut().zip(range.clone()) {
                *share = PULL_SCALE * users[user * USER_STRIDE + 1];
            }
            let largest = shares.iter().fold(f32::MIN, |a, &b| a.max(b));
            shares.iter_mut().for_each(|x| *x = exp(*x - largest));
            let total: f32 = shares.iter().sum();
            let mut point = [0.0; 2];
            for (share, to_user) in shares.iter_mut().zip(&batch.to_users[range]) {
                *share /= total;
                point[0] += *share * to_user[0];
                point[1] += *share * to_user[1];
            }
            let o = &displacement[state * DISPLACEMENT_STRIDE..][..DISPLACEMENT_OUTPUTS];
            let (towards_point, towards_end) = (sigmoid(o[2]), sigmoid(o[3]));
            let end = batch.to_destination[state];
            let u = [0, 1].map(|i| towards_point * point[i] + towards_end * end[i] + o[i]);
            let length = (u[0] * u[0] + u[1] * u[1]).sqrt();
            // A comparison that lets NaN pass through.
            let divisor = if length < 1.0 { 1.0 } else { length };
            self.displacement.push(u.map(|u| u / divisor));
            self.points.push(point);
            self.lengths.push(length);
        }
    }

    /// Computes the gradient of the outputs of a critic's last layer, which replaces `users`.
    pub fn backward_values(&self, gradient: &OutputGradients, users: &mut [f32]) {
        let rows = users.chunks_exact_mut(USER_STRIDE);
        for (row, &score) in rows.zip(&gradient.scores) {
            row.fill(0.0);
            row[0] = score;
        }
    }

    /// Computes the gradient of the outputs of the two heads' last layers; `displacement` and
    /// `users` are those of the forward pass and are replaced by their gradients.
    pub fn backward(
        &self,
        batch: &SetBatch,
        gradient: &OutputGradients,
        displacement: &mut [f32],
        users: &mut [f32],
    ) {
        for state in 0..batch.len() {
            let mut d_u = gradient.displacement[state];
            let length = self.lengths[state];
            if length >= 1.0 {
                let v = self.displacement[state];
                let along = v[0] * d_u[0] + v[1] * d_u[1];
                d_u = [0, 1].map(|i| (d_u[i] - along * v[i]) / length);
            }
            let o = &mut displacement[state * DISPLACEMENT_STRIDE..][..DISPLACEMENT_STRIDE];
            let (towards_point, towards_end) = (sigmoid(o[2]), sigmoid(o[3]));
            let (point, end) = (self.points[state], batch.to_destination[state]);
            let dot = |x: [f32; 2]| x[0] * d_u[0] + x[1] * d_u[1];
            o[..2].copy_from_slice(&d_u);
            o[2] = dot(point) * towards_point * (1.0 - towards_point);
            o[3] = dot(end) * towards_end * (1.0 - towards_end);
            for user in batch.users_of(state) {
                let row = &mut users[user * USER_STRIDE..][..USER_STRIDE];
                let to_user = batch.to_users[user];
                let beyond = dot([to_user[0] - point[0], to_user[1] - point[1]]);
                row[0] = gradient.scores[user];
                row[1] = PULL_SCALE * self.shares[user] * towards_point * beyond;
            }
        }
    }
}
