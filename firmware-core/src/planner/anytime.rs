// SPDX-License-Identifier: MIT OR Apache-2.0
//! The planner: a plan for the rest of a mission, improved while there is time.

use heapless::Vec;

use super::{
    PlannerError,
    memory::{Capacity, Memory, Parts},
    route::Route,
    search::Search,
    service::{is_fair, serve_in_turn},
    settings::PlannerSettings,
};
use crate::{
    collect::collect_first,
    mission::{Mission, MissionChange},
    policy::{Action, MeasuredGains, Observation, PlanQuality, Policy},
    scalar::{Displacement, Position, Scalar},
    shield::{Agility, reduce_to},
};

/// The result of a call of [`Planner::advance`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// The number of operations that were carried out.
    pub operations: u64,
    /// Whether nothing is left to do: more calls change nothing.
    pub finished: bool,
}

/// The operations that a planner may spend between decisions, in [`Policy::improve`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OperationsInFlight {
    /// On the first plan.
    pub first_plan: u64,
    /// On the plan after a change.
    pub per_change: u64,
    /// On the plan after each decision, which was corrected for the vehicle's position: the next
    /// decision profits.
    pub per_correction: u64,
}

/// The state of a mission from which the rest is planned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannerState<'a, T: Scalar> {
    /// The coming slot, 1 to `N`; beyond `N` nothing is left to plan.
    pub slot: u32,
    /// The measured position, metres. Outside the area, plans start at the nearest place in it;
    /// where it is not finite, at the position known before.
    pub position: Position<T>,
    /// Slots that each user has been served so far; users without an entry have none.
    pub counts: &'a [u32],
    /// What the vehicle can do now. A plan's steps are at most `step_m` and `V_max delta` long; a
    /// step or change of velocity that is not above 0 counts as no limit of its own, a drift that
    /// is not finite as rest.
    pub agility: Agility<T>,
}

/// A plan for the rest of a mission, and the state of the search that improves it. See the
/// [module](super).
///
/// `M` is the capacity for users, `J` for sensors. The planner uses the memory `S`, of the size
/// that [`Capacity`] states, and this of its own in single precision on a 64-bit host; with the
/// feature `learned-gains`, 8 bytes more for each node:
///
/// ```
/// # use firmware_core::planner::Planner;
/// # type Tables = (&'static mut [f32], &'static mut [u8]);
/// # let about = |bytes: usize, nodes: usize, size: usize| {
/// #     let learned = if cfg!(feature = "learned-gains") { 8 * nodes } else { 0 };
/// #     assert!((size - learned).abs_diff(bytes) <= bytes / 50, "{size}");
/// # };
/// about(5_260, 16 + 64, size_of::<Planner<f32, Tables, 16, 64>>());
/// about(3_640, 4 + 8, size_of::<Planner<f32, Tables, 4, 8>>());
/// ```
#[derive(Clone, Debug)]
pub struct Planner<T: Scalar, S, const M: usize, const J: usize> {
    search: Search<T, M, J>,
    memory: S,
    /// The coming slot.
    slot: u32,
    counts: Vec<u32, M>,
    agility: Agility<T>,
    /// Operations that [`Policy::decide`] may spend.
    operations_per_slot: u64,
    /// Operations that [`Policy::improve`] may spend after a change.
    operations_per_change: u64,
    /// Operations that [`Policy::improve`] may spend after a decision.
    operations_per_correction: u64,
    /// Operations that [`Policy::improve`] may still spend on a plan; 0 where nothing is to be
    /// planned.
    operations_left: u64,
    /// The same on correcting the plan for where the vehicle was at the last decision.
    correction_left: u64,
}

impl<T: Scalar, S: Memory<T>, const M: usize, const J: usize> Planner<T, S, M, J> {
    /// Creates a planner for a whole mission. Its plan is the straight line until
    /// [`advance`](Self::advance) is called.
    ///
    /// # Errors
    /// Returns an error if the mission exceeds the capacity, or if the memory is smaller than the
    /// capacity needs.
    pub fn new(
        mission: &Mission<T, M, J>,
        capacity: Capacity,
        memory: S,
    ) -> Result<Self, PlannerError> {
        let mut planner = Self::without_plan(mission, capacity, memory)?;
        planner.begin(&[], mission.parameters().start, false);
        Ok(planner)
    }

