// SPDX-License-Identifier: MIT OR Apache-2.0
//! The distance that the vehicle can fly in a slot, estimated from its limits and from the slots
//! flown.

use crate::{
    limits::MotionLimits,
    mission::Mission,
    scalar::{Position, Scalar},
    shield::Agility,
};

/// Estimates how far the vehicle gets in a slot. The estimate starts from the limits that the
/// vehicle's parameters impose, and is corrected after each slot: by how much a slot exceeds the
/// step that was asked for, and by what the vehicle does not reach even when it is asked
/// repeatedly.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpeedEstimator<T: Scalar> {
    /// `V_max delta`, metres.
    reach_m: T,
    /// The distance by which a slot may exceed the longest step that is asked for, metres: kept
    /// free below `reach_m`. Zero for a vehicle that is exactly where it is sent.
    tracking_m: T,
    /// The distance that the shield assumes, metres a slot.
    held_m: T,
    /// See [`Agility`].
    velocity_change_m: T,
    drift_m: [T; 2],
    /// The start and the waypoint of the last slot.
    leg: Option<(Position<T>, Position<T>)>,
    /// The number of slots in a row that fell short of what was asked although the vehicle no
    /// longer gained speed, and the largest distance among them.
    short: u8,
    best_m: T,
}

impl<T: Scalar> SpeedEstimator<T> {
    /// The number of slots in a row that prove that the vehicle is slower than asked.
    const PROOF: u8 = 3;
    /// The fraction of the assumed distance from which a slot asks for nearly everything.
    const DEMANDING: f64 = 0.9;
    /// The fraction of the asked distance below which a slot falls short.
    const SHORT: f64 = 0.98;
    /// A slot that exceeds the last one by more than this fraction of the asked distance gains
    /// speed.
    const GAINS: f64 = 0.03;
    /// The distance that is kept free at first: a fraction of `V_max delta`, and metres.
    const TRACKING: f64 = 0.022;
    const TRACKING_M: f64 = 0.1;
    /// The fraction of `V_max delta` above which the distance of a slot increases what is kept
    /// free.
    const CLOSE: f64 = 0.98;
    /// The largest fraction that is kept free.
    const TRACKING_MOST: f64 = 0.1;
    /// The smallest cosine of the angle to the direction of the destination at which a slot counts
    /// as evidence for flights in that direction.
    const HOMEWARD: f64 = 0.7;
    /// A slower vehicle is asked for this factor more than it has shown, so that it can show more.
    const ASKED: f64 = 1.1;

    pub(super) fn new<const M: usize, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let Agility {
            reach_m,
            velocity_change_m,
            ..
        } = Agility::ideal(mission);
        Self {
            reach_m,
            tracking_m: T::zero(),
            held_m: reach_m,
            velocity_change_m,
            drift_m: [T::zero(); 2],
            leg: None,
            short: 0,
            best_m: T::zero(),
        }
    }

    /// Sets the limits of a vehicle with inertia: see
    /// [`Controller::rely_on`](super::Controller::rely_on).
    pub(super) fn rely_on(&mut self, limits: &MotionLimits<T>, slot_s: T) {
        self.velocity_change_m = limits.acceleration_mps2 * slot_s * slot_s;
        if self.velocity_change_m.finite() {
            let largest_m = self.reach_m * T::of(Self::TRACKING_MOST);
            let tracking_m = self.reach_m * T::of(Self::TRACKING) + T::of(Self::TRACKING_M);
            self.tracking_m = tracking_m.min(largest_m);
        }
        self.held_m = self.most_m().min(limits.speed_mps * slot_s);
    }

    /// Takes over a changed `V_max`. What the vehicle has shown stays known.
    pub(super) fn revise<const M: usize, const J: usize>(&mut self, mission: &Mission<T, M, J>) {
        let before_m = self.reach_m;
        self.reach_m = mission.reach_m();
        if self.held_m >= before_m - self.tracking_m {
            // It was as fast as it was allowed to be.
            self.held_m = self.held_m.max(self.most_m());
        }
        self.short = 0;
        self.best_m = T::zero();
    }

    /// Returns the longest step that is asked for.
    fn most_m(&self) -> T {
        self.reach_m - self.tracking_m
    }

    /// Returns the capabilities that the shield assumes.
    pub(super) fn agility(&self) -> Agility<T> {
        Agility {
            step_m: self.most_m().min(self.held_m * T::of(Self::ASKED)),
            reach_m: self.held_m.min(self.most_m()),
            velocity_change_m: self.velocity_change_m,
            drift_m: self.drift_m,
        }
    }

    /// Records that a slot is flown between two places.
    pub(super) fn set_out(&mut self, from: Position<T>, waypoint: Position<T>) {
        self.leg = Some((from, waypoint));
    }

    /// Updates the estimate: the vehicle is at `measured` after the last slot, on its way to
    /// `destination`.
    pub(super) fn observe(&mut self, measured: &Position<T>, destination: &Position<T>) {
        let Some((from, waypoint)) = self.leg else {
            return;
        };
        let last_m = nalgebra::Vector2::from(self.drift_m).norm();
        let (asked, way) = (waypoint - from, measured - from);
        let turned =
            asked.dot(&nalgebra::Vector2::from(self.drift_m)) < asked.norm() * last_m * T::of(0.9);
        self.drift_m = way.into();
        let (asked_m, flown_m) = (asked.norm(), way.norm());
        if self.velocity_change_m.finite() {
            let close_m = (flown_m - self.reach_m * T::of(Self::CLOSE)).max(T::zero());
            let largest_m = self.reach_m * T::of(Self::TRACKING_MOST);
            self.tracking_m = (self.tracking_m + close_m).min(largest_m);
        }
        // What is flown with the wind from another direction says nothing about the way to the
        // destination.
        let home = destination - from;
        if way.dot(&home) >= flown_m * home.norm() * T::of(Self::HOMEWARD) {
            self.held_m = self.held_m.max(flown_m.min(self.most_m()));
        }
        let gains = flown_m > last_m + asked_m * T::of(Self::GAINS);
        // Only a slot that asks for nearly everything shows the limit.
        let asked_for_it = asked_m >= self.held_m.min(self.most_m()) * T::of(Self::DEMANDING);
        let falls_short = asked_for_it && flown_m < asked_m * T::of(Self::SHORT);
        if turned || gains || !falls_short {
            self.short = 0;
            self.best_m = T::zero();
            return;
        }
        self.short = self.short.saturating_add(1);
        self.best_m = self.best_m.max(flown_m);
        if self.short >= Self::PROOF {
            self.held_m = self.best_m;
        }
    }
}
