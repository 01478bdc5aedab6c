//! Changes of the mission in flight: each comes into effect at the beginning of its slot.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::Controller;
use crate::{
    counter::count, inner::SlotLimits, mission::MissionChange, policy::Policy, scalar::Scalar,
};

/// The number of changes that can wait for their slot.
pub const CHANGES_MAX: usize = 32;

/// A change of the mission from a slot on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct DatedChange<T: Scalar> {
    /// The first slot with the change. If it has been planned already, it is allocated with the
    /// change, and the next one is planned with it.
    pub from_slot: u32,
    /// What changes.
    pub change: MissionChange<T>,
}

/// The changes that are not in effect yet, in the order in which they were received.
pub(super) type Pending<T> = Vec<DatedChange<T>, CHANGES_MAX>;

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize> Controller<T, P, M, J> {
    /// Takes note of a change. One whose slot is not ahead any more is made at once; the others
    /// wait. Returns false, and forgets the change, if there are [`CHANGES_MAX`] waiting already.
    pub fn note_change(&mut self, change: &DatedChange<T>) -> bool {
        let current = (self.under_way).map_or(self.slots_done + 1, |plan| plan.slot);
        if change.from_slot <= current {
            self.make_change(&change.change);
            return true;
        }
        self.pending.push(*change).is_ok()
    }

    /// Returns the number of changes that were refused when they would have come into effect,
    /// because the mission would have been invalid.
    pub fn changes_refused(&self) -> u32 {
        self.changes_refused
    }

    /// Makes the changes that are in effect from the coming slot on.
    pub(super) fn make_due_changes(&mut self) {
        let slot = self.slots_done + 1;
        let is_due = |change: &DatedChange<T>| change.from_slot <= slot;
        while let Some(index) = self.pending.iter().position(is_due) {
            let due = self.pending.remove(index);
            self.make_change(&due.change);
        }
    }

    fn make_change(&mut self, change: &MissionChange<T>) {
        // The slot under way cannot be undone.
        let begun = (self.under_way).map_or(self.slots_done, |plan| plan.slot);
        let under_way = self.under_way.map(|plan| plan.served_user);
        if self.mission.change(change, begun).is_err() {
            count(&mut self.changes_refused);
            return;
        }
        self.limits = SlotLimits::of_mission(&self.mission);
        self.fairness.revise(&self.mission, under_way);
        self.speed_estimator.revise(&self.mission);
        self.policy.revise(change, begun);
    }
}
