//! From the last layers' outputs to the action.
//!
//! The displacement head has the outputs `o` of each candidate `k` for the displacement, and the user
//! head has a pull per candidate. All displacements are in units of the way of a slot:
//!
//! ```text
//! p_k = sum_m softmax_m(3 pull_mk) (user_m - vehicle)
//! u_k = sigmoid(o_k2) p_k + sigmoid(o_k3) (destination - vehicle) + (o_k0, o_k1)
//! v_k = u_k / max(1, ||u_k||)
//! ```
//!
//! The displacement is the candidate whose logit `o_k4` is the largest, the first of equals.

use firmware_core::policy::sets::{CANDIDATE_OUTPUTS, CANDIDATES};

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

/// A candidate for the displacement of a state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Candidate {
    /// `v_k`: in units of the way of a slot, at most 1 long.
    pub displacement: [f32; 2],
    /// `o_k4`.
    pub logit: f32,
    /// `p_k`.
    point: [f32; 2],
    /// `||u_k||`.
    length: f32,
}

/// The outputs of a batch.
#[derive(Clone, Debug, Default)]
pub struct Outputs {
    /// The candidates of every state.
    pub candidates: Vec<[Candidate; CANDIDATES]>,
    /// The index of the chosen candidate of every state.
    pub chosen: Vec<usize>,
    /// The score of every user of all states.
    pub scores: Vec<f32>,
    /// The softmax of the pulls: for every user, a number per candidate.
    shares: Vec<[f32; CANDIDATES]>,
}

/// The gradient of the loss with respect to a candidate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CandidateGradient {
    /// With respect to `v_k`.
    pub displacement: [f32; 2],
    /// With respect to the logit.
    pub logit: f32,
}

/// The gradient of the loss with respect to the outputs.
#[derive(Clone, Debug, Default)]
pub struct OutputGradients {
    /// Of the candidates of every state.
    pub candidates: Vec<[CandidateGradient; CANDIDATES]>,
    /// Of the score of every user of all states.
    pub scores: Vec<f32>,
}

impl OutputGradients {
    /// Makes the gradient zero for so many states and users.
    pub fn clear(&mut self, states: usize, users: usize) {
        self.candidates.clear();
        self.candidates.resize(states, Default::default());
        self.scores.clear();
        self.scores.resize(users, 0.0);
    }
}

impl Outputs {
    /// Returns the displacement of every state, in units of the way of a slot.
    pub fn displacements(&self) -> impl Iterator<Item = [f32; 2]> {
        (0..self.chosen.len()).map(|state| self.displacement(state))
    }

    /// Returns the displacement of a state, in units of the way of a slot.
    pub fn displacement(&self, state: usize) -> [f32; 2] {
        self.candidates[state][self.chosen[state]].displacement
    }

    /// Takes the values of a critic, as scores, from its head's last layer.
    pub fn forward_values(&mut self, batch: &SetBatch, users: &[f32]) {
        self.scores.clear();
        self.scores
            .extend((0..batch.users()).map(|user| users[user * USER_STRIDE]));
    }

    /// Computes the outputs from those of the two heads' last layers.
    pub fn forward(&mut self, batch: &SetBatch, displacement: &[f32], users: &[f32]) {
        self.forward_values(batch, users);
        self.shares.resize(batch.users(), [0.0; CANDIDATES]);
        self.candidates.clear();
        self.chosen.clear();
        for state in 0..batch.len() {
            let o = &displacement[state * DISPLACEMENT_STRIDE..][..DISPLACEMENT_OUTPUTS];
            let mut candidates = [Candidate::default(); CANDIDATES];
            for (k, o) in o.as_chunks::<CANDIDATE_OUTPUTS>().0.iter().enumerate() {
                candidates[k] = self.candidate(batch, state, (k, o), users);
            }
            let mut chosen = 0;
            for (k, candidate) in candidates.iter().enumerate() {
                if candidate.logit > candidates[chosen].logit {
                    chosen = k;
                }
            }
            self.candidates.push(candidates);
            self.chosen.push(chosen);
        }
    }

    fn candidate(
        &mut self,
        batch: &SetBatch,
        state: usize,
        (k, o): (usize, &[f32; CANDIDATE_OUTPUTS]),
        users: &[f32],
    ) -> Candidate {
        let range = batch.users_of(state);
        let shares = &mut self.shares[range.clone()];
        let mut largest = f32::MIN;
        for (share, user) in shares.iter_mut().zip(range.clone()) {
            share[k] = PULL_SCALE * users[user * USER_STRIDE + 1 + k];
            largest = largest.max(share[k]);
        }
        let mut total = 0.0;
        for share in shares.iter_mut() {
            share[k] = exp(share[k] - largest);
            total += share[k];
        }
        let mut point = [0.0; 2];
        for (share, to_user) in shares.iter_mut().zip(&batch.to_users[range]) {
            share[k] /= total;
            point[0] += share[k] * to_user[0];
            point[1] += share[k] * to_user[1];
        }
        let &[free_east, free_north, to_point, to_end, logit] = o;
        let (towards_point, towards_end) = (sigmoid(to_point), sigmoid(to_end));
        let (free, end) = ([free_east, free_north], batch.to_destination[state]);
        let u = [0, 1].map(|i| towards_point * point[i] + towards_end * end[i] + free[i]);
        let length = (u[0] * u[0] + u[1] * u[1]).sqrt();
        // A comparison that lets NaN pass through.
        let divisor = if length < 1.0 { 1.0 } else { length };
        Candidate {
            displacement: u.map(|u| u / divisor),
            logit,
            point,
            length,
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
        self.backward_values(gradient, users);
        for state in 0..batch.len() {
            let o = &mut displacement[state * DISPLACEMENT_STRIDE..][..DISPLACEMENT_OUTPUTS];
            let end = batch.to_destination[state];
            let candidates = self.candidates[state]
                .iter()
                .zip(&gradient.candidates[state]);
            let outputs = o.as_chunks_mut::<CANDIDATE_OUTPUTS>().0;
            for (k, ((candidate, gradient), o)) in candidates.zip(outputs).enumerate() {
                let mut d_u = gradient.displacement;
                let v = candidate.displacement;
                if candidate.length >= 1.0 {
                    let along = v[0] * d_u[0] + v[1] * d_u[1];
                    d_u = [0, 1].map(|i| (d_u[i] - along * v[i]) / candidate.length);
                }
                let (towards_point, towards_end) = (sigmoid(o[2]), sigmoid(o[3]));
                let point = candidate.point;
                let dot = |x: [f32; 2]| x[0] * d_u[0] + x[1] * d_u[1];
                *o = [
                    d_u[0],
                    d_u[1],
                    dot(point) * towards_point * (1.0 - towards_point),
                    dot(end) * towards_end * (1.0 - towards_end),
                    gradient.logit,
                ];
                for user in batch.users_of(state) {
                    let to_user = batch.to_users[user];
                    let beyond = dot([to_user[0] - point[0], to_user[1] - point[1]]);
                    users[user * USER_STRIDE + 1 + k] =
                        PULL_SCALE * self.shares[user][k] * towards_point * beyond;
                }
            }
        }
    }
}
