//! The quotas of the users, and the choice of the user to serve.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::intervention::Intervention;
use crate::{mission::Mission, scalar::Scalar};

/// Tracks which users may be served in a slot so that every quota can still be met (eq:a3).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fairness<const M: usize> {
    counts: Vec<u32, M>,
    quota: u32,
    slots: u32,
    slots_done: u32,
}

impl<const M: usize> Fairness<M> {
    /// Creates the state before the first slot.
    pub fn new<T: Scalar, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let mut counts = Vec::new();
        // The mission's users fit: they come from a vector of the same capacity.
        let _ = counts.resize(mission.user_count(), 0);
        Self {
            counts,
            quota: mission.quota(),
            slots: mission.slots(),
            slots_done: 0,
        }
    }

    /// Returns the number of slots that each user was served in so far.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Returns `sum_k max(0, floor(N/M) - count_k)`, the number of slots that are still needed for
    /// the quotas.
    pub fn owed(&self) -> u32 {
        self.counts
            .iter()
            .map(|&count| self.quota.saturating_sub(count))
            .sum()
    }

    /// Returns whether the quotas can still be met if `user` is served in the coming slot.
    pub fn admits(&self, user: usize) -> bool {
        let Some(&count) = self.counts.get(user) else {
            return false;
        };
        let owed_after = self.owed() - u32::from(count < self.quota);
        let slots_after = self.slots.saturating_sub(self.slots_done + 1);
        owed_after <= slots_after
    }

    /// Returns the admissible user with the highest score, the first of equals. Such a user always
    /// exists: quotas are out of reach only after slots in which no user was heard, and then every
    /// user below its quota is admissible.
    pub fn best<T: PartialOrd>(&self, score: impl Fn(usize) -> T) -> Option<usize> {
        let users = 0..self.counts.len();
        let lost = !users.clone().any(|user| self.admits(user));
        let admissible =
            |&user: &usize| self.admits(user) || (lost && self.counts[user] < self.quota);
        let mut best: Option<(usize, T)> = None;
        for user in users.filter(admissible) {
            let value = score(user);
            if best.as_ref().is_none_or(|(_, highest)| value > *highest) {
                best = Some((user, value));
            }
        }
        best.map(|(user, _)| user)
    }

    /// Records the end of a slot in which `user` was served, if any.
    pub fn record(&mut self, user: Option<usize>) {
        self.slots_done += 1;
        if let Some(count) = user.and_then(|user| self.counts.get_mut(user)) {
            *count += 1;
        }
    }

    /// Returns whether every user was served in its `floor(N/M)` slots.
    pub fn is_fair(&self) -> bool {
        self.owed() == 0
    }
}

/// Returns whether a policy's scores are usable: one per user, all finite.
pub fn scores_are_sound<T: Scalar>(scores: &[T], users: usize) -> bool {
    scores.len() == users && scores.iter().all(|score| score.finite())
}

/// Returns the admissible user with the highest score. The scores must be
/// [usable](scores_are_sound).
pub fn admissible_user<T: Scalar, const M: usize>(
    fairness: &Fairness<M>,
    scores: &[T],
    changed: &mut Intervention,
) -> Option<usize> {
    let chosen = fairness.best(|user| scores[user])?;
    changed.user |= scores.iter().any(|&score| score > scores[chosen]);
    Some(chosen)
}
