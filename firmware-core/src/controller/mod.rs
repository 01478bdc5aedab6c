//! The slot cycle: plan, fly, allocate.
//!
//! ```text
//! measured position --plan--> admissible waypoint + user --(fly)--> channel state --allocate--> slot command
//! ```
//!
//! A [`Controller`] is either *at rest* between two slots, and takes [`plan`](Controller::plan),
//! or *under way* in one, and takes [`allocate`](Controller::allocate); anything else is an
//! error that names the phase. It is over after slot `N`.
//!
//! Planning starts where the vehicle **is**, never where it was told to go, and counts on the
//! speed that it has shown it can hold.
//!
//! Gains that are NaN, infinite, negative or above 1 count as 0, *not heard*: such a sensor is
//! silent, such a user is not served, and the command says how many there were. Where no channel state comes
//! at all, [`allocate_predicted`](Controller::allocate_predicted) works from the last one, whose
//! gains are then known within bounds that widen with its age, and the command says how old.
//!
//! Worst case per slot: `plan` is the policy plus 29 shield candidates; `allocate` is `M + J`
//! checks and one slot solution, `O(J log J)` by the default [`Method`]; `allocate_predicted` is
//! `3 (M + J)` gains of the channel model and one guarantee.

mod aging;
mod exchange;
mod pace;

use heapless::Vec;

use crate::{
    SENSORS_MAX, USERS_MAX, aircomp,
    autopilot::guidance::Limits,
    inner::{Method, SlotLimits, Workspace},
    mission::Mission,
    policy::{Observation, Policy},
    scalar::{Displacement, Position, Scalar},
    shield::{self, Agility, Fairness, Intervention, ReachableSet},
    units::PowerGain,
};
use aging::LastState;
pub use exchange::{ChannelSource, ChannelState, Plan, SlotCommand};
use pace::Pace;

/// A call that the controller cannot follow now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ControllerError {
    /// `plan` while a slot is under way.
    #[error("slot {slot} is planned and not yet allocated")]
    SlotUnderWay {
        /// Which.
        slot: u32,
    },
    /// `allocate` while none is.
    #[error("no slot is planned: {done} of {slots} are done")]
    NothingPlanned {
        /// Slots done.
        done: u32,
        /// `N`.
        slots: u32,
    },
    /// The mission is over.
    #[error("the mission is over after {slots} slots")]
    MissionOver {
        /// `N`.
        slots: u32,
    },
    /// The channel state is about another slot.
    #[error("channel state is about slot {got}, but slot {expected} is under way")]
    WrongSlot {
        /// What came.
        got: u32,
        /// What was due.
        expected: u32,
    },
    /// The channel state has the wrong number of gains.
    #[error("channel state has {got} {what} gains, but the mission has {expected}")]
    WrongSize {
        /// `user` or `sensor`.
        what: &'static str,
        /// How many came.
        got: usize,
        /// How many there are.
        expected: usize,
    },
    /// The measured position is NaN or infinite.
    #[error("the measured position is not finite")]
    PositionNotFinite,
}

