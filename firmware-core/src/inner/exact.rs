//! The global optimum of the slot problem in closed form (`docs/mathematics.md`, section 2).
//!
//! In noise-normalised units, `a_j = sqrt(p_b^max) |h_j| / sigma`, `q = p |g|^2 / sigma^2` and
//! `Q = p^max |g|^2 / sigma^2`, the best amplitudes are `y_j = min(c, a_j)` for one *level* `c`:
//! strong sensors turn down to it, weak ones give all they have. With
//!
//! ```text
//! A(c) = sum_j min(c, a_j)      E(c) = 1 + sum_j min(c, a_j)^2      f(c) = A^2 / E
//! ```
//!
//! `f` is unimodal with its top at the *peak level* `c*`, where `E = c A`. The slot is feasible
//! iff `f(c*) >= kappa`, and then either **accuracy** limits it (`c = c*`) or **power** does
//! (`q = Q`, and `c` is the root below `c*` of `A^2 = kappa (Q + E)`: between two neighbouring
//! `a_j` a quadratic).
//!
//! [`SensorField`] sorts the sensors once and finds the peak; each user then costs a binary
//! search. Worst case: `O(J log J)` to sort, `O(J)` for the sums, `O(log J)` per user; no
//! iteration to a tolerance, no allocation.

use super::{LimitedBy, SlotError, SlotLimits, Status, check_gains};
use crate::{
    scalar::Scalar,
    units::{PowerGain, Watt},
};

/// Room for the sorted amplitudes of up to `J` sensors and their running sums.
#[derive(Clone, Debug)]
pub struct Workspace<T, const J: usize> {
    amplitude: [T; J],
    sums: [PrefixSum<T>; J],
}

impl<T: Scalar, const J: usize> Default for Workspace<T, J> {
    fn default() -> Self {
        Self {
            amplitude: [T::zero(); J],
            sums: [PrefixSum::default(); J],
        }
    }
}

impl<T: Scalar, const J: usize> Workspace<T, J> {
    /// Takes in the sensors of a slot: see [`SensorField::new`].
    ///
    /// # Errors
    /// As [`SensorField::new`].
    pub fn sensors(
        &mut self,
        limits: &SlotLimits<T>,
        sensor_gains: &[PowerGain<T>],
    ) -> Result<SensorField<'_, T>, SlotError<T>> {
        SensorField::new(limits, sensor_gains, &mut self.amplitude, &mut self.sums)
    }
}

/// Sums over the sensors below a place in the sorted order.
#[derive(Clone, Copy, Debug, Default)]
pub struct PrefixSum<T> {
    amplitude: T,
    energy: T,
}

/// A level with the sums `A` and `E` at it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Level<T> {
    c: T,
    sum: T,
    energy: T,
}

impl<T: Scalar> Level<T> {
    /// `f = A^2 / E`, formed so that nothing overflows or vanishes in single precision.
    fn efficiency(&self) -> T {
        self.sum * (self.sum / self.energy)
    }
}

/// The sensors of one slot at one position, sorted, with the peak level found: everything that
/// does not depend on the user.
#[derive(Clone, Debug)]
pub struct SensorField<'w, T> {
    /// `a_j`, ascending.
    amplitude: &'w [T],
    /// `sums[k]`: over the `k` weakest sensors.
    sums: &'w [PrefixSum<T>],
    peak: Level<T>,
    kappa: T,
    limits: SlotLimits<T>,
    /// `sigma`, square root of watts.
    noise_amplitude: T,
    /// The largest coefficient whose square does not exceed `p_b^max`.
    coefficient_max: T,
}

/// The solution of a slot. The coefficients follow from the level:
/// [`coefficient`](Self::coefficient).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution<T> {
    /// How the slot came out.
    pub status: Status<T>,
    /// `R`, bit/s/Hz.
    pub rate: T,
    /// `p` of the served user.
    pub user_power: Watt<T>,
    /// `eta` (eq:eta_), one over square root of watts.
    pub normalizing_factor: T,
    /// The amplitude at which sensors arrive that can, square root of watts.
    level: T,
    coefficient_max: T,
}

impl<T: Scalar> Solution<T> {
    /// `|b_j|` of a sensor with gain `|h_j|^2`, square root of watts; at most
    /// `sqrt(p_b^max)`, exactly. A sensor that cannot be heard stays silent.
    pub fn coefficient(&self, gain: PowerGain<T>) -> T {
        let amplitude = gain.amplitude();
        if amplitude <= T::zero() {
            return T::zero();
        }
        (self.level / amplitude).min(self.coefficient_max)
    }
}

