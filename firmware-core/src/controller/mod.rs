// SPDX-License-Identifier: MIT OR Apache-2.0
//! The slot cycle: plan, fly, allocate.
//!
//! ```text
//! measured position --plan--> admissible waypoint + user --(fly)--> channel state --allocate--> slot command
//! ```
//!
//! A [`Controller`] is either *at rest* between two slots, and accepts [`plan`](Controller::plan),
//! or *under way* in one, and accepts [`allocate`](Controller::allocate); any other call is an
//! error that names the phase. It is over after slot `N`.
//!
//! Planning starts from where the vehicle **is**, never from where it was sent, and uses the speed
//! that the vehicle has shown it can hold.
//!
//! Gains that are NaN, infinite, negative or above 1 count as 0, *not heard*: such a sensor stays
//! silent, such a user is not served, and the command states how many there were. Where no channel
//! state is received at all, [`allocate_predicted`](Controller::allocate_predicted) uses the last
//! one, whose gains are then known within bounds that widen with its age, and the command states
//! that age.
//!
//! Gains are estimates. Their error statistics come from the ground as a [`ChannelQuality`]
//! ([`note_quality`](Controller::note_quality)). With any, MSE and rate of a command are the expected MSE and an
//! achievable rate ([`uncertainty`](crate::uncertainty)), and so is what is guaranteed without a state.
//!
//! ```
//! use firmware_core::{
//!     Mission, Position,
//!     controller::{ChannelState, Controller},
//!     mission::MissionParameters,
//!     policy::StraightLine,
//! };
//!
//! let mission = Mission::new(MissionParameters::<f64, 4, 8> {
//!     users: [Position::new(200.0, 700.0), Position::new(400.0, 800.0)].into_iter().collect(),
//!     sensors: [Position::new(700.0, 100.0), Position::new(800.0, 300.0)].into_iter().collect(),
//!     ..MissionParameters::table_one()
//! })?;
//! let mut controller = Controller::new(mission.clone(), StraightLine::new(&mission));
//! let mut position = mission.parameters().start;
//! while !controller.is_over() {
//!     let plan = controller.plan(position)?;
//!     // An ideal vehicle. The ground measures the channels where it has arrived.
//!     position = plan.waypoint;
//!     let measured = ChannelState::predicted(&mission, plan.slot, &position);
//!     let command = controller.allocate(&measured)?;
//!     // Where the threshold cannot be met from the position reached, the command says so.
//!     let is_accurate = command.mse <= mission.parameters().mse_threshold;
//!     assert!(is_accurate || !command.status.is_feasible());
//!     command.check(&mission)?;
//! }
//! assert!(mission.has_arrived(&position));
//! assert!(controller.fairness().is_fair());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Worst case per slot: `plan` is the policy plus 29 shield candidates; `allocate` is `M + J`
//! checks and one slot solution, `O(J log J)` by the default [`ExactSolver`]; `allocate_predicted` is `3
//! (M + J)` gains of the channel model and one guarantee. With error statistics each of the two
//! has in addition at most `2 J + 1` exponential functions, and a workspace on the stack.

mod aging;
mod allocator;
mod changes;
mod command_check;
mod error;
mod exchange;
mod quality;
mod speed_estimator;

use crate::{
    SENSORS_MAX, USERS_MAX,
    counter::count,
    inner::{ExactSolver, SlotSolver},
    limits::MotionLimits,
    mission::{Mission, MissionChange},
    policy::{Observation, Policy},
    scalar::{Displacement, Position, Scalar},
    shield::{self, Agility, Fairness, Intervention, ReachableSet},
};
use allocator::Allocator;
use changes::Pending;
pub use changes::{CHANGES_MAX, DatedChange};
pub use command_check::CommandError;
pub use error::ControllerError;
pub(crate) use exchange::check_gain_count;
pub use exchange::{ChannelSource, ChannelState, Plan, SlotCommand};
pub use quality::{ChannelQuality, SensorQuality, UserQuality, VarianceCode};
use speed_estimator::SpeedEstimator;

/// The onboard controller: a mission, a policy, a solver of slot problems, and the state between
/// slots.
#[derive(Clone, Debug)]
pub struct Controller<
    T: Scalar,
    P,
    const M: usize = USERS_MAX,
    const J: usize = SENSORS_MAX,
    S = ExactSolver,
