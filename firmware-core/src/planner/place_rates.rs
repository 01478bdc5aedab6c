// SPDX-License-Identifier: MIT OR Apache-2.0
//! The gains with which the planner evaluates rates ([`crate::place_rates`]).
//!
//! The channel's amplitude gains come from a table over the horizontal distance, because the
//! line-of-sight model costs an arc sine and two exponentials per node on the ground. Where the
//! table is not accurate (extreme altitudes, and the models of 3GPP, whose gain has a kink), the model itself is
//! evaluated. A mission with a map of gains uses the map.

use super::learned_gains::LearnedGains;
use crate::{
    channel::GroundNode,
    mission::{Mission, RadioModel},
    place_rates::{self, AmplitudeGains},
    scalar::{Position, Scalar},
};

/// The number of intervals of the gain table.
const INTERVALS: usize = 256;
/// The number of entries of the gain table: one more before and two more after the interpolated
/// range.
pub(super) const GAIN_ENTRIES: usize = INTERVALS + 4;
/// The largest relative error of the table, in the middle of an interval, at which it is used.
const TABLE_TOLERANCE: f64 = 2e-5;

/// The scale of the gain table. Entry `i` is for the horizontal distance `d` with
/// `d / (d + knee) = (i - 1) / INTERVALS * end`: fine nearby, coarse far away.
#[derive(Clone, Copy, Debug)]
pub(super) struct GainScale<T> {
    knee_m: T,
    /// Table intervals per unit of `d / (d + knee)`.
    intervals: T,
    /// Whether the table is accurate enough to be used.
    accurate: bool,
}

impl<T: Scalar> GainScale<T> {
    /// Creates the scale for all distances within a mission's area. The table must be
    /// [filled](Self::fill).
    pub(super) fn new<const M: usize, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let p = mission.parameters();
        let longest_m = p.area.east_m + p.area.north_m;
        let knee_m = p.altitude_m * T::of(4.0);
        let end = longest_m / (longest_m + knee_m);
        Self {
            knee_m,
            intervals: T::count(INTERVALS) / end,
            accurate: true,
        }
    }

    /// Writes entry `index` of the table and checks the interval that it completes. Entries are
    /// written in ascending order. Worst case: two evaluations of the channel model.
    pub(super) fn fill<const M: usize, const J: usize>(
        &mut self,
        mission: &Mission<T, M, J>,
        table: &mut [T],
        index: usize,
    ) {
        let Some(entry) = table.get_mut(index) else {
            return;
        };
        let amplitude = |x: T| {
            let distance_m = self.distance_m(x - T::one());
            mission.channel().power_gain_across(distance_m).amplitude()
        };
        *entry = amplitude(T::count(index));
        if index >= 4 {
            let middle = T::count(index - 2) - T::of(0.5);
            let exact = amplitude(middle);
            let distance_m = self.distance_m(middle - T::one());
            let error = (self.look_up(table, distance_m) - exact).abs();
            // This is false for NaN, too.
            self.accurate &= error <= exact * T::of(TABLE_TOLERANCE);
        }
    }

    /// Returns the distance at `x` intervals, not negative; the entries outside the range mirror or
    /// extend it.
    fn distance_m(&self, x: T) -> T {
        let u = (x / self.intervals).abs().min(T::of(0.999));
        self.knee_m * u / (T::one() - u)
    }

    /// Interpolates in the table with a cubic.
    fn look_up(&self, table: &[T], distance_m: T) -> T {
        let x = distance_m / (distance_m + self.knee_m) * self.intervals;
        let index = x.whole().min(INTERVALS - 1);
        let t = x - T::count(index);
        let Some(&[p0, p1, p2, p3]) = table.get(index..index + 4) else {
            return T::zero();
        };
        let (half, third, sixth) = (T::of(0.5), T::of(1.0 / 3.0), T::of(1.0 / 6.0));
        let c1 = p2 - p0 * third - p1 * half - p3 * sixth;
        let c2 = (p0 + p2) * half - p1;
        let c3 = (p3 - p0) * sixth + (p1 - p2) * half;
        (((c3 * t + c2) * t + c1) * t + p1).max(T::zero())
    }
}

/// The gains from the table, where it is accurate, with the biases that were learned in flight.
#[derive(Clone, Copy, Debug)]
pub(super) struct TableGains<'a, T, const M: usize, const J: usize> {
    pub(super) scale: &'a GainScale<T>,
    pub(super) learned: &'a LearnedGains<T, M, J>,
    pub(super) table: &'a [T],
}

impl<T: Scalar, const USERS: usize, const SENSORS: usize> AmplitudeGains<T>
    for TableGains<'_, T, USERS, SENSORS>
{
    fn amplitude<const M: usize, const J: usize>(
        &self,
        mission: &Mission<T, M, J>,
        place: &Position<T>,
        (node, ground): (GroundNode, &Position<T>),
    ) -> T {
        let learned = self.learned.factor(node);
        if mission.has_gain_map() {
            return learned * mission.power_gain(node, place).amplitude();
        }
        let distance_m = (place - ground).norm();
        let amplitude = if self.scale.accurate {
            self.scale.look_up(self.table, distance_m)
        } else {
            mission.channel().power_gain_across(distance_m).amplitude()
        };
        learned * amplitude
    }
}

/// The rates at a place, by the table.
pub(super) type PlaceRates<'a, T, const M: usize, const J: usize> =
    place_rates::PlaceRates<'a, T, TableGains<'a, T, M, J>, M, J>;

impl<T: Scalar, const M: usize, const J: usize> PlaceRates<'_, T, M, J> {
    /// Writes the rate of every user, bit/s/Hz, into `row`, which has one entry per user.
    pub(super) fn write(&mut self, place: &Position<T>, row: &mut [T]) {
        self.each(place, 0..row.len(), |user, rate| {
            if let Some(entry) = row.get_mut(user) {
                *entry = rate;
            }
        });
    }

    /// Returns the rate of one user, bit/s/Hz.
    pub(super) fn of_user(&mut self, place: &Position<T>, user: usize) -> T {
        let mut found = T::zero();
        self.each(place, core::iter::once(user), |_, rate| found = rate);
        found
    }
}

/// Returns the operations that one place costs, an estimate for the budget of work.
pub(super) fn operations_per_place<T: Scalar, const M: usize, const J: usize>(
    mission: &Mission<T, M, J>,
) -> u64 {
    let with_table = (60 * mission.sensor_count() + 100 * mission.user_count()) as u64;
    let by_table =
        mission.parameters().radio_model == RadioModel::ProbabilisticLos && !mission.has_gain_map();
    // The models of TR 36.777 have a kink, at which the table is not accurate.
    if by_table { with_table } else { 4 * with_table }
}
