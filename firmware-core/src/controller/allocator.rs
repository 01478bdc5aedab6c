// SPDX-License-Identifier: MIT OR Apache-2.0
//! Powers, coefficients and normalizing factor of a slot, from its channel state or without one.

use heapless::Vec;

use super::{
    aging::LastState,
    exchange::{ChannelSource, ChannelState, Plan, SlotCommand},
    quality::ChannelQuality,
};
use crate::{
    collect::collect_first,
    inner::{
        SlotAllocation, SlotError, SlotLimits, SlotSolver, UncertainWorkspace, Workspace,
        bounded::{GainBounds, Guarantee},
    },
    mission::{Mission, MissionChange},
    policy::MeasuredGains,
    scalar::{Position, Scalar},
    shield::Fairness,
    uncertainty::SlotUncertainty,
    units::PowerGain,
};

/// Allocates slots: the limits of the mission, and the last channel state.
#[derive(Clone, Debug)]
pub(super) struct Allocator<T: Scalar, S, const M: usize, const J: usize> {
    limits: SlotLimits<T>,
    solver: S,
    last_state: LastState<T, M, J>,
    workspace: Workspace<T, J>,
}

impl<T: Scalar, S: SlotSolver<T>, const M: usize, const J: usize> Allocator<T, S, M, J> {
    pub(super) fn new(mission: &Mission<T, M, J>, solver: S) -> Self {
        Self {
            limits: SlotLimits::of_mission(mission),
            solver,
            last_state: LastState::none(),
            workspace: Workspace::default(),
        }
    }

    /// Applies a change of the mission; `mission` is the changed one.
    pub(super) fn revise(&mut self, mission: &Mission<T, M, J>, change: &MissionChange<T>) {
        self.last_state.forget(change);
        self.limits = SlotLimits::of_mission(mission);
    }

    /// Records the position that was measured after the last slot's end.
    pub(super) fn locate(&mut self, place: Position<T>) {
        self.last_state.locate(place);
    }

