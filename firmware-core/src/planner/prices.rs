// SPDX-License-Identifier: MIT OR Apache-2.0
//! Prices of fairness: one multiplier `lambda_m` per user, added to its rate.
//!
//! At the right prices an unconstrained path serves every user as often as eq:a3 asks. They
//! minimise the dual value `max over paths sum max_m (R + lambda_m) - sum_m owed_m lambda_m` and
//! are found by subgradient steps in the manner of Polyak, whose target is a fraction below the
//! least dual value known, with a deflected direction (Camerini, Fratta and Maffioli, 1975).

use crate::scalar::Scalar;

/// The first fraction by which a target lies below the least dual value.
const FIRST_AMBITION: f64 = 0.05;
/// The number of steps without progress after which the fraction is halved.
const PATIENCE: u32 = 3;

/// The prices and the state of their improvement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prices<T, const M: usize> {
    /// The present prices, bit/s/Hz.
    pub(super) values: [T; M],
    /// The prices of the least dual value.
    best: [T; M],
    direction: [T; M],
    /// The least dual value; infinite before the first.
    pub(super) least_dual: T,
    ambition: T,
    fruitless: u32,
}

impl<T: Scalar, const M: usize> Prices<T, M> {
    pub(super) fn new() -> Self {
        Self {
            values: [T::zero(); M],
            best: [T::zero(); M],
            direction: [T::zero(); M],
            least_dual: T::of(f64::INFINITY),
            ambition: T::of(FIRST_AMBITION),
            fruitless: 0,
        }
    }

    /// Continues from the best prices, for a changed mission or state.
    pub(super) fn restart(&mut self) {
        let values = self.best;
        *self = Self {
            values,
            best: values,
            ..Self::new()
        };
    }

    /// Takes a step from the slots that each user has on the best path at the present prices, and
    /// the dual value there. `tight` states whether every slot is needed for a quota; then prices
    /// may be negative.
    pub(super) fn step(
        &mut self,
        counts: &[u32; M],
        least: &[u32; M],
        users: usize,
        dual: T,
        tight: bool,
    ) {
        if !dual.finite() {
            return;
        }
        let mut progress = true;
        if self.least_dual.finite() {
            let enough = self.ambition * T::of(0.1) * self.least_dual.abs();
            progress = dual < self.least_dual - enough;
        }
        self.fruitless = if progress { 0 } else { self.fruitless + 1 };
        if dual < self.least_dual {
            self.least_dual = dual;
            self.best = self.values;
        }
        if self.fruitless > PATIENCE {
            self.fruitless = 0;
            self.ambition *= T::of(0.5);
            self.values = self.best;
            self.direction = [T::zero(); M];
        }
        let (mut length, mut agreement) = (T::zero(), T::zero());
        let excess = |user: usize| {
            let of = |counts: &[u32; M]| T::count(counts.get(user).copied().unwrap_or(0) as usize);
            of(counts) - of(least)
        };
        for (user, direction) in self.direction.iter().enumerate().take(users) {
            length += *direction * *direction;
            agreement += *direction * excess(user);
        }
        let keep = if length > T::zero() {
            (-agreement * T::of(1.5) / length).max(T::zero())
        } else {
            T::zero()
        };
        let mut length = T::zero();
        for (user, direction) in self.direction.iter_mut().enumerate().take(users) {
            *direction = excess(user) + keep * *direction;
            length += *direction * *direction;
        }
        if length <= T::zero() {
            return;
        }
        let target = self.least_dual - self.ambition * self.least_dual.abs();
        let step = (dual - target) / length;
        let mut sum = T::zero();
        for (value, direction) in self.values.iter_mut().zip(&self.direction).take(users) {
            *value -= step * *direction;
            if !tight {
                *value = value.max(T::zero());
            }
            sum += *value;
        }
        if tight {
            // Adding the same price to all users changes nothing.
            let mean = sum / T::count(users.max(1));
            for value in self.values.iter_mut().take(users) {
                *value -= mean;
            }
        }
    }
}