impl<'w, T: Scalar> SensorField<'w, T> {
    /// Sorts the sensors into the caller's room and finds the peak. `amplitude` and `sums`
    /// must hold at least as many entries as there are sensors.
    ///
    /// # Errors
    /// A gain that is NaN, infinite or negative, limits that make no problem (`Gamma >= 1/J`
    /// among them), too little room.
    pub fn new(
        limits: &SlotLimits<T>,
        sensor_gains: &[PowerGain<T>],
        amplitude: &'w mut [T],
        sums: &'w mut [PrefixSum<T>],
    ) -> Result<Self, SlotError<T>> {
        let sensors = sensor_gains.len();
        limits.check(sensors)?;
        check_gains(sensor_gains)?;
        let capacity = amplitude.len().min(sums.len());
        if sensors > capacity {
            return Err(SlotError::TooManySensors { sensors, capacity });
        }
        let noise_amplitude = limits.noise_power.0.sqrt();
        let coefficient_max = limits.coefficient_max();
        let scale = coefficient_max / noise_amplitude;
        let amplitude = &mut amplitude[..sensors];
        for (a, gain) in amplitude.iter_mut().zip(sensor_gains) {
            *a = scale * gain.amplitude();
        }
        amplitude.sort_unstable_by(T::order);
        let sums = &mut sums[..sensors];
        let mut running = PrefixSum::default();
        for (sum, &a) in sums.iter_mut().zip(amplitude.iter()) {
            *sum = running;
            running.amplitude += a;
            running.energy += a * a;
        }
        let mut field = Self {
            amplitude,
            sums,
            peak: Level {
                c: T::zero(),
                sum: T::zero(),
                energy: T::one(),
            },
            kappa: limits.kappa(sensors),
            limits: *limits,
            noise_amplitude,
            coefficient_max,
        };
        field.peak = field.find_peak();
        Ok(field)
    }

    /// How many sensors there are.
    pub fn sensor_count(&self) -> usize {
        self.amplitude.len()
    }

    /// Whether `Gamma` can be met at all here: `f(c*) >= kappa`.
    pub fn is_feasible(&self) -> bool {
        self.peak.efficiency() >= self.kappa
    }

    /// The least MSE that these channels allow with the user silent: `(J - f(c*)) / J^2`.
    pub fn least_mse(&self) -> T {
        let sensors = T::count(self.sensor_count());
        (sensors - self.peak.efficiency()) / (sensors * sensors)
    }

    /// The optimal slot with a user of gain `|g|^2` served, or (`None`) with nobody.
    ///
    /// Where there is no rate to be had, the least MSE is chosen.
    ///
    /// # Errors
    /// A gain that is NaN, infinite or negative.
    pub fn solve(&self, user: Option<PowerGain<T>>) -> Result<Solution<T>, SlotError<T>> {
        let gain = match user {
            Some(gain) if !gain.is_valid() => {
                return Err(SlotError::UserGain { value: gain.0 });
            }
            Some(gain) => gain,
            None => PowerGain(T::zero()),
        };
        let budget = self.normalized_budget(gain);
        let (status, level, signal) = self.operating_point(budget);
        // Back to watts: p = q sigma^2 / |g|^2, never above p^max. At q = Q it is p^max.
        let user_power = if signal >= budget {
            if budget > T::zero() {
                self.limits.user_power_max.0
            } else {
                T::zero()
            }
        } else {
            (signal / budget * self.limits.user_power_max.0).min(self.limits.user_power_max.0)
        };
        Ok(Solution {
            status,
            rate: rate(signal / level.energy),
            user_power: Watt(user_power),
            normalizing_factor: level.sum / ((signal + level.energy) * self.noise_amplitude),
            level: level.c * self.noise_amplitude,
            coefficient_max: self.coefficient_max,
        })
    }

    /// The rate alone, bit/s/Hz: what `solve` would report; 0 where infeasible or where the
    /// gain is not one. The cheap question "how good is this user here?".
    pub fn rate(&self, user: PowerGain<T>) -> T {
        if !user.is_valid() {
            return T::zero();
        }
        let (_, level, signal) = self.operating_point(self.normalized_budget(user));
        rate(signal / level.energy)
    }