    /// As [`new`](Self::new), for a planner that stays in `place`: less of the stack is used.
    ///
    /// # Errors
    /// As [`new`](Self::new); `place` is then unchanged.
    pub fn new_in<'p>(
        place: &'p mut Option<Self>,
        mission: &Mission<T, M, J>,
        capacity: Capacity,
        memory: S,
    ) -> Result<&'p mut Self, PlannerError> {
        let planner = place.insert(Self::without_plan(mission, capacity, memory)?);
        planner.begin(&[], mission.parameters().start, false);
        Ok(planner)
    }

    /// Creates a planner whose memory holds no plan yet.
    #[inline(always)]
    fn without_plan(
        mission: &Mission<T, M, J>,
        mut capacity: Capacity,
        mut memory: S,
    ) -> Result<Self, PlannerError> {
        capacity.nodes = capacity.nodes.max(4);
        capacity.stages = capacity.stages.max(1);
        capacity.check(mission)?;
        let (values, bytes) = memory.parts();
        for (what, needed, got) in [
            ("numbers", capacity.values(), values.len()),
            ("bytes", capacity.indices(), bytes.len()),
        ] {
            if got < needed {
                return Err(PlannerError::TooLittleMemory { what, needed, got });
            }
        }
        let start = mission.parameters().start;
        let (slots, agility) = (mission.slots() as usize, Agility::ideal(mission));
        let route = Route::new(mission, start, slots, &agility);
        Ok(Self {
            search: Search::new(mission, capacity, PlannerSettings::default(), route),
            memory,
            slot: 1,
            counts: Vec::new(),
            agility,
            operations_per_slot: 0,
            operations_per_change: u64::MAX,
            operations_per_correction: 0,
            operations_left: 0,
            correction_left: 0,
        })
    }

    /// Sets the planner's settings.
    pub fn with_settings(mut self, settings: PlannerSettings) -> Self {
        self.search.settings = settings;
        self
    }

    /// Sets how many operations the planner may spend on each decision as a [`Policy`].
    pub fn with_operations_per_slot(mut self, operations: u64) -> Self {
        self.operations_per_slot = operations;
        self
    }

    /// Sets how many operations [`Policy::improve`] may spend in all. Without this call it spends
    /// none on the first plan, which is then left to [`advance`](Self::advance), any number after a
    /// change, and none after a decision.
    pub fn set_operations_in_flight(&mut self, operations: &OperationsInFlight) {
        self.operations_left = operations.first_plan;
        self.operations_per_change = operations.per_change;
        self.operations_per_correction = operations.per_correction;
    }

    /// Returns the mission that is planned.
    pub fn mission(&self) -> &Mission<T, M, J> {
        &self.search.mission
    }

    /// Plans the rest of the mission from another state. The prices are kept, and so is the part of
    /// the plan that is still ahead and feasible, or can be made feasible by small corrections.
    ///
    /// Worst case: 29 candidate places for every slot that remains. The state is copied.
    pub fn restart(&mut self, state: &PlannerState<'_, T>) {
        let slots = self.search.mission.slots();
        let slot = state.slot.min(slots.saturating_add(1)).max(1);
        let ahead = slot.checked_sub(self.slot).map(|passed| passed as usize);
        self.agility = state.agility.sound(&self.search.mission);
        if let Some(passed) = ahead {
            let mut parts = Parts::carve(&self.search.capacity, self.memory.parts());
            parts.best.drop_first(passed);
        }
        self.slot = slot;
        let position = state.position;
        let finite = position.x.finite() && position.y.finite();
        let position = if finite { position } else { self.search.from() };
        self.begin(state.counts, position, ahead.is_some());
    }

    /// Takes over a changed mission: positions and numbers of users and sensors, threshold, noise,
    /// powers, speed, number of slots. The search starts from the old grid and prices. Users keep
    /// their numbers. Call [`restart`](Self::restart) afterwards where the state has changed, too.
    ///
    /// # Errors
    /// Returns an error if the mission exceeds the capacity; the old mission is kept.
    pub fn change_mission(&mut self, mission: &Mission<T, M, J>) -> Result<(), PlannerError> {
        self.search.capacity.check(mission)?;
        let kept = mission.slots() == self.search.mission.slots();
        self.search.replace_mission(mission);
        self.agility = self.agility.sound(mission);
        self.slot = self.slot.min(mission.slots() + 1);
        let (counts, position) = (self.counts.clone(), self.search.from());
        self.begin(&counts, position, kept);
        Ok(())
    }

    /// Sets up route, quotas and first plan for the coming slot.
    fn begin(&mut self, counts: &[u32], position: Position<T>, keep: bool) {
        let search = &mut self.search;
        let slots = (search.mission.slots() + 1).saturating_sub(self.slot) as usize;
        let route = Route::new(&search.mission, position, slots, &self.agility);
        let users = search.mission.user_count();
        // The counts of users that may join later are kept, too.
        self.counts = collect_first(counts.iter().copied());
        search.least = [0; M];
        for (user, least) in search.least.iter_mut().enumerate().take(users) {
            let count = counts.get(user).copied().unwrap_or(0);
            *least = search.mission.quota_of(user).saturating_sub(count);
        }
        reduce_to(&mut search.least, slots);
        let mut parts = Parts::carve(&search.capacity, self.memory.parts());
        let keep = keep && route.has_choice();
        if keep {
            route.anchor(&mut parts.best);
        } else {
            for slot in 0..slots {
                parts.best.set_place(slot, route.straight(slot));
            }
        }
        let mission = &search.mission;
        let present = |user| mission.has_user(user);
        if !(keep && is_fair(&search.least, present, parts.best.users, slots)) {
            serve_in_turn(&search.least, present, parts.best.users, slots);
        }
        parts.trial.copy_from(&parts.best);
        parts.current.copy_from(&parts.best);
        search.start(route, keep);
    }

    /// Improves the plan until `budget` operations are spent or nothing is left to do. Does
    /// nothing for a budget of 0.
    ///
    /// An operation is about one multiplication and addition with its loads, 2 to 4 instructions.
    /// The last step may exceed the budget, by at most [`largest_step`](Self::largest_step)
    /// operations. More operations never give a worse plan.
    pub fn advance(&mut self, budget: u64) -> Progress {
        let mut parts = Parts::carve(&self.search.capacity, self.memory.parts());
        let mut operations = 0;
        while operations < budget && !self.search.is_done() {
            operations += self.search.step(&mut parts).max(1);
        }
        Progress {
            operations,
            finished: self.search.is_done(),
        }
    }

    /// Returns the largest number of operations that one step takes, whatever the budget.
    pub fn largest_step(&self) -> u64 {
        self.search.largest_step()
    }

    /// Returns the sum of the rates of the plan, bit/s/Hz, from the coming slot on, less what a
    /// vehicle with inertia is estimated to lose; 0 while the first plan has not been evaluated,
    /// which takes one evaluation of the rates for every slot.
    pub fn value(&self) -> T {
        self.search.best_total.unwrap_or(T::zero()).max(T::zero())
    }

    /// Returns an estimate of the largest value that any plan can have, bit/s/Hz: the least dual
    /// value on the planner's grid. It is not a bound, because values are interpolated between the
    /// nodes and stages are several slots long; `host-sim bound` certifies one. Returns `None`
    /// before the first iteration of the prices.
    pub fn upper_estimate(&self) -> Option<T> {
        let dual = self.search.prices.least_dual;
        dual.finite().then(|| dual.max(self.value()))
    }

    /// Returns an estimate of the gap `(upper - value) / upper` to the optimum, from 0 to 1; see
    /// [`upper_estimate`](Self::upper_estimate).
    pub fn gap_estimate(&self) -> Option<T> {
        let upper = self.upper_estimate()?;
        if upper <= T::zero() {
            return Some(T::zero());
        }
        Some(((upper - self.value()) / upper).max(T::zero()))
    }

    /// Returns the prices of fairness `lambda_m`, bit/s/Hz, one per user.
    pub fn prices(&self) -> &[T] {
        let users = self.search.users();
        self.search.prices.values.get(..users).unwrap_or(&[])
    }

    /// Returns the coming slot, from which on the plan is valid.
    pub fn slot(&self) -> u32 {
        self.slot
    }

    /// Returns the index of a slot in the plan.
    fn index(&self, slot: u32) -> Option<usize> {
        let index = slot.checked_sub(self.slot)? as usize;
        (index < self.search.route.slots).then_some(index)
    }

    /// Returns the place to be at by the end of a slot, metres, or `None` for slots that are not
    /// ahead.
    pub fn waypoint(&mut self, slot: u32) -> Option<Position<T>> {
        let index = self.index(slot)?;
        let parts = Parts::carve(&self.search.capacity, self.memory.parts());
        Some(parts.best.place(index))
    }

    /// Returns the user to serve in a slot, from 0, or `None` for slots that are not ahead.
    pub fn served_user(&mut self, slot: u32) -> Option<usize> {
        let index = self.index(slot)?;
        let parts = Parts::carve(&self.search.capacity, self.memory.parts());
        Some(parts.best.user(index))
    }

    /// Returns whether the plan starts from this state, so that there is nothing to correct.
    fn is_at(&self, observation: &Observation<'_, T>) -> bool {
        let count = |counts: &[u32], user| counts.get(user).copied().unwrap_or(0);
        observation.slot == self.slot
            && observation.position == self.search.from()
            && observation.agility.sound(self.mission()) == self.agility
            && (0..self.search.users())
                .all(|user| count(observation.counts, user) == count(&self.counts, user))
    }
}

