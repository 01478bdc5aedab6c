// SPDX-License-Identifier: MIT OR Apache-2.0
//! The interface of a policy: observation in, action out.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{
    mission::{Mission, MissionChange},
    scalar::{Displacement, Position, Scalar},
    shield::Agility,
    units::PowerGain,
};

/// The number of components of the paper's state besides the users' counts: rate, MSE and the two
/// coordinates of the position.
pub const STATE_EXTRA: usize = 4;

/// The number of outputs of a policy besides the users' scores: the two components of the
/// displacement.
pub const OUTPUT_EXTRA: usize = 2;

/// Returns the length of the paper's state for a number of users: `[counts; R; MSE; x, y]`.
pub const fn state_len(users: usize) -> usize {
    users.saturating_add(STATE_EXTRA)
}

/// Returns the number of outputs of a policy for a number of users: `[displacement; user scores]`.
pub const fn output_len(users: usize) -> usize {
    users.saturating_add(OUTPUT_EXTRA)
}

/// The state after slot `n - 1`, from which slot `n` is planned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation<'a, T: Scalar> {
    /// `n`, the slot to plan, 1 to `N`. The counts imply it where every slot serves a user.
    pub slot: u32,
    /// The number of slots that each user was served in so far.
    pub counts: &'a [u32],
    /// `R_{n-1}`, bit/s/Hz; 0 before the first slot.
    pub rate: T,
    /// `MSE_{n-1}`; 0 before the first slot.
    pub mse: T,
    /// `q_{n-1}`, the position of the vehicle, metres.
    pub position: Position<T>,
    /// What the vehicle can do in the coming slot.
    pub agility: Agility<T>,
}

impl<'a, T: Scalar> Observation<'a, T> {
    /// Returns the observation before slot 1 of a mission, with an ideal vehicle at its start.
    pub fn at_start<const M: usize, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        Self {
            slot: 1,
            counts: &[],
            rate: T::zero(),
            mse: T::zero(),
            position: mission.parameters().start,
            agility: Agility::ideal(mission),
        }
    }

    /// Returns the observation of a mission with the first `users` users only, for a policy that was
    /// made for so many: others may have joined.
    pub fn of_first_users(&self, users: usize) -> Self {
        let counts: &'a [u32] = self.counts;
        Self {
            counts: counts.get(..users).unwrap_or(counts),
            ..*self
        }
    }

    /// Writes the paper's state in raw units: counts, bit/s/Hz, MSE, metres. Writes as much as fits
    /// and returns the length of the state.
    pub fn write_state(&self, state: &mut [T]) -> usize {
        let counts = self.counts.iter().map(|&count| T::count(count as usize));
        let rest: [T; STATE_EXTRA] = [self.rate, self.mse, self.position.x, self.position.y];
        for (slot, value) in state.iter_mut().zip(counts.chain(rest)) {
            *slot = value;
        }
        state_len(self.counts.len())
    }
}

/// The gains that were measured in the last slot with a channel state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredGains<'a, T: Scalar> {
    /// The measured position at the slot's end, metres.
    pub position: Position<T>,
    /// `|g_m|^2` of every user; 0 for one that was not heard, NaN for one that has moved since.
    pub user_gains: &'a [PowerGain<T>],
    /// `|h_j|^2` of every sensor, likewise.
    pub sensor_gains: &'a [PowerGain<T>],
}

/// The output of a policy, before the shield.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct Action<T: Scalar, const M: usize> {
    /// The displacement from the present position, metres.
    pub displacement: Displacement<T>,
    /// A score per user; the admissible user with the highest is served.
    pub user_scores: Vec<T, M>,
}

/// The quality of a policy's plan for the slots that are left, for those who watch the flight.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlanQuality {
    /// The sum of the rates that the plan expects from the coming slot on, bit/s/Hz.
    pub value: f32,
    /// An estimate of the largest value that any plan can have, bit/s/Hz; 0 where there is none.
    pub upper_estimate: f32,
    /// Whether the plan is being improved: before the flight, or after a change.
    pub is_replanning: bool,
}

/// A rule that decides every slot of a mission.
///
/// No method has a default: a policy that wraps another one and forgets to pass a call on would
/// compile, and the plan would not be revised after a change.
pub trait Policy<T: Scalar, const M: usize> {
    /// Returns the action for the slot that the observation names.
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M>;

    /// Takes note of a change of the mission, made after `slots_begun` slots are done or
    /// under way. A policy that cannot
    /// use it decides as before, without a score for users that joined; the shield sees to what
    /// must be.
    fn revise(&mut self, change: &MissionChange<T>, slots_begun: u32);

    /// Takes note of the gains that were measured in a slot, before the next decision. They may differ
    /// from the channel model. Does nothing in a policy without a model.
    fn note_gains(&mut self, measured: &MeasuredGains<'_, T>);

    /// Spends about `operations` on a better plan, if one is wanted, between two decisions. Does
    /// nothing in a policy without a plan.
    fn improve(&mut self, operations: u64);

    /// Returns the quality of the plan, if the policy has one.
    fn quality(&self) -> Option<PlanQuality>;
}

impl<T: Scalar, const M: usize, P: Policy<T, M> + ?Sized> Policy<T, M> for &mut P {
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        (**self).decide(observation)
    }

    fn revise(&mut self, change: &MissionChange<T>, slots_begun: u32) {
        (**self).revise(change, slots_begun);
    }

    fn note_gains(&mut self, measured: &MeasuredGains<'_, T>) {
        (**self).note_gains(measured);
    }

    fn improve(&mut self, operations: u64) {
        (**self).improve(operations);
    }

    fn quality(&self) -> Option<PlanQuality> {
        (**self).quality()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_missions::table_one;

    /// The paper's state in its order; a buffer of another length holds its beginning.
    #[test]
    fn the_state_is_written_in_the_papers_order() {
        let observation = Observation {
            slot: 4,
            counts: &[2, 0, 1],
            rate: 0.5,
            mse: 0.01,
            position: Position::new(30.0, 40.0),
            agility: Agility::ideal(&table_one()),
        };
        let expected = [2.0, 0.0, 1.0, 0.5, 0.01, 30.0, 40.0];
        assert_eq!(state_len(3), expected.len());
        for length in 0..10 {
            let mut state = [-1.0; 10];
            assert_eq!(observation.write_state(&mut state[..length]), 7);
            let written = length.min(7);
            assert_eq!(state[..written], expected[..written]);
            assert!(state[written..].iter().all(|&x| x == -1.0));
        }
    }
}