    /// `Q = p^max |g|^2 / sigma^2`.
    fn normalized_budget(&self, user: PowerGain<T>) -> T {
        let budget = self.limits.user_power_max.0 * (user.0 / self.limits.noise_power.0);
        if budget.finite() { budget } else { T::zero() }
    }

    /// Level and user signal `q` of the optimum for a budget `Q`.
    fn operating_point(&self, budget: T) -> (Status<T>, Level<T>, T) {
        let optimal = |limited_by| Status::Optimal { limited_by };
        if !self.is_feasible() {
            let least_mse = self.least_mse();
            return (Status::Infeasible { least_mse }, self.peak, T::zero());
        }
        if budget <= T::zero() {
            return (optimal(LimitedBy::None), self.peak, T::zero());
        }
        let headroom = self.peak.efficiency() / self.kappa - T::one();
        let affordable = headroom * self.peak.energy;
        if affordable <= budget {
            return (optimal(LimitedBy::Accuracy), self.peak, affordable);
        }
        let level = self.power_limited_level(budget);
        (optimal(LimitedBy::Power), level, budget)
    }

    /// `A` and `E` at level `c`, which lies in segment `k`: above the `k` weakest sensors.
    fn level_in_segment(&self, k: usize, c: T) -> Level<T> {
        let strong = T::count(self.sensor_count() - k);
        let below = self.sums[k];
        Level {
            c,
            sum: below.amplitude + strong * c,
            energy: T::one() + below.energy + strong * c * c,
        }
    }

    /// `c*`: the level where `E - c A` reaches 0, or the strongest amplitude where it never
    /// does. In segment `k` the quadratic terms cancel: `E - c A = 1 + energy_k - c amplitude_k`.
    fn find_peak(&self) -> Level<T> {
        let past_peak = |k: usize| {
            let below = self.sums[k];
            T::one() + below.energy <= self.amplitude[k] * below.amplitude
        };
        // E - c A falls along the sensors: the first whose amplitude lies past the peak ends
        // the segment that holds it.
        let k = partition_point(self.sensor_count(), |k| !past_peak(k));
        if k == self.sensor_count() {
            let last = self.sensor_count() - 1;
            return self.level_in_segment(last, self.amplitude[last]);
        }
        let below = self.sums[k];
        let c = (T::one() + below.energy) / below.amplitude;
        self.level_in_segment(k, c.min(self.amplitude[k]))
    }

    /// The root below `c*` of `D(c) = A(c)^2 - kappa (Q + E(c))`, which the caller knows to be
    /// positive at `c*`. Wherever `f >= kappa`, `D` rises, and below that it is negative: it
    /// changes sign once.
    fn power_limited_level(&self, budget: T) -> Level<T> {
        let reaches = |k: usize| {
            let c = self.amplitude[k];
            if c >= self.peak.c {
                return true;
            }
            let level = self.level_in_segment(k, c);
            level.sum * level.sum >= self.kappa * (budget + level.energy)
        };
        let k = partition_point(self.sensor_count(), |k| !reaches(k)).min(self.sensor_count() - 1);
        // In segment k: (r^2 - kappa r) c^2 + 2 r P c + (P^2 - kappa (Q + 1 + W)) = 0 with
        // r sensors at the level. The root where D rises is (-b + sqrt(disc)) / 2a, in the form
        // that does not cancel.
        let strong = T::count(self.sensor_count() - k);
        let below = self.sums[k];
        let quadratic = strong * (strong - self.kappa);
        let half_linear = strong * below.amplitude;
        let missing =
            self.kappa * (budget + T::one() + below.energy) - below.amplitude * below.amplitude;
        let discriminant = half_linear * half_linear + quadratic * missing;
        let root = missing / (half_linear + discriminant.max(T::zero()).sqrt());
        let lower = if k == 0 {
            T::zero()
        } else {
            self.amplitude[k - 1]
        };
        let upper = self.amplitude[k].min(self.peak.c);
        self.level_in_segment(k, root.max(lower).min(upper))
    }
}

/// `log2(1 + sinr)`, accurate for small `sinr` too.
fn rate<T: Scalar>(sinr: T) -> T {
    sinr.ln_1p() * T::of(core::f64::consts::LOG2_E)
}

/// The first index in `0..n` for which `before` is false, `n` if there is none; `before` must
/// be true up to it and false from it on.
fn partition_point(n: usize, before: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, n);
    while low < high {
        let middle = low + (high - low) / 2;
        if before(middle) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    low
}