    /// Returns the gains that were measured in `slot`, unless no state was received in it.
    pub(super) fn measured_in(&self, slot: u32) -> Option<MeasuredGains<'_, T>> {
        self.last_state.of_slot(slot)
    }

    /// Returns the command of a slot with this channel state, which has one gain per user and
    /// sensor, of this quality.
    #[inline(never)] // so that its frame and that of `predicted` are not both on the stack
    pub(super) fn measured(
        &mut self,
        (mission, quality): (&Mission<T, M, J>, &ChannelQuality<M, J>),
        fairness: &Fairness<M>,
        plan: &Plan<T>,
        state: &ChannelState<T, M, J>,
    ) -> SlotCommand<T, J> {
        let mut rejected_gains = 0;
        let mut sane = |gain: &PowerGain<T>| {
            if gain.is_passive() {
                return *gain;
            }
            rejected_gains += 1;
            PowerGain(T::zero())
        };
        let user_gains: Vec<_, M> = collect_first(state.user_gains.iter().map(&mut sane));
        let sensor_gains: Vec<_, J> = collect_first(state.sensor_gains.iter().map(&mut sane));
        let gain = |user: usize| user_gains.get(user).copied().unwrap_or_default().0;
        let served_user = recipient(mission, fairness, plan.served_user, gain);
        let user_gain = served_user.and_then(|user| user_gains.get(user).copied());
        let gains = mission.of_sensors(&sensor_gains);
        let mut command = SlotCommand {
            served_user,
            rejected_gains,
            unheard_sensors: count_unheard(gains.clone().map(|gain| gain.0)),
            ..SlotCommand::silent(plan.slot, sensor_gains.len())
        };
        // A processor may have no instruction for square roots: each is computed once.
        let amplitude_gains: Vec<T, J> = collect_first(gains.map(|gain| gain.amplitude()));
        let coefficients = &mut command.sensor_coefficients;
        // A valid mission and valid gains make a valid slot problem, so no error can occur here. If
        // one did, nobody would transmit.
        let allocation = if quality.is_exact() {
            self.workspace
                .sensors_of_amplitude(&self.limits, &amplitude_gains)
                .and_then(|field| {
                    field.allocate(&self.solver, &amplitude_gains, user_gain, coefficients)
                })
        } else {
            let user = served_user.zip(user_gain);
            self.allocate_uncertain((mission, quality), &amplitude_gains, user, coefficients)
        };
        debug_assert!(allocation.is_ok(), "{allocation:?}");
        if let Ok(SlotAllocation { solution, mse }) = allocation {
            command.user_power = solution.user_power;
            command.normalizing_factor = solution.normalizing_factor;
            command.rate = solution.rate;
            command.status = solution.status;
            command.mse = mse;
            mission.spread_to_sensors(&mut command.sensor_coefficients, T::zero());
        }
        self.last_state
            .replace(plan.slot, &user_gains, &sensor_gains);
        command
    }

    /// Solves a slot with error statistics, for the expected MSE and an achievable rate. `user` is the
    /// served user with its gain.
    ///
    /// Statistics and workspace are on the stack of this function alone: a flight with exactly known
    /// channels does not need their memory.
    #[inline(never)]
    fn allocate_uncertain(
        &self,
        (mission, quality): (&Mission<T, M, J>, &ChannelQuality<M, J>),
        amplitude_gains: &[T],
        user: Option<(usize, PowerGain<T>)>,
        coefficients: &mut [T],
    ) -> Result<SlotAllocation<T>, SlotError<T>> {
        let mut workspace = UncertainWorkspace::<T, J>::default();
        let statistics = quality.statistics::<T>(present_sensors(mission));
        let user_error_variance = user_error_variance(quality, user.map(|(user, _)| user));
        let uncertainty = SlotUncertainty::new(&statistics, user_error_variance)?;
        let gain = user.map(|(_, gain)| gain);
        workspace
            .sensors_of_amplitude(&self.limits, amplitude_gains, &uncertainty)?
            .allocate(&self.solver, amplitude_gains, gain, coefficients)
    }

    /// Returns the command of a slot without a channel state: from the last one, aged, and the
    /// channel model at the measured position. The solver is not used.
    #[inline(never)]
    pub(super) fn predicted(
        &mut self,
        (mission, quality): (&Mission<T, M, J>, &ChannelQuality<M, J>),
        fairness: &Fairness<M>,
        plan: &Plan<T>,
        measured: &Position<T>,
    ) -> SlotCommand<T, J> {
        let state = self.last_state.aged(mission, plan.slot, measured);
        let gain = |user: usize| state.users.get(user).copied().unwrap_or_default().least.0;
        let served_user = recipient(mission, fairness, plan.served_user, gain);
        let user = served_user.and_then(|user| state.users.get(user).copied());
        let sensors: Vec<_, J> = collect_first(mission.of_sensors(&state.sensors).copied());
        let mut command = SlotCommand {
            served_user,
            source: ChannelSource::Predicted,
            age_slots: state.age_slots,
            unheard_sensors: count_unheard(sensors.iter().map(|gain| gain.least.0)),
            ..SlotCommand::silent(plan.slot, state.sensors.len())
        };
        let coefficients = &mut command.sensor_coefficients;
        let guarantee = if quality.is_exact() {
            let guarantee = self.workspace.guarantee(&self.limits, &sensors, user);
            guarantee.inspect(|guarantee| {
                for (coefficient, gain) in coefficients.iter_mut().zip(&sensors) {
                    *coefficient = guarantee.coefficient(gain);
                }
            })
        } else {
            let user = served_user.zip(user);
            self.guarantee_uncertain((mission, quality), &sensors, user, coefficients)
        };
        debug_assert!(guarantee.is_ok(), "{guarantee:?}");
        if let Ok(guarantee) = guarantee {
            command.user_power = guarantee.user_power;
            command.normalizing_factor = guarantee.normalizing_factor;
            command.rate = guarantee.rate;
            command.mse = guarantee.mse;
            command.status = guarantee.status;
            mission.spread_to_sensors(&mut command.sensor_coefficients, T::zero());
        }
        command
    }

    /// Returns the guarantee for estimates within bounds and with error statistics, and writes the
    /// coefficients. `user` is the served user with its bounds. Memory: as
    /// [`allocate_uncertain`](Self::allocate_uncertain).
    #[inline(never)]
    fn guarantee_uncertain(
        &self,
        (mission, quality): (&Mission<T, M, J>, &ChannelQuality<M, J>),
        sensors: &[GainBounds<T>],
        user: Option<(usize, GainBounds<T>)>,
        coefficients: &mut [T],
    ) -> Result<Guarantee<T>, SlotError<T>> {
        let mut workspace = UncertainWorkspace::<T, J>::default();
        let statistics = quality.statistics::<T>(present_sensors(mission));
        let user_error_variance = user_error_variance(quality, user.map(|(user, _)| user));
        let uncertainty = SlotUncertainty::new(&statistics, user_error_variance)?;
        let gain = user.map(|(_, gain)| gain);
        let guarantee = workspace.guarantee(&self.limits, sensors, gain, &uncertainty)?;
        for (coefficient, (gain, sensor)) in
            coefficients.iter_mut().zip(sensors.iter().zip(&statistics))
        {
            *coefficient = guarantee.uncertain_coefficient(gain, sensor);
        }
        Ok(guarantee)
    }

    /// Returns the admissible user with the highest rate over `waypoint` according to the channel
    /// model.
    pub(super) fn best_rate_user(
        &mut self,
        mission: &Mission<T, M, J>,
        fairness: &Fairness<M>,
        waypoint: &Position<T>,
    ) -> Option<usize> {
        let state = ChannelState::predicted(mission, 0, waypoint);
        let gains = mission.of_sensors(&state.sensor_gains);
        let gains: Vec<_, J> = collect_first(gains.copied());
        let field = self.workspace.sensors(&self.limits, &gains).ok()?;
        fairness.best(|user| field.rate(state.user_gains.get(user).copied().unwrap_or_default()))
    }
}

