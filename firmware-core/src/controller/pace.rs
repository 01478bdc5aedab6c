//! The speed that the vehicle has shown it can hold.

use crate::{
    mission::Mission,
    scalar::{Position, Scalar},
    shield::Agility,
};

/// How far the vehicle gets in a slot, as it has shown: `V_max delta` until it is asked for nearly
/// that, slot after slot, and never delivers it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace<T: Scalar> {
    /// `V_max delta`, metres.
    reach_m: T,
    /// What the shield counts on, metres a slot.
    held_m: T,
    /// See [`Agility`].
    gain_m: T,
    drift_m: [T; 2],
    /// From where to where the last slot was flown.
    leg: Option<(Position<T>, Position<T>)>,
    /// How many slots in a row nearly everything was asked for, and the most that came of it.
    asked: u8,
    best_m: T,
}

impl<T: Scalar> Pace<T> {
    /// Slots in a row that prove a vehicle slower than asked: longer than any gathers speed.
    const PROOF: u8 = 8;

    pub(super) fn new<const M: usize, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let Agility {
            reach_m, gain_m, ..
        } = Agility::ideal(mission);
        Self {
            reach_m,
            held_m: reach_m,
            gain_m,
            drift_m: [T::zero(); 2],
            leg: None,
            asked: 0,
            best_m: T::zero(),
        }
    }

    /// For a vehicle with inertia: see [`Controller::rely_on_acceleration`](super::Controller).
    pub(super) fn rely_on_acceleration(&mut self, acceleration_mps2: T, slot_s: T) {
        self.gain_m = acceleration_mps2 * slot_s * slot_s;
    }

    /// What the shield counts on.
    pub(super) fn agility(&self) -> Agility<T> {
        Agility {
            reach_m: self.held_m,
            gain_m: self.gain_m,
            drift_m: self.drift_m,
        }
    }

    /// A slot is flown from here to there.
    pub(super) fn set_out(&mut self, from: Position<T>, waypoint: Position<T>) {
        self.leg = Some((from, waypoint));
    }

    /// The vehicle is at `measured` after the last slot.
    pub(super) fn observe(&mut self, measured: &Position<T>) {
        let Some((from, waypoint)) = self.leg else {
            return;
        };
        self.drift_m = (measured - from).into();
        let nearly_all = self.reach_m * T::of(0.99);
        let flown_m = (measured - from).norm().min(self.reach_m);
        self.held_m = self.held_m.max(flown_m);
        if (waypoint - from).norm() < nearly_all || flown_m >= nearly_all {
            self.asked = 0;
            self.best_m = T::zero();
            return;
        }
        self.asked = self.asked.saturating_add(1);
        self.best_m = self.best_m.max(flown_m);
        if self.asked >= Self::PROOF {
            self.held_m = self.best_m;
        }
    }
}
