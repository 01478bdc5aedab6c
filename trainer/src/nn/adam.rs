//! Adam (Kingma and Ba, 2015) in PyTorch's form, which adds `epsilon` to the bias-corrected root.

use pulp::Arch;
use serde::{Deserialize, Serialize};

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-8;

/// First and second moments of a parameter vector's gradient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    first: Vec<f32>,
    second: Vec<f32>,
    /// `beta_1^t` and `beta_2^t`, updated by one multiplication per step.
    beta_1_power: f64,
    beta_2_power: f64,
}

impl Adam {
    /// Creates the optimizer state of `len` parameters.
    pub fn new(len: usize) -> Self {
        Self {
            first: vec![0.0; len],
            second: vec![0.0; len],
            beta_1_power: 1.0,
            beta_2_power: 1.0,
        }
    }

    /// Performs one step against the gradient.
    ///
    /// # Panics
    /// If a length differs from the one given to [`new`](Self::new).
    pub fn step(
        &mut self,
        arch: Arch,
        learning_rate: f32,
        parameters: &mut [f32],
        gradient: &[f32],
    ) {
        let n = self.first.len();
        assert_eq!((parameters.len(), gradient.len()), (n, n));
        self.beta_1_power *= f64::from(BETA_1);
        self.beta_2_power *= f64::from(BETA_2);
        let rate = (f64::from(learning_rate) / (1.0 - self.beta_1_power)) as f32;
        let root = (1.0 / (1.0 - self.beta_2_power)).sqrt() as f32;
        let (first, second) = (&mut self.first[..n], &mut self.second[..n]);
        // The moments of a dead neuron would decay into subnormal numbers and stay there, because
        // 0.9 times the smallest one rounds to itself. Arithmetic on subnormal numbers takes about
        // a hundred times as long as on normal ones.
        let flushed = |x: f32| if x.abs() < f32::MIN_POSITIVE { 0.0 } else { x };
        // All operations are elementwise and exact by IEEE 754, so every vector width gives the
        // same bits.
        arch.dispatch(|| {
            for i in 0..n {
                let g = gradient[i];
                let m = flushed(BETA_1 * first[i] + (1.0 - BETA_1) * g);
                let v = flushed(BETA_2 * second[i] + (1.0 - BETA_2) * (g * g));
                first[i] = m;
                second[i] = v;
                parameters[i] -= rate * m / (v.sqrt() * root + EPSILON);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments decay to zero without ever being subnormal.
    #[test]
    fn moments_of_a_dead_neuron_become_zero() {
        let mut adam = Adam::new(1);
        let mut parameter = [1.0];
        adam.step(Arch::new(), 1e-3, &mut parameter, &[1e-3]);
        for _ in 0..100_000 {
            adam.step(Arch::new(), 1e-3, &mut parameter, &[0.0]);
            assert!(!adam.first[0].is_subnormal() && !adam.second[0].is_subnormal());
        }
        assert_eq!((adam.first[0], adam.second[0]), (0.0, 0.0));
    }

    /// Compares with the published algorithm in double precision on a badly scaled quadratic.
    #[test]
    fn follows_the_published_algorithm() {
        let scale = [1.0_f64, 100.0, 1e-4];
        let mut reference = [1.0_f64, -2.0, 0.5];
        let (mut m, mut v) = ([0.0_f64; 3], [0.0_f64; 3]);
        let mut parameters = reference.map(|x| x as f32);
        let mut adam = Adam::new(3);
        for t in 1..=200 {
            let gradient: Vec<f32> = (0..3).map(|i| scale[i] as f32 * parameters[i]).collect();
            adam.step(Arch::new(), 0.01, &mut parameters, &gradient);
            for i in 0..3 {
                let g = scale[i] * reference[i];
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let (m_hat, v_hat) = (
                    m[i] / (1.0 - 0.9_f64.powi(t)),
                    v[i] / (1.0 - 0.999_f64.powi(t)),
                );
                reference[i] -= 0.01 * m_hat / (v_hat.sqrt() + 1e-8);
            }
        }
        for i in 0..3 {
            let error = (f64::from(parameters[i]) - reference[i]).abs();
            assert!(error < 1e-4, "{i}: {parameters:?} {reference:?}");
        }
    }
}
