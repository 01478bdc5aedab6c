//! The temperatures of SAC.

use pulp::Arch;
use serde::{Deserialize, Serialize};

use crate::nn::{Adam, exp, ln};

/// A temperature `alpha`, learned through its logarithm so that it stays positive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Temperature {
    pub(crate) log_alpha: f32,
    adam: Adam,
}

impl Temperature {
    /// Creates a temperature with an initial value.
    pub fn new(initial: f32) -> Self {
        Self {
            log_alpha: ln(initial),
            adam: Adam::new(1),
        }
    }

    /// Returns the temperature.
    pub fn alpha(&self) -> f32 {
        exp(self.log_alpha)
    }

    /// Takes a gradient step. `surplus` is the entropy above its target; a positive surplus lowers
    /// `alpha`.
    pub fn descend(&mut self, arch: Arch, learning_rate: f32, surplus: f32) {
        let gradient = self.alpha() * surplus;
        let log_alpha = std::slice::from_mut(&mut self.log_alpha);
        self.adam.step(arch, learning_rate, log_alpha, &[gradient]);
    }
}