> {
    mission: Mission<T, M, J>,
    policy: P,
    allocator: Allocator<T, S, M, J>,
    fairness: Fairness<M>,
    slots_done: u32,
    rate: T,
    mse: T,
    under_way: Option<Plan<T>>,
    speed_estimator: SpeedEstimator<T>,
    /// The number of users that the policy gives scores for: those from the start.
    scored_users: usize,
    /// The quality of the channel states; exact until one is received.
    quality: ChannelQuality<M, J>,
    /// The changes that are not in effect yet.
    pending: Pending<T>,
    /// The number of changes that were refused when they would have come into effect.
    changes_refused: u32,
}

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize> Controller<T, P, M, J> {
    /// Creates a controller at rest before slot 1, which allocates slots by the exact method.
    pub fn new(mission: Mission<T, M, J>, policy: P) -> Self {
        Self::with_solver(mission, policy, ExactSolver)
    }
}

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize, S: SlotSolver<T>>
    Controller<T, P, M, J, S>
{
    /// As [`new`](Controller::new), with another solver: a [`Method`](crate::inner::Method), for
    /// example.
    ///
    /// Capacities for users and sensors that are together more than 65,535 do not compile.
    #[inline(always)] // so that it is built where it stays: see `Onboard::new_in`
    pub fn with_solver(mission: Mission<T, M, J>, policy: P, solver: S) -> Self {
        const { check_gain_count(M, J) };
        Self {
            allocator: Allocator::new(&mission, solver),
            fairness: Fairness::new(&mission),
            speed_estimator: SpeedEstimator::new(&mission),
            scored_users: mission.user_count(),
            quality: ChannelQuality::default(),
            pending: Pending::new(),
            changes_refused: 0,
            mission,
            policy,
            slots_done: 0,
            rate: T::zero(),
            mse: T::zero(),
            under_way: None,
        }
    }

    /// Sets the limits of a vehicle with inertia: what it can be relied on to keep up, in any
    /// direction. The shield then keeps enough distance to brake and to turn back, and asks for no
    /// more than the vehicle can fly. Without this call the paper's kinematics are assumed.
    pub fn rely_on(&mut self, limits: &MotionLimits<T>) {
        let slot_s = self.mission.parameters().slot_duration_s;
        self.speed_estimator.rely_on(limits, slot_s);
    }

    /// Returns the vehicle's capabilities that the shield assumes now.
    pub fn agility(&self) -> Agility<T> {
        self.speed_estimator.agility()
    }

    /// Returns the mission being flown.
    pub fn mission(&self) -> &Mission<T, M, J> {
        &self.mission
    }

    /// Returns how often each user was served.
    pub fn fairness(&self) -> &Fairness<M> {
        &self.fairness
    }

    /// Returns the policy.
    pub fn policy(&self) -> &P {
        &self.policy
    }

    /// Gives the policy time to improve its plan: about `operations` of its work.
    pub fn improve_plan(&mut self, operations: u64) {
        self.policy.improve(operations);
    }

    /// Returns the number of slots done.
    pub fn slots_done(&self) -> u32 {
        self.slots_done
    }

    /// Returns whether all `N` slots are done.
    pub fn is_over(&self) -> bool {
        self.slots_done >= self.mission.slots()
    }

    /// Returns the plan of the slot under way, if there is one.
    pub fn under_way(&self) -> Option<&Plan<T>> {
        self.under_way.as_ref()
    }

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

    /// Takes the quality of the channel estimates: of the states that are used from now on, until
    /// another quality replaces it. Without any, and where all of it is exact, gains are taken for
    /// exactly known. The quality of a user or sensor that joins later is the worst one of the others
    /// until it is received.
    ///
    /// # Errors
    /// Returns an error, and the quality in effect stays, if the slot is before that of the quality
    /// in effect or after the present one, or if there is a wrong number of entries.
    pub fn note_quality(&mut self, quality: &ChannelQuality<M, J>) -> Result<(), ControllerError> {
        let (earliest, latest) = (self.quality.slot, self.slots_done.saturating_add(1));
        if !(earliest..=latest).contains(&quality.slot) {
            return Err(ControllerError::QualityOutOfTurn {
                got: quality.slot,
                earliest,
                latest,
            });
        }
        self.check_sizes(quality.users.len(), quality.sensors.len())?;
        self.quality.replace(quality);
        Ok(())
    }

    /// Returns the quality of the channel estimates in effect, without entries where all are exact.
    pub fn quality(&self) -> &ChannelQuality<M, J> {
        &self.quality
    }

    /// Returns the number of changes that were refused when they would have come into effect,
    /// because the mission would have been invalid.
    pub fn changes_refused(&self) -> u32 {
        self.changes_refused
    }

    /// Makes the changes that are in effect from the coming slot on.
    fn make_due_changes(&mut self) {
        while let Some(due) = self.take_due_change() {
            self.make_change(&due.change);
        }
    }

    /// Takes the first pending change that is in effect from the coming slot on.
    fn take_due_change(&mut self) -> Option<DatedChange<T>> {
        let slot = self.slots_done + 1;
        let mut due = None;
        self.pending.retain(|change| {
            let takes = due.is_none() && change.from_slot <= slot;
            if takes {
                due = Some(*change);
            }
            !takes
        });
        due
    }

    fn make_change(&mut self, change: &MissionChange<T>) {
        // The slot under way cannot be undone.
        let begun = (self.under_way).map_or(self.slots_done, |plan| plan.slot);
        let under_way = self.under_way.map(|plan| plan.served_user);
        if self.mission.change(change, begun).is_err() {
            count(&mut self.changes_refused);
            return;
        }
        self.allocator.revise(&self.mission, change);
        self.fairness.revise(&self.mission, under_way);
        self.speed_estimator.revise(&self.mission);
        self.policy.revise(change, begun);
    }

    /// Plans the next slot from the measured position: an admissible waypoint and user.
    ///
    /// # Errors
    /// Returns an error if a slot is under way, if the mission is over, or if the position is not
    /// finite.
    pub fn plan(&mut self, measured: Position<T>) -> Result<Plan<T>, ControllerError> {
        if let Some(plan) = &self.under_way {
            return Err(ControllerError::SlotUnderWay { slot: plan.slot });
        }
        if self.is_over() {
            let slots = self.mission.slots();
            return Err(ControllerError::MissionOver { slots });
        }
        if !(measured.x.finite() && measured.y.finite()) {
            return Err(ControllerError::PositionNotFinite);
        }
        let slot = self.slots_done + 1;
        let destination = self.mission.parameters().destination;
        self.speed_estimator.observe(&measured, &destination);
        self.allocator.locate(measured);
        if let Some(gains) = self.allocator.measured_in(self.slots_done) {
            self.policy.note_gains(&gains);
        }
        let agility = self.speed_estimator.agility();
        let action = self.policy.decide(&Observation {
            slot,
            counts: self.fairness.counts(),
            rate: self.rate,
            mse: self.mse,
            position: measured,
            agility,
        });
        let mut intervention = Intervention::default();
        let reachable = ReachableSet::of_slot_with(&self.mission, slot, measured, &agility);
        let sound = shield::displacement_is_sound(&action.displacement)
            && shield::scores_are_sound(
                &action.user_scores,
                self.scored_users..=self.mission.user_count(),
            );
        let (waypoint, chosen) = if sound {
            let displacement = &action.displacement;
            (
                shield::admissible_waypoint(&reachable, displacement, &mut intervention),
                shield::admissible_user(&self.fairness, &action.user_scores, &mut intervention),
            )
        } else {
            // An invalid output counts as no displacement and the admissible user with the best
            // rate.
            intervention.broken_output = true;
            let stay = Displacement::zeros();
            let waypoint = shield::admissible_waypoint(&reachable, &stay, &mut intervention);
            let (mission, fairness) = (&self.mission, &self.fairness);
            let user = self.allocator.best_rate_user(mission, fairness, &waypoint);
            (waypoint, user)
        };
        // An admissible user always exists: quotas that could be met before a slot can be met after
        // serving a user that has not reached its quota, and when all have, every user is
        // admissible.
        let served_user = chosen.unwrap_or(0);
        let plan = Plan {
            slot,
            waypoint,
            served_user,
            intervention,
        };
        self.speed_estimator.set_out(measured, waypoint);
        self.under_way = Some(plan);
        Ok(plan)
    }

    /// Returns powers, coefficients and normalizing factor for the slot under way, from the
    /// channels at the position reached. Ends the slot.
    ///
    /// # Errors
    /// Returns an error if no slot is under way, if the state belongs to another slot, or if it has
    /// a wrong number of gains. The slot stays under way, so that the right state can still come.
    pub fn allocate(
        &mut self,
        state: &ChannelState<T, M, J>,
    ) -> Result<SlotCommand<T, J>, ControllerError> {
        let plan = self.check_state(state)?;
        let known = (&self.mission, &self.quality);
        let command = (self.allocator).measured(known, &self.fairness, &plan, state);
        self.finish(&command);
        Ok(command)
    }

    /// As [`allocate`](Self::allocate), for a slot whose channel state was not received: uses the
    /// last state, aged, and the channel model at the measured position. `Gamma` holds for every
    /// gain that the aged state allows. Where it cannot hold, users are silent and the average is
    /// as accurate as can be guaranteed. The solver is not used.
    ///
    /// # Errors
    /// Returns an error if no slot is under way, or if the position is not finite.
    pub fn allocate_predicted(
        &mut self,
        measured: &Position<T>,
    ) -> Result<SlotCommand<T, J>, ControllerError> {
        if !(measured.x.finite() && measured.y.finite()) {
            return Err(ControllerError::PositionNotFinite);
        }
        let plan = self.planned()?;
        let known = (&self.mission, &self.quality);
        let command = (self.allocator).predicted(known, &self.fairness, &plan, measured);
        self.finish(&command);
        Ok(command)
    }

    /// Ends the slot.
    fn finish(&mut self, command: &SlotCommand<T, J>) {
        self.rate = command.rate;
        self.mse = command.mse;
        self.fairness.record(command.served_user);
        self.slots_done = command.slot;
        self.under_way = None;
        self.make_due_changes();
    }

    fn planned(&self) -> Result<Plan<T>, ControllerError> {
        self.under_way.ok_or(ControllerError::NothingPlanned {
            done: self.slots_done,
            slots: self.mission.slots(),
        })
    }

    /// Returns the plan of the slot under way if `state` belongs to it.
    ///
    /// # Errors
    /// As [`allocate`](Self::allocate).
    pub fn check_state(&self, state: &ChannelState<T, M, J>) -> Result<Plan<T>, ControllerError> {
        let plan = self.planned()?;
        if state.slot != plan.slot {
            return Err(ControllerError::WrongSlot {
                got: state.slot,
                expected: plan.slot,
            });
        }
        self.check_sizes(state.user_gains.len(), state.sensor_gains.len())?;
        Ok(plan)
    }

    /// Checks that there are as many entries as users and sensors.
    fn check_sizes(&self, users: usize, sensors: usize) -> Result<(), ControllerError> {
        let sizes = [
            ("user", users, self.mission.user_count()),
            ("sensor", sensors, self.mission.sensor_count()),
        ];
        match sizes.into_iter().find(|(_, got, expected)| got != expected) {
            Some((what, got, expected)) => Err(ControllerError::WrongSize {
                what,
                got,
                expected,
            }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{policy::FixedPosition, test_missions::table_one};

    /// Where a vehicle that makes at most `most_m` a slot ends a mission that hovers over the
    /// middle for as long as the shield lets it.
    fn destination_missed_m(most_m: f64) -> (f64, bool) {
        let mission = table_one::<f64>();
        let policy = FixedPosition::central(&mission);
        let mut controller = Controller::new(mission.clone(), policy);
        let mut here = mission.parameters().start;
        while let Ok(plan) = controller.plan(here) {
            let way = plan.waypoint - here;
            here += way * (most_m / way.norm()).min(1.0);
            controller.allocate_predicted(&here).expect("under way");
        }
        let missed_m = (here - mission.parameters().destination).norm();
        (missed_m, mission.has_arrived(&here))
    }

    /// The shield learns during the mission how fast the vehicle is, and lets it arrive in time.
    #[test]
    fn a_vehicle_slower_than_promised_still_arrives() {
        for most_m in [30.0, 27.5, 26.0, 24.0] {
            let (missed_m, arrived) = destination_missed_m(most_m);
            assert!(arrived, "{most_m} m a slot: {missed_m} m away");
        }
    }
}
