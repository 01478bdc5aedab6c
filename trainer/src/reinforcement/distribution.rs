//! The stochastic policy in a state, and the gradient of its value.

use crate::nn::{exp, ln};

/// The entropy of `sigma epsilon` without `2 ln sigma`, nats: `ln(2 pi e)`.
const UNIT_ENTROPY: f32 = 2.837_877;

/// Returns the entropy of the displacement before its length is limited, nats.
pub fn displacement_entropy(log_sigma: f32) -> f32 {
    2.0 * log_sigma + UNIT_ENTROPY
}

/// Returns `ln sigma` of a displacement with this entropy.
pub fn log_sigma_of(entropy: f32) -> f32 {
    (entropy - UNIT_ENTROPY) / 2.0
}

/// A sampled displacement `a = u / max(1, ||u||)`, `u = v + sigma epsilon`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Displacement {
    /// `a`, in units of the way of a slot.
    pub value: [f32; 2],
    /// `||u||`.
    length: f32,
}

impl Displacement {
    /// Computes the sample from `v`, `sigma` and `epsilon`.
    pub fn new(v: [f32; 2], sigma: f32, epsilon: [f32; 2]) -> Self {
        let u = [0, 1].map(|i| v[i] + sigma * epsilon[i]);
        let length = (u[0] * u[0] + u[1] * u[1]).sqrt();
        Self {
            value: u.map(|u| u / length.max(1.0)),
            length,
        }
    }

    /// Returns the gradient of `u`, which is also that of `v`, from the gradient of `a`.
    pub fn backward(&self, d_value: [f32; 2]) -> [f32; 2] {
        if self.length < 1.0 {
            return d_value;
        }
        let along = self.value[0] * d_value[0] + self.value[1] * d_value[1];
        [0, 1].map(|i| (d_value[i] - along * self.value[i]) / self.length)
    }
}

/// The distribution over the users of a state.
#[derive(Clone, Debug, Default)]
pub struct UserDistribution {
    /// `pi(m|s)`; 0 for users that are not admissible.
    pub prob: Vec<f32>,
    /// `ln pi(m|s)`; 0 for users that are not admissible.
    pub log_prob: Vec<f32>,
}

impl UserDistribution {
    /// Computes the softmax of the scores over the admissible users. If there is none, all are.
    pub fn evaluate(&mut self, scores: &[f32], admissible: &[bool]) {
        let all = !admissible.contains(&true);
        let admits = |user: usize| all || admissible[user];
        let among = || (0..scores.len()).filter(|&user| admits(user));
        let highest = among().map(|user| scores[user]).fold(f32::MIN, f32::max);
        self.prob.clear();
        self.prob.resize(scores.len(), 0.0);
        self.log_prob.clear();
        self.log_prob.resize(scores.len(), 0.0);
        let total: f32 = among().map(|user| exp(scores[user] - highest)).sum();
        let log_total = ln(total);
        for user in among() {
            self.prob[user] = exp(scores[user] - highest) / total;
            self.log_prob[user] = scores[user] - highest - log_total;
        }
    }

    /// Returns the entropy, nats.
    pub fn entropy(&self) -> f32 {
        let terms = self.prob.iter().zip(&self.log_prob);
        -terms.map(|(p, log_p)| p * log_p).sum::<f32>()
    }

    /// Returns `sum_m pi(m|s) (q_m - alpha ln pi(m|s))`.
    pub fn soft_value(&self, alpha: f32, q: impl Fn(usize) -> f32) -> f32 {
        let users = 0..self.prob.len();
        users
            .map(|user| self.prob[user] * (q(user) - alpha * self.log_prob[user]))
            .sum()
    }

    /// Writes the gradient of `-soft_value` with respect to the scores.
    pub fn gradient(&self, alpha: f32, q: impl Fn(usize) -> f32, d_scores: &mut [f32]) {
        let mean = -self.soft_value(alpha, &q);
        for (user, d_score) in d_scores.iter_mut().enumerate() {
            let cost = alpha * self.log_prob[user] - q(user);
            *d_score = self.prob[user] * (cost - mean);
        }
    }

    /// Returns the user that a uniform number in `[0, 1)` selects.
    pub fn pick(&self, uniform: f32) -> usize {
        let mut rest = uniform;
        let mut last = 0;
        for (user, &p) in self.prob.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            last = user;
            rest -= p;
            if rest < 0.0 {
                break;
            }
        }
        last
    }
}