/// The onboard controller: a mission, a policy, and the state between slots.
#[derive(Clone, Debug)]
pub struct Controller<T: Scalar, P, const M: usize = USERS_MAX, const J: usize = SENSORS_MAX> {
    mission: Mission<T, M, J>,
    limits: SlotLimits<T>,
    method: Method<T>,
    policy: P,
    fairness: Fairness<M>,
    slots_done: u32,
    rate: T,
    mse: T,
    under_way: Option<Plan<T>>,
    pace: Pace<T>,
    last_state: LastState<T, M, J>,
    workspace: Workspace<T, J>,
}

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize> Controller<T, P, M, J> {
    /// At rest before slot 1.
    pub fn new(mission: Mission<T, M, J>, policy: P) -> Self {
        Self {
            limits: SlotLimits::of_mission(&mission),
            method: Method::Exact,
            fairness: Fairness::new(&mission),
            pace: Pace::new(&mission),
            last_state: LastState::none(),
            mission,
            policy,
            slots_done: 0,
            rate: T::zero(),
            mse: T::zero(),
            under_way: None,
            workspace: Workspace::default(),
        }
    }

    /// Slots are allocated by another method than the exact one.
    pub fn with_method(self, method: Method<T>) -> Self {
        Self { method, ..self }
    }

    /// For a vehicle with inertia, which can do `limits`: what it can be relied on to keep up, in
    /// any direction. The shield then keeps room to brake and to turn back, and asks for no more
    /// than the vehicle can fly. Without this, the paper's kinematics.
    pub fn rely_on(&mut self, limits: &Limits<T>) {
        let slot_s = self.mission.parameters().slot_duration_s;
        self.pace.rely_on(limits, slot_s);
    }

    /// What the shield counts on now.
    pub fn agility(&self) -> Agility<T> {
        self.pace.agility()
    }

    /// The mission being flown.
    pub fn mission(&self) -> &Mission<T, M, J> {
        &self.mission
    }

    /// Who was served how often.
    pub fn fairness(&self) -> &Fairness<M> {
        &self.fairness
    }

    /// Slots that are done.
    pub fn slots_done(&self) -> u32 {
        self.slots_done
    }

    /// Whether all `N` slots are done.
    pub fn is_over(&self) -> bool {
        self.slots_done >= self.mission.slots()
    }

    /// The slot under way, if one is.
    pub fn under_way(&self) -> Option<&Plan<T>> {
        self.under_way.as_ref()
    }

    /// Decides the next slot from where the vehicle is: an admissible waypoint and user.
    ///
    /// # Errors
    /// A slot under way, a mission that is over, a position that is not finite.
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
        let action = self.policy.decide(&Observation {
            slot,
            counts: self.fairness.counts(),
            rate: self.rate,
            mse: self.mse,
            position: measured,
        });
        let mut intervention = Intervention::default();
        let destination = self.mission.parameters().destination;
        self.pace.observe(&measured, &destination);
        self.last_state.locate(measured);
        let agility = self.pace.agility();
        let reachable = ReachableSet::of_slot_with(&self.mission, slot, measured, &agility);
        let sound = shield::displacement_is_sound(&action.displacement)
            && shield::scores_are_sound(&action.user_scores, self.mission.user_count());
        let (waypoint, chosen) = if sound {
            let displacement = &action.displacement;
            (
                shield::admissible_waypoint(&reachable, displacement, &mut intervention),
                shield::admissible_user(&self.fairness, &action.user_scores, &mut intervention),
            )
        } else {
            // A broken output counts as no displacement and the best-rate admissible user.
            intervention.broken_output = true;
            let stay = Displacement::zeros();
            let waypoint = shield::admissible_waypoint(&reachable, &stay, &mut intervention);
            (waypoint, self.best_rate_user(&waypoint))
        };
        // There always is an admissible user: quotas that could be met before a slot can be met
        // after serving somebody who is owed, and when nobody is owed everybody is admissible.
        let served_user = chosen.unwrap_or(0);
        let plan = Plan {
            slot,
            waypoint,
            served_user,
            intervention,
        };
        self.pace.set_out(measured, waypoint);
        self.under_way = Some(plan);
        Ok(plan)
    }

    /// Powers, coefficients and normalising factor for the slot under way, from the channels at
    /// the position reached. Ends the slot.
    ///
    /// # Errors
    /// No slot under way, another slot's state, a wrong number of gains. The slot stays under
    /// way, so that the right state can still come.
    pub fn allocate(
        &mut self,
        state: &ChannelState<T, M, J>,
    ) -> Result<SlotCommand<T, J>, ControllerError> {
        let plan = self.check_state(state)?;
        let mut rejected_gains = 0;
        let mut sane = |gain: &PowerGain<T>| {
            if gain.is_passive() {
                return *gain;
            }
            rejected_gains += 1;
            PowerGain(T::zero())
        };
        let user_gains: Vec<_, M> = state.user_gains.iter().map(&mut sane).collect();
        let sensor_gains: Vec<_, J> = state.sensor_gains.iter().map(&mut sane).collect();
        let command = SlotCommand {
            rejected_gains,
            ..self.allocate_known(&plan, &user_gains, &sensor_gains)
        };
        self.last_state
            .replace(plan.slot, &user_gains, &sensor_gains);
        self.finish(&command);
        Ok(command)
    }

    /// As [`allocate`](Self::allocate), for a slot whose channel state did not come: from the
    /// last one that did, aged, and the channel model at the measured position. `Gamma` holds for
    /// every gain that the aged state allows; where it cannot, users are silent and the average
    /// is as accurate as can be promised. Whatever the [`Method`].
    ///
    /// # Errors
    /// No slot under way, a position that is not finite.
    pub fn allocate_predicted(
        &mut self,
        measured: &Position<T>,
    ) -> Result<SlotCommand<T, J>, ControllerError> {
        if !(measured.x.finite() && measured.y.finite()) {
            return Err(ControllerError::PositionNotFinite);
        }
        let plan = self.planned()?;
        let state = self.last_state.aged(&self.mission, plan.slot, measured);
        let served_user = self.recipient(plan.served_user, |user| state.users[user].least.0);
        let user = served_user.map(|user| state.users[user]);
        let guarantee = self.workspace.guarantee(&self.limits, &state.sensors, user);
        debug_assert!(guarantee.is_ok(), "{guarantee:?}");
        let mut command = SlotCommand {
            served_user,
            source: ChannelSource::Predicted,
            age_slots: state.age_slots,
            unheard_sensors: count_unheard(state.sensors.iter().map(|gain| gain.least.0)),
            ..SlotCommand::silent(plan.slot, state.sensors.len())
        };
        if let Ok(guarantee) = guarantee {
            command.user_power = guarantee.user_power;
            command.normalizing_factor = guarantee.normalizing_factor;
            command.rate = guarantee.rate;
            command.mse = guarantee.mse;
            command.status = guarantee.status;
            command.sensor_coefficients = state
                .sensors
                .iter()
                .map(|gain| guarantee.coefficient(gain))
                .collect();
        }
        self.finish(&command);
        Ok(command)
    }

    /// The slot for valid gains.
    fn allocate_known(
        &mut self,
        plan: &Plan<T>,
        user_gains: &[PowerGain<T>],
        sensor_gains: &[PowerGain<T>],
    ) -> SlotCommand<T, J> {
        let served_user = self.recipient(plan.served_user, |user| user_gains[user].0);
        let user_gain = served_user.map(|user| user_gains[user]);
        let mut command = SlotCommand::silent(plan.slot, sensor_gains.len());
        command.served_user = served_user;
        command.unheard_sensors = count_unheard(sensor_gains.iter().map(|gain| gain.0));
        // A processor may have no instruction for roots: each is drawn once.
        let amplitude_gains: Vec<T, J> = sensor_gains.iter().map(|g| g.amplitude()).collect();
        // A valid mission and valid gains make a slot problem: an error cannot come from here,
        // and if one did, everybody would stay silent.
        let solution = self
            .workspace
            .sensors_of_amplitude(&self.limits, &amplitude_gains)
            .and_then(|field| self.method.solve(&field, user_gain));
        debug_assert!(solution.is_ok(), "{solution:?}");
        if let Ok(solution) = solution {
            command.user_power = solution.user_power;
            command.normalizing_factor = solution.normalizing_factor;
            command.rate = solution.rate;
            command.status = solution.status;
            let signal_w = user_gain.unwrap_or_default().0 * command.user_power.0;
            let arriving = (amplitude_gains.iter())
                .zip(&mut command.sensor_coefficients)
                .map(|(&amplitude, coefficient)| {
                    *coefficient = solution.coefficient_of_amplitude(amplitude);
                    *coefficient * amplitude
                });
            command.mse = aircomp::mse(
                arriving,
                signal_w + self.limits.noise_power.0,
                command.normalizing_factor,
            );
        }
        command
    }

    /// Who is served: the planned user if it is heard, otherwise the best that is, an admissible
    /// one if possible. (An inadmissible one takes nothing from anybody: without it the slot
    /// would pass unused.) `None` where nobody is heard.
    fn recipient(&self, planned: usize, gain: impl Fn(usize) -> T) -> Option<usize> {
        let heard = |user: usize| gain(user) > T::zero();
        if heard(planned) {
            return Some(planned);
        }
        // The rate rises with the gain, whatever the sensors do.
        self.fairness
            .best(&gain)
            .filter(|&user| heard(user))
            .or_else(|| {
                let users = (0..self.mission.user_count()).filter(|&user| heard(user));
                users.max_by(|&a, &b| gain(a).order(&gain(b)))
            })
    }

    /// The slot is over.
    fn finish(&mut self, command: &SlotCommand<T, J>) {
        self.rate = command.rate;
        self.mse = command.mse;
        self.fairness.record(command.served_user);
        self.slots_done = command.slot;
        self.under_way = None;
    }

    fn planned(&self) -> Result<Plan<T>, ControllerError> {
        self.under_way.ok_or(ControllerError::NothingPlanned {
            done: self.slots_done,
            slots: self.mission.slots(),
        })
    }

    /// The slot under way, if `state` is about it.
    ///
    /// # Errors
    /// Those of [`allocate`](Self::allocate).
    pub fn check_state(&self, state: &ChannelState<T, M, J>) -> Result<Plan<T>, ControllerError> {
        let plan = self.planned()?;
        if state.slot != plan.slot {
            return Err(ControllerError::WrongSlot {
                got: state.slot,
                expected: plan.slot,
            });
        }
        let sizes = [
            ("user", state.user_gains.len(), self.mission.user_count()),
            (
                "sensor",
                state.sensor_gains.len(),
                self.mission.sensor_count(),
            ),
        ];
        match sizes.into_iter().find(|(_, got, expected)| got != expected) {
            Some((what, got, expected)) => Err(ControllerError::WrongSize {
                what,
                got,
                expected,
            }),
            None => Ok(plan),
        }
    }

    /// The admissible user with the highest rate over `waypoint`, by the channel model.
    fn best_rate_user(&mut self, waypoint: &Position<T>) -> Option<usize> {
        let state = ChannelState::predicted(&self.mission, self.slots_done + 1, waypoint);
        let field = self
            .workspace
            .sensors(&self.limits, &state.sensor_gains)
            .ok()?;
        self.fairness
            .best(|user| field.rate(state.user_gains[user]))
    }
}

/// How many gains are 0; at most as many as a message can carry.
fn count_unheard<T: Scalar>(gains: impl Iterator<Item = T>) -> u16 {
    gains.filter(|&gain| gain <= T::zero()).count() as u16
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

    /// The shield learns on the way out how fast the vehicle is, and brings it home in time.
    #[test]
    fn a_vehicle_slower_than_promised_still_arrives() {
        for most_m in [30.0, 27.5, 26.0, 24.0] {
            let (missed_m, arrived) = destination_missed_m(most_m);
            assert!(arrived, "{most_m} m a slot: {missed_m} m away");
        }
    }
}
