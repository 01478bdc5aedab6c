//! The hybrid action of the policy: a squashed-Gaussian displacement and a categorical user,
//! which the paper models separately and optimizes jointly.
//!
//! Given the state, the two are independent. The policy network's rows are
//!
//! ```text
//! [mean_x, mean_y, spread_x, spread_y, logit_1, .., logit_M]
//! ```
//!
//! and with noise `epsilon ~ N(0, I)`
//!
//! ```text
//! u = mean + sigma epsilon,   a = tanh(u),   displacement = V_max delta a
//! ln sigma = LOG_SIGMA_MIN + (LOG_SIGMA_MAX - LOG_SIGMA_MIN) (tanh(spread) + 1) / 2
//! ln pi(a|s) = sum_i  -epsilon_i^2/2 - ln sigma_i - ln(2 pi)/2 - ln(1 - a_i^2)
//! pi(m|s) = softmax of the logits over the admissible users, 0 for the others
//! ```

use environment::UserSet;

use crate::nn::{exp, ln, padded, softplus, tanh};

const LOG_SIGMA_MIN: f32 = -5.0;
const LOG_SIGMA_MAX: f32 = 1.0;
const HALF_LN_2_PI: f32 = 0.918_938_5;

/// Number of rows of the policy network's output before the logits.
pub const DISPLACEMENT_ROWS: usize = 4;

/// Returns the length of the policy network's output for `users` users.
pub const fn output_len(users: usize) -> usize {
    DISPLACEMENT_ROWS + users
}

/// The policy's distribution in a batch of states, and one action sampled from it per state.
/// Matrices have one row per component and one column per state.
#[derive(Clone, Debug)]
pub struct PolicySample {
    width: usize,
    users: usize,
    /// The noise `epsilon`, to be filled by the caller before [`evaluate`](Self::evaluate).
    pub noise: Vec<f32>,
    /// The sampled displacement `a`, in `[-1, 1]`.
    pub displacement: Vec<f32>,
    /// `ln pi(a|s)`.
    pub log_prob: Vec<f32>,
    /// `pi(m|s)`; 0 for users that are not admissible.
    pub user_prob: Vec<f32>,
    /// `ln pi(m|s)`; 0 for users that are not admissible, so that its product with the probability
    /// is 0.
    pub user_log_prob: Vec<f32>,
    sigma: Vec<f32>,
    spread: Vec<f32>,
    /// Entropy of a uniform choice among the admissible users, nats.
    pub uniform_entropy: Vec<f32>,
    /// Entropy of `pi(.|s)` over the users, nats.
    pub user_entropy: Vec<f32>,
    /// 1 where the displacement's entropy counts, else 0. Initially 1 everywhere.
    pub entropy_mask: Vec<f32>,
}

impl PolicySample {
    /// Allocates buffers for `batch` states.
    pub fn new(users: usize, batch: usize) -> Self {
        let width = padded(batch);
        let zeros = |rows: usize| vec![0.0; rows * width];
        Self {
            width,
            users,
            noise: zeros(2),
            displacement: zeros(2),
            log_prob: zeros(1),
            user_prob: zeros(users),
            user_log_prob: zeros(users),
            sigma: zeros(2),
            spread: zeros(2),
            uniform_entropy: zeros(1),
            user_entropy: zeros(1),
            entropy_mask: vec![1.0; width],
        }
    }

    /// Computes distribution and sample from the policy network's output and the admissible users
    /// of every state.
    pub fn evaluate(&mut self, output: &[f32], admissible: &[UserSet]) {
        let (mean, rest) = output.split_at(2 * self.width);
        let (spread, logits) = rest.split_at(2 * self.width);
        self.evaluate_displacement(mean, spread);
        self.evaluate_users(logits, admissible);
    }

    /// Computes the displacement's part of the sample.
    fn evaluate_displacement(&mut self, mean: &[f32], spread: &[f32]) {
        self.log_prob.fill(0.0);
        for i in 0..2 * self.width {
            let spread = tanh(spread[i]);
            let log_sigma = LOG_SIGMA_MIN + 0.5 * (LOG_SIGMA_MAX - LOG_SIGMA_MIN) * (spread + 1.0);
            let sigma = exp(log_sigma);
            let epsilon = self.noise[i];
            let u = mean[i] + sigma * epsilon;
            self.spread[i] = spread;
            self.sigma[i] = sigma;
            self.displacement[i] = tanh(u);
            // ln(1 - tanh(u)^2) without cancellation.
            let log_slope = 2.0 * (core::f32::consts::LN_2 - u - softplus(-2.0 * u));
            self.log_prob[i % self.width] +=
                -0.5 * epsilon * epsilon - log_sigma - HALF_LN_2_PI - log_slope;
        }
    }