/// Returns the numbers of the sensors that have not left.
fn present_sensors<T: Scalar, const M: usize, const J: usize>(
    mission: &Mission<T, M, J>,
) -> impl Iterator<Item = usize> {
    (0..mission.sensor_count()).filter(|&sensor| mission.has_sensor(sensor))
}

/// Returns the error variance of the served user's channel, relative to its power gain.
fn user_error_variance<T: Scalar, const M: usize, const J: usize>(
    quality: &ChannelQuality<M, J>,
    user: Option<usize>,
) -> T {
    user.map_or(T::zero(), |user| quality.user(user).error_variance())
}

/// Returns the user to serve: the planned user if it is heard, otherwise the user with the highest
/// gain, an admissible one if possible. (Serving an inadmissible one costs the others nothing:
/// otherwise the slot would not be used.) Returns `None` where no user is heard.
fn recipient<T: Scalar, const M: usize, const J: usize>(
    mission: &Mission<T, M, J>,
    fairness: &Fairness<M>,
    planned: usize,
    gain: impl Fn(usize) -> T,
) -> Option<usize> {
    let heard = |user: usize| mission.has_user(user) && gain(user) > T::zero();
    if heard(planned) {
        return Some(planned);
    }
    // The rate rises with the gain, whatever the sensors do. (Users that are known with different
    // quality are not distinguished here.)
    let admissible = fairness.best(&gain).filter(|&user| heard(user));
    admissible.or_else(|| {
        let users = (0..mission.user_count()).filter(|&user| heard(user));
        users.max_by(|&a, &b| gain(a).order(&gain(b)))
    })
}

/// Returns the number of gains that are 0; at most as many as a message can carry.
fn count_unheard<T: Scalar>(gains: impl Iterator<Item = T>) -> u16 {
    gains.filter(|&gain| gain <= T::zero()).count() as u16
}
