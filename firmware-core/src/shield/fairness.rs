// SPDX-License-Identifier: MIT OR Apache-2.0
//! The quotas of the users, and the choice of the user to serve.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::intervention::Intervention;
use crate::{collect::collect_first, mission::Mission, scalar::Scalar};

/// Tracks which users may be served in a slot so that every quota can still be met (eq:a3).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fairness<const M: usize> {
    counts: Vec<u32, M>,
    /// The quota of every user, or `None` for one that left.
    quotas: Vec<Option<u32>, M>,
    slots: u32,
    slots_done: u32,
}

impl<const M: usize> Fairness<M> {
    /// Creates the state before the first slot.
    pub fn new<T: Scalar, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let mut fairness = Self {
            counts: Vec::new(),
            quotas: Vec::new(),
            slots: 0,
            slots_done: 0,
        };
        fairness.revise(mission, None);
        fairness
    }

    /// Creates the state after `slots_done` slots of a mission, from the number of slots that each
    /// user was served in. Quotas are not reduced where they can no longer be met.
    pub fn of_state<T: Scalar, const J: usize>(
        mission: &Mission<T, M, J>,
        counts: &[u32],
        slots_done: u32,
    ) -> Self {
        let users = 0..mission.user_count();
        let quota = |user| mission.has_user(user).then(|| mission.quota_of(user));
        let counts = counts.iter().copied().chain(core::iter::repeat(0));
        Self {
            counts: collect_first(counts.take(users.end)),
            quotas: collect_first(users.map(quota)),
            slots: mission.slots(),
            slots_done,
        }
    }

    /// Applies changes of the mission: users that joined or left, the number of slots.
    /// Where the quotas can no longer be met in the slots that are left, those of the users that
    /// are owed most are reduced. `under_way` is the user of the slot under way, if there is one: this
    /// slot is no longer free.
    pub fn revise<T: Scalar, const J: usize>(
        &mut self,
        mission: &Mission<T, M, J>,
        under_way: Option<usize>,
    ) {
        let users = 0..mission.user_count();
        // The mission's users fit: they come from a vector of the same capacity.
        let _ = self.counts.resize(users.end, 0);
        self.slots = mission.slots();
        let begun = self.slots_done + u32::from(under_way.is_some());
        let slots_left = self.slots.saturating_sub(begun);
        let mut owed = [0; M];
        for (user, (owed, &count)) in owed.iter_mut().zip(&self.counts).enumerate() {
            let count = count + u32::from(under_way == Some(user));
            *owed = mission.quota_of(user).saturating_sub(count);
        }
        let all = owed;
        reduce_to(&mut owed, slots_left as usize);
        let reductions = all.iter().zip(&owed).map(|(all, owed)| all - owed);
        self.quotas = collect_first(users.zip(reductions).map(|(user, reduction)| {
            let quota = mission.quota_of(user) - reduction;
            mission.has_user(user).then_some(quota)
        }));
    }

    /// Returns the number of slots that each user was served in so far.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Returns the quota of a user: the number of slots that it must be served in; `None` for one
    /// that left or does not exist.
    pub fn quota(&self, user: usize) -> Option<u32> {
        self.quotas.get(user).copied().flatten()
    }

    /// Returns the number of slots that a user is still owed.
    fn owed_to(&self, user: usize) -> u32 {
        let count = self.counts.get(user).copied().unwrap_or(0);
        self.quota(user).unwrap_or(0).saturating_sub(count)
    }

    /// Returns `sum_k max(0, quota_k - count_k)`, the number of slots that are still needed for the
    /// quotas.
    pub fn owed(&self) -> u32 {
        (0..self.counts.len()).map(|user| self.owed_to(user)).sum()
    }

    /// Returns whether the quotas can still be met if `user` is served in the coming slot.
    pub fn admits(&self, user: usize) -> bool {
        self.admits_beside(self.owed(), user)
    }

    /// As [`admits`](Self::admits), with the sum of what is owed.
    fn admits_beside(&self, owed: u32, user: usize) -> bool {
        let owed_after = owed - u32::from(self.owed_to(user) > 0);
        let slots_after = self.slots.saturating_sub(self.slots_done + 1);
        self.quota(user).is_some() && owed_after <= slots_after
    }

    /// Returns the admissible users. There is one in every slot of the mission: quotas are out of
    /// reach only after slots in which no user was heard, and then every user below its quota is
    /// admissible.
    pub fn admissible(&self) -> impl Iterator<Item = usize> + '_ {
        let users = 0..self.counts.len();
        let owed = self.owed();
        let lost = !users.clone().any(|user| self.admits_beside(owed, user));
        users
            .filter(move |&user| self.admits_beside(owed, user) || (lost && self.owed_to(user) > 0))
    }

    /// Returns the [admissible](Self::admissible) user with the highest score, the first of equals.
    pub fn best<T: PartialOrd>(&self, score: impl Fn(usize) -> T) -> Option<usize> {
        let mut best: Option<(usize, T)> = None;
        for user in self.admissible() {
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

    /// Returns whether every user that is there was served in as many slots as its quota.
    pub fn is_fair(&self) -> bool {
        self.owed() == 0
    }
}

/// Reduces the remaining quotas of the users to `slots` in all, the largest first.
pub(crate) fn reduce_to<const M: usize>(owed: &mut [u32; M], slots: usize) {
    let sum = |owed: &[u32; M]| -> usize { owed.iter().map(|&count| count as usize).sum() };
    while sum(owed) > slots {
        let Some(largest) = owed.iter_mut().max() else {
            return;
        };
        *largest -= 1;
    }
}

/// Returns whether a policy's scores are usable: all finite, one for each of the `users` that it was
/// made for, and none or one for those that joined.
pub fn scores_are_sound<T: Scalar>(scores: &[T], users: core::ops::RangeInclusive<usize>) -> bool {
    users.contains(&scores.len()) && scores.iter().all(|score| score.finite())
}

/// Returns the admissible user with the highest score; one without a score comes last. The scores
/// must be [usable](scores_are_sound).
pub fn admissible_user<T: Scalar, const M: usize>(
    fairness: &Fairness<M>,
    scores: &[T],
    changed: &mut Intervention,
) -> Option<usize> {
    let lowest = T::of(f64::NEG_INFINITY);
    let score = |user: usize| scores.get(user).copied().unwrap_or(lowest);
    let chosen = fairness.best(score)?;
    changed.user |= scores.iter().any(|&other| other > score(chosen));
    Some(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three users with a quota of 2 in 7 slots, after `slots_done` slots.
    fn fairness(counts: [u32; 3], slots_done: u32) -> Fairness<4> {
        Fairness {
            counts: Vec::from_slice(&counts).expect("three"),
            quotas: Vec::from_slice(&[Some(2); 3]).expect("three"),
            slots: 7,
            slots_done,
        }
    }

    /// A user is admitted exactly if the slots after this one suffice for what is owed then.
    #[test]
    fn users_are_admitted_while_the_quotas_can_be_met() {
        for (counts, slots_done, admitted) in [
            ([0, 0, 0], 0, [true, true, true]),
            ([1, 0, 0], 1, [true, true, true]),
            ([2, 0, 0], 2, [true, true, true]),
            ([3, 0, 0], 3, [false, true, true]),
            ([3, 2, 0], 5, [false, false, true]),
            ([3, 2, 2], 6, [false, false, false]),
        ] {
            let fairness = fairness(counts, slots_done);
            // The last slot is free if nothing is owed.
            let admitted = if fairness.is_fair() {
                [true; 3]
            } else {
                admitted
            };
            for (user, admitted) in admitted.into_iter().enumerate() {
                assert_eq!(fairness.admits(user), admitted, "{user} {counts:?}");
            }
            assert!(!fairness.admits(3));
        }
        assert!(fairness([2, 3, 2], 7).is_fair());
        assert!(!fairness([2, 4, 1], 7).is_fair());
    }

    /// The admissible user with the highest score, the first of equals.
    #[test]
    fn the_best_user_has_the_highest_score() {
        let best = |counts, slots_done, scores: [f64; 3]| {
            fairness(counts, slots_done).best(|user| scores[user])
        };
        assert_eq!(best([0, 0, 0], 0, [1.0, 3.0, 2.0]), Some(1));
        assert_eq!(best([0, 0, 0], 0, [1.0, 1.0, 1.0]), Some(0));
        assert_eq!(best([3, 0, 0], 3, [9.0, 1.0, 2.0]), Some(2));
        // The quotas are out of reach: users below theirs come first.
        assert_eq!(best([2, 0, 0], 4, [9.0, 1.0, 1.0]), Some(1));
        assert_eq!(best([3, 1, 0], 6, [9.0, 1.0, 2.0]), Some(2));
        assert_eq!(best([1, 2, 3], 7, [1.0, 9.0, 9.0]), Some(0));
    }

    /// The state that is made from counts is the tracked one, in every slot of a mission.
    #[test]
    fn a_state_is_made_from_counts() {
        let mission = crate::test_missions::table_one::<f64>();
        let mut tracked = Fairness::new(&mission);
        for slots_done in 0..60 {
            let made = Fairness::of_state(&mission, tracked.counts(), slots_done);
            assert_eq!(made, tracked);
            let admitted = (0..15).filter(|&user| made.admits(user));
            assert!(made.admissible().eq(admitted), "{slots_done}");
            tracked.record(made.admissible().last());
        }
        assert!(tracked.is_fair());
        // Users without a count have 0.
        assert_eq!(
            Fairness::of_state(&mission, &[], 0),
            Fairness::new(&mission)
        );
    }

    /// A change is recorded if a user with a higher score is not admissible, and stays recorded.
    #[test]
    fn a_replaced_user_is_recorded() {
        let recorded = |counts, slots_done, scores: [f64; 3], before| {
            let mut changed = Intervention {
                user: before,
                ..Intervention::default()
            };
            let fairness = fairness(counts, slots_done);
            let user = admissible_user(&fairness, &scores, &mut changed);
            (user, changed.user)
        };
        let equal = [1.0, 1.0, 1.0];
        assert_eq!(recorded([0, 0, 0], 0, equal, false), (Some(0), false));
        assert_eq!(recorded([0, 0, 0], 0, equal, true), (Some(0), true));
        let first = [2.0, 1.0, 1.0];
        assert_eq!(recorded([0, 0, 0], 0, first, false), (Some(0), false));
        assert_eq!(recorded([3, 0, 0], 3, first, false), (Some(1), true));
    }

    #[test]
    fn scores_are_one_finite_number_per_user() {
        assert!(scores_are_sound(&[1.0, -2.0], 2..=2));
        assert!(scores_are_sound(&[1.0, -2.0], 1..=3));
        assert!(!scores_are_sound(&[1.0, -2.0], 3..=3));
        assert!(!scores_are_sound(&[1.0, -2.0], 1..=1));
        assert!(!scores_are_sound(&[1.0, f64::NAN], 2..=2));
        assert!(!scores_are_sound(&[f64::INFINITY, 1.0], 2..=2));
    }
}
