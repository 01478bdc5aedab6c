// SPDX-License-Identifier: MIT OR Apache-2.0
//! What a path loses on a vehicle with inertia.
//!
//! A plan is a path that keeps the speed limit. Where it turns faster than the vehicle can, or leaves
//! too little way to turn back to the destination, an estimate of the rate that is thereby lost is
//! subtracted from its value: paths that were made without regard to inertia become flyable step by
//! step.

use super::memory::PathMut;
use crate::{
    mission::Mission,
    scalar::{Displacement, Position, Scalar},
    shield::{ARRIVAL_FRACTION, Agility},
};

/// The changes of velocity that cost nothing, in units of what the vehicle can do in a slot. The
/// guidance smooths the way between waypoints, so a vehicle turns faster if it is asked for more.
/// Of 1, 1.5, 2.5, 4 and 6, four was the best on random missions
/// (`host-sim benchmark --profile arducopter`).
const FREE_TURNS: f64 = 4.0;
/// The loss for turning by one more unit, in slots at the rate limit.
const TURN_LOSS: f64 = 2.0;
/// The loss for each `V_max delta` by which the way home is too short, in slots at the rate limit.
const LATE_LOSS: f64 = 0.3;
/// The least change of velocity that is counted with, as a fraction of the longest step.
const LEAST_CHANGE: f64 = 0.01;

/// The inertia of a vehicle, on its way to the destination.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inertia<T: Scalar> {
    /// The places of the vehicle a slot ago and now.
    before: Position<T>,
    from: Position<T>,
    destination: Position<T>,
    /// The number of slots that remain.
    slots: usize,
    /// The longest step, and the distance from the destination that counts as arrived, metres.
    step_m: T,
    arrived_m: T,
    /// The largest change of velocity from slot to slot, metres a slot.
    change_m: T,
    /// What is lost for each metre of a turn that is too fast, and of missing way home, bit/s/Hz.
    turn_price: T,
    late_price: T,
}

impl<T: Scalar> Inertia<T> {
    /// Returns the inertia of a vehicle that is at `from` with `slots` slots left, or `None` for the
    /// paper's kinematics.
    pub(super) fn of_vehicle<const M: usize, const J: usize>(
        mission: &Mission<T, M, J>,
        (from, slots): (Position<T>, usize),
        agility: &Agility<T>,
    ) -> Option<Self> {
        let change_m = agility.velocity_change_m;
        if !change_m.finite() {
            return None;
        }
        let change_m = change_m.max(agility.step_m * T::of(LEAST_CHANGE));
        let rate_limit = mission.slot_rate_limit();
        Some(Self {
            before: from - Displacement::from(agility.drift_m),
            from,
            destination: mission.parameters().destination,
            slots,
            step_m: agility.step_m,
            arrived_m: mission.reach_m() * T::of(ARRIVAL_FRACTION),
            change_m,
            turn_price: rate_limit * T::of(TURN_LOSS) / change_m,
            late_price: rate_limit * T::of(LATE_LOSS) / agility.step_m,
        })
    }

    /// Returns the place of the vehicle a slot ago.
    pub(super) fn before(&self) -> Position<T> {
        self.before
    }

    /// Returns what is lost, bit/s/Hz, by a change of velocity at `here` that is larger than what is
    /// free.
    pub(super) fn turn_loss(
        &self,
        before: &Position<T>,
        here: &Position<T>,
        next: &Position<T>,
    ) -> T {
        let change = (next - here) - (here - before);
        let excess_m = change.norm() - self.change_m * T::of(FREE_TURNS);
        excess_m.max(T::zero()) * self.turn_price
    }

    /// Returns what is lost, bit/s/Hz, because way is missing for the turn back to the destination
    /// after `done` slots, the last of which leads from `before` to `here`. The way that the turn takes
    /// is that of [`crate::shield::ReachableSet::of_slot_with`].
    pub(super) fn late_loss(&self, before: &Position<T>, here: &Position<T>, done: usize) -> T {
        let way = self.destination - here;
        let away_m = way.norm();
        let toward = way / away_m.max(self.step_m * T::of(1e-6));
        let short_m = (toward * self.step_m - (here - before)).norm();
        if away_m - self.step_m + short_m <= self.arrived_m {
            return T::zero();
        }
        let left = T::count(self.slots.saturating_sub(done));
        let spare_m = (left + T::of(ARRIVAL_FRACTION)) * self.step_m - away_m;
        let turn_m = short_m * (T::of(2.0) + short_m / (self.change_m * T::of(2.0)));
        (turn_m - spare_m).max(T::zero()) * self.late_price
    }

    /// Returns what a path loses, bit/s/Hz.
    pub(super) fn loss(&self, path: &PathMut<'_, T>) -> T {
        let (mut before, mut here) = (self.before, self.from);
        let mut loss = T::zero();
        for index in 0..self.slots {
            let next = path.place(index);
            loss += self.turn_loss(&before, &here, &next) + self.late_loss(&here, &next, index + 1);
            (before, here) = (here, next);
        }
        loss
    }
}
