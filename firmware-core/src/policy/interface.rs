//! The interface of a policy: observation in, action out.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::scalar::{Displacement, Position, Scalar};

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
}

impl<T: Scalar> Observation<'_, T> {
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

/// The output of a policy, before the shield.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct Action<T: Scalar, const M: usize> {
    /// The displacement from the present position, metres.
    pub displacement: Displacement<T>,
    /// A score per user; the admissible user with the highest is served.
    pub user_scores: Vec<T, M>,
}

/// A rule that decides every slot of a mission.
pub trait Policy<T: Scalar, const M: usize> {
    /// Returns the action for the slot that the observation names.
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M>;
}

impl<T: Scalar, const M: usize, P: Policy<T, M> + ?Sized> Policy<T, M> for &mut P {
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        (**self).decide(observation)
    }
}