impl<T: Scalar, S: Memory<T>, const M: usize, const J: usize> Policy<T, M> for Planner<T, S, M, J> {
    /// Returns the plan's waypoint and user, after the plan has been corrected for the observed
    /// state and the operations per slot have been spent on improving it.
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        if !self.is_at(observation) {
            self.restart(&PlannerState {
                slot: observation.slot,
                position: observation.position,
                counts: observation.counts,
                agility: observation.agility,
            });
            self.correction_left = self.operations_per_correction;
        }
        self.advance(self.operations_per_slot);
        let here = observation.position;
        let waypoint = self.waypoint(observation.slot);
        let served = self.served_user(observation.slot);
        let score = |user| {
            if served == Some(user) {
                T::one()
            } else {
                T::zero()
            }
        };
        let users = observation.counts.len().min(M);
        Action {
            displacement: waypoint.map_or(Displacement::zeros(), |waypoint| waypoint - here),
            user_scores: collect_first((0..users).map(score)),
        }
    }

    /// Starts a search from the present plan. A change that exceeds the planner's capacity is left
    /// to the shield.
    fn revise(&mut self, change: &MissionChange<T>, slots_begun: u32) {
        let mut mission = self.mission().clone();
        if mission.change(change, slots_begun).is_ok() && self.change_mission(&mission).is_ok() {
            self.search.learned.forget(change);
            self.operations_left = self.operations_left.max(self.operations_per_change);
        }
    }

    /// Learns how the gains differ from the channel model. Where they notably do, the present plan is
    /// corrected, as after a decision: a search as after a change gains no more.
    fn note_gains(&mut self, measured: &MeasuredGains<'_, T>) {
        if self.search.learned.note(&self.search.mission, measured) {
            let (counts, position) = (self.counts.clone(), self.search.from());
            self.begin(&counts, position, true);
            self.correction_left = self.operations_per_correction;
        }
    }

    /// Goes on with the search for the first plan, with the one that a change has started, or with
    /// the correction after a decision. The value of the rest of the plan is computed in any case.
    fn improve(&mut self, operations: u64) {
        let mut spent = 0;
        while spent < operations && self.search.best_total.is_none() && !self.search.is_done() {
            spent += self.advance(1).operations;
        }
        let limit = self.operations_left.max(self.correction_left);
        let progress = self.advance(operations.min(limit).saturating_sub(spent));
        for left in [&mut self.operations_left, &mut self.correction_left] {
            *left = if progress.finished {
                0
            } else {
                left.saturating_sub(spent + progress.operations)
            };
        }
    }

    fn quality(&self) -> Option<PlanQuality> {
        let number = |value: T| value.to_f64() as f32;
        Some(PlanQuality {
            value: number(self.value()),
            upper_estimate: self.upper_estimate().map_or(0.0, number),
            is_replanning: self.operations_left > 0,
        })
    }
}
