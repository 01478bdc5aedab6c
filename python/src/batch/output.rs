//! The arrays that a step writes to, row by row.

use environment::Step;

use super::observation::Rows;
use crate::arrays::split_off;

/// The number of terms of a step: rate, MSE, and the two parts of the reward.
pub(super) const TERMS: usize = 4;
/// The number of flags of a step: `Gamma` was met, and the shield changed the action.
pub(super) const FLAGS: usize = 2;

/// The rows of some episodes.
pub(super) struct Outputs<'a> {
    pub(super) observation: Rows<'a>,
    pub(super) final_observation: Rows<'a>,
    pub(super) rewards: &'a mut [f64],
    pub(super) terminated: &'a mut [bool],
    pub(super) terms: [&'a mut [f64]; TERMS],
    pub(super) flags: [&'a mut [bool]; FLAGS],
    pub(super) users: &'a mut [i64],
}

impl<'a> Outputs<'a> {
    /// Takes the rows of the next `count` episodes.
    pub(super) fn split_off(&mut self, count: usize) -> Self {
        Self {
            observation: self.observation.split_off(count),
            final_observation: self.final_observation.split_off(count),
            rewards: split_off(&mut self.rewards, count),
            terminated: split_off(&mut self.terminated, count),
            terms: self.terms.each_mut().map(|term| split_off(term, count)),
            flags: self.flags.each_mut().map(|flag| split_off(flag, count)),
            users: split_off(&mut self.users, count),
        }
    }

    /// Writes the results of a slot, except the observation.
    pub(super) fn write(&mut self, step: &Step, served: usize) {
        let terms = [
            step.rate,
            step.mse,
            step.reward.rate,
            step.reward.trajectory,
        ];
        for (term, value) in self.terms.iter_mut().zip(terms) {
            term[0] = value;
        }
        let flags = [step.feasible, step.intervention.any()];
        for (flag, value) in self.flags.iter_mut().zip(flags) {
            flag[0] = value;
        }
        self.rewards[0] = step.reward.total;
        self.terminated[0] = step.last;
        self.users[0] = served as i64;
    }
}