    /// Computes the users' part of the distribution.
    fn evaluate_users(&mut self, logits: &[f32], admissible: &[UserSet]) {
        let width = self.width;
        for (s, &admissible) in admissible.iter().enumerate().take(width) {
            let admits = |m: usize| admissible >> m & 1 == 1;
            let at = |m: usize| m * width + s;
            let mut highest = f32::NEG_INFINITY;
            let mut count = 0;
            for m in (0..self.users).filter(|&m| admits(m)) {
                highest = highest.max(logits[at(m)]);
                count += 1;
            }
            let mut sum = 0.0;
            for m in 0..self.users {
                let weight = if admits(m) {
                    exp(logits[at(m)] - highest)
                } else {
                    0.0
                };
                self.user_prob[at(m)] = weight;
                sum += weight;
            }
            let log_sum = ln(sum);
            let mut entropy = 0.0;
            for m in 0..self.users {
                let i = at(m);
                self.user_prob[i] /= sum;
                self.user_log_prob[i] = if admits(m) {
                    logits[i] - highest - log_sum
                } else {
                    0.0
                };
                entropy -= self.user_prob[i] * self.user_log_prob[i];
            }
            self.user_entropy[s] = entropy;
            self.uniform_entropy[s] = ln(count as f32);
        }
    }

    /// Returns `sum_m pi(m|s) (alpha_u ln pi(m|s) - q_m) + alpha_d ln pi(a|s)` of state `s`. This is
    /// the exact expectation over users of eq:pi's integrand, and the negative of the soft value in
    /// eq:Q.
    pub fn soft_cost(&self, q: &[f32], alpha: Temperatures, s: usize) -> f32 {
        let mut cost = alpha.displacement * self.entropy_mask[s] * self.log_prob[s];
        for m in 0..self.users {
            let i = m * self.width + s;
            cost += self.user_prob[i] * (alpha.user * self.user_log_prob[i] - q[i]);
        }
        cost
    }

    /// Computes the gradient of the mean [`soft_cost`](Self::soft_cost) with respect to the
    /// network's output. `q` has one row per user. `value_slope` (2 rows) is the gradient of the
    /// mean of `q` with respect to the displacement, `sum_m pi(m|s) d q_m / d a`, already divided by
    /// the size of the batch.
    pub fn gradient(
        &self,
        q: &[f32],
        value_slope: &[f32],
        alpha: Temperatures,
        batch: usize,
        gradient: &mut [f32],
    ) {
        let width = self.width;
        let per_sample = 1.0 / batch as f32;
        gradient.fill(0.0);
        for row in 0..2 {
            for s in 0..batch {
                let i = row * width + s;
                let a = self.displacement[i];
                // d/du of -ln(1 - tanh(u)^2) is 2 a; the value depends on u through a = tanh(u).
                let masked_alpha = alpha.displacement * self.entropy_mask[s];
                let du = masked_alpha * 2.0 * a * per_sample - (1.0 - a * a) * value_slope[i];
                let d_log_sigma = du * self.sigma[i] * self.noise[i] - masked_alpha * per_sample;
                let spread = self.spread[i];
                let slope = 0.5 * (LOG_SIGMA_MAX - LOG_SIGMA_MIN) * (1.0 - spread * spread);
                gradient[i] = du;
                gradient[2 * width + i] = d_log_sigma * slope;
            }
        }
        let logits = &mut gradient[DISPLACEMENT_ROWS * width..];
        for s in 0..batch {
            let cost = |m: usize| {
                let i = m * width + s;
                alpha.user * self.user_log_prob[i] - q[i]
            };
            let mean: f32 = (0..self.users)
                .map(|m| self.user_prob[m * width + s] * cost(m))
                .sum();
            for m in 0..self.users {
                let i = m * width + s;
                logits[i] = self.user_prob[i] * (cost(m) - mean) * per_sample;
            }
        }
    }

    /// Returns the user that a uniform number in `[0, 1)` selects in state `s`.
    pub fn pick_user(&self, s: usize, uniform: f32) -> usize {
        let mut rest = uniform;
        let mut last = 0;
        for m in 0..self.users {
            let p = self.user_prob[m * self.width + s];
            if p > 0.0 {
                last = m;
                rest -= p;
                if rest < 0.0 {
                    break;
                }
            }
        }
        last
    }
}

/// The temperatures `alpha` of the two parts of the action (the paper's `beta`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperatures {
    /// Temperature of the displacement's entropy.
    pub displacement: f32,
    /// Temperature of the user's entropy.
    pub user: f32,
}

#[cfg(test)]
pub(crate) mod reference {
    //! The formulae of the module's header in double precision.

    /// Returns the displacement, `ln pi(a|s)` and the users' probabilities.
    pub(crate) fn sample(
        output: &[f64],
        noise: [f64; 2],
        admissible: u64,
    ) -> ([f64; 2], f64, Vec<f64>) {
        let (low, high) = (
            f64::from(super::LOG_SIGMA_MIN),
            f64::from(super::LOG_SIGMA_MAX),
        );
        let mut log_prob = 0.0;
        let a = [0, 1].map(|i| {
            let log_sigma = low + (high - low) * (output[2 + i].tanh() + 1.0) / 2.0;
            let a = (output[i] + log_sigma.exp() * noise[i]).tanh();
            log_prob -= noise[i] * noise[i] / 2.0
                + log_sigma
                + (2.0 * std::f64::consts::PI).ln() / 2.0
                + (1.0 - a * a).ln();
            a
        });
        let weights: Vec<f64> = output[4..]
            .iter()
            .enumerate()
            .map(|(m, logit)| {
                if admissible >> m & 1 == 1 {
                    logit.exp()
                } else {
                    0.0
                }
            })
            .collect();
        let sum: f64 = weights.iter().sum();
        (a, log_prob, weights.iter().map(|w| w / sum).collect())
    }

    /// Returns the negative soft value.
    pub(crate) fn cost(log_prob: f64, p: &[f64], q: &[f64], beta: [f64; 2]) -> f64 {
        let users = p.iter().zip(q).filter(|(p, _)| **p > 0.0);
        beta[0] * log_prob + users.map(|(p, q)| p * (beta[1] * p.ln() - q)).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const USERS: usize = 5;
    const BETA: Temperatures = Temperatures {
        displacement: 0.3,
        user: 0.7,
    };

    /// `q_m = w_m . a + v_m`, so that the displacement matters.
    fn q(weights: &[f64], a: [f64; 2]) -> Vec<f64> {
        weights
            .chunks(3)
            .map(|w| w[0] * a[0] + w[1] * a[1] + w[2])
            .collect()
    }

    #[test]
    fn the_loss_and_its_gradient_match_finite_differences() {
        let mut rng = Pcg64Mcg::seed_from_u64(11);
        let mut sample = PolicySample::new(USERS, 3);
        let width = 16;
        let weights: Vec<f64> = (0..3 * USERS)
            .map(|_| rng.random_range(-2.0..2.0))
            .collect();
        let mut output = vec![0.0_f32; output_len(USERS) * width];
        output
            .iter_mut()
            .for_each(|x| *x = rng.random_range(-1.5..1.5));
        sample
            .noise
            .iter_mut()
            .for_each(|x| *x = rng.random_range(-2.0..2.0));
        let mut admissible = vec![UserSet::MAX; width];
        admissible[1] = 0b10110;
        admissible[2] = 0b00100;
        sample.evaluate(&output, &admissible);
        sample.entropy_mask[1] = 0.0;

        let mut values = vec![0.0; USERS * width];
        let mut slope = vec![0.0; 2 * width];
        for s in 0..3 {
            let a = [sample.displacement[s], sample.displacement[width + s]].map(f64::from);
            for (m, q) in q(&weights, a).into_iter().enumerate() {
                values[m * width + s] = q as f32;
                let p = sample.user_prob[m * width + s];
                for i in 0..2 {
                    slope[i * width + s] += p * weights[3 * m + i] as f32 / 3.0;
                }
            }
        }
        let mut gradient = vec![f32::NAN; output.len()];
        sample.gradient(&values, &slope, BETA, 3, &mut gradient);
        for s in 0..3 {
            let noise = [sample.noise[s], sample.noise[width + s]].map(f64::from);
            let loss = |output: &[f64]| {
                let (a, log_prob, p) = reference::sample(output, noise, admissible[s]);
                let counted = f64::from(sample.entropy_mask[s]) * log_prob;
                reference::cost(counted, &p, &q(&weights, a), [0.3, 0.7])
            };
            let mut at: Vec<f64> = (0..output_len(USERS))
                .map(|row| output[row * width + s].into())
                .collect();
            let got = sample.soft_cost(&values, BETA, s);
            assert!(
                (f64::from(got) - loss(&at)).abs() < 1e-5,
                "{got} {}",
                loss(&at)
            );
            for row in 0..at.len() {
                let x = at[row];
                at[row] = x + 1e-6;
                let above = loss(&at);
                at[row] = x - 1e-6;
                let below = loss(&at);
                at[row] = x;
                let numeric = (above - below) / 2e-6 / 3.0;
                let got = f64::from(gradient[row * width + s]);
                assert!((numeric - got).abs() < 1e-4, "row {row}: {numeric} {got}");
            }
        }
    }

    #[test]
    fn only_admissible_users_are_picked_and_as_often_as_they_are_likely() {
        let mut sample = PolicySample::new(USERS, 1);
        let mut output = vec![0.0; output_len(USERS) * 16];
        output[(DISPLACEMENT_ROWS + 1) * 16] = 1.0;
        sample.evaluate(&output, &[0b01011; 16]);
        let mut counts = [0; USERS];
        for i in 0..10_000 {
            counts[sample.pick_user(0, i as f32 / 10_000.0)] += 1;
        }
        for m in 0..USERS {
            let expected = sample.user_prob[m * 16] * 10_000.0;
            assert!((counts[m] as f32 - expected).abs() <= 2.0, "{counts:?}");
        }
        assert_eq!((counts[2], counts[4]), (0, 0));
        assert_eq!(sample.pick_user(0, 1.0), 3);
    }
}
