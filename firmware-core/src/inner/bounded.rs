// SPDX-License-Identifier: MIT OR Apache-2.0
//! The slot problem with gains that are known within bounds only: a solution that is guaranteed for
//! all gains within the bounds (`docs/mathematics.md`, section 9).
//!
//! With amplitude gains `l_j <= h_j <= u_j` and `g_l <= g <= g_u`, the MSE is convex in every
//! `h_j` and so is largest at an end of each; it rises with `g`, and the rate falls with `h_j`
//! and rises with `g`:
//!
//! ```text
//! J^2 MSE <= sum_j max( 1 - eta b_j l_j,  eta b_j u_j - 1 )^2 + eta^2 (g_u^2 p + sigma^2)
//! R       >= log2( 1 + g_l^2 p / (sum_j b_j^2 u_j^2 + sigma^2) )
//! ```
//!
//! No sensor improves the MSE with `eta b_j > 2 / (l_j + u_j)`, where the errors at the two ends
//! are equal; below that the error at the lower end is the larger one. Two choices of `eta` and
//! levels are tried and the one with the better guarantee is kept: the optimum for the sensors'
//! lower bounds beside the user's upper bound, limited as above; and the `eta` of least worst-case
//! MSE. Then the user gets the power that `Gamma` allows. With bounds that coincide the first
//! choice is the optimum of [`exact`](super::exact).
//!
//! A sensor whose lower bound is 0 stays silent: in the worst case its whole symbol is missing,
//! whatever its coefficient.
//!
//! With error statistics the gains within the bounds are estimates, and what is guaranteed is the
//! expected MSE and an achievable rate. With effective amplitudes, which are `v_j / rho_j` times as
//! large, the error of a sensor is `1 - m_j` plus `m_j` times the square above, and its energy is
//! `m_j` times as large (section 10). A channel that is known exactly has the weight `m_j = 1`.
//!
//! Worst case: one exact slot, and `BISECTIONS` sums over the sensors.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::{
    LimitedBy, SlotError, SlotLimits, Solution, Status, UncertainWorkspace, Workspace,
    error::check_gains, rate::rate_of_sinr,
};
use crate::{
    scalar::Scalar,
    uncertainty::{SensorUncertainty, SlotUncertainty},
    units::{PowerGain, Watt},
};

/// The number of halvings of twelve decades in the search for the `eta` of least worst-case MSE.
/// The result is accurate far below single precision, and below the square root of double
/// precision, within which a minimum is flat.
const BISECTIONS: u32 = 40;

/// Lower and upper bound of a power gain, both included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GainBounds<T> {
    /// The lower bound.
    pub least: PowerGain<T>,
    /// The upper bound, not below the lower bound.
    pub most: PowerGain<T>,
}

impl<T: Scalar> GainBounds<T> {
    /// Creates the bounds of a gain that is known exactly.
    pub fn exactly(gain: PowerGain<T>) -> Self {
        Self {
            least: gain,
            most: gain,
        }
    }
}

/// A solution that holds for every gain within its bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guarantee<T> {
    /// [`Status::Guaranteed`], or [`Status::Infeasible`] where `Gamma` cannot be guaranteed and the
    /// user is silent.
    pub status: Status<T>,
    /// The worst-case rate, bit/s/Hz.
    pub rate: T,
    /// The worst-case MSE; with error statistics the worst case of its expectation.
    pub mse: T,
    /// `p` of the served user.
    pub user_power: Watt<T>,
    /// `eta`, one over square root of watts.
    pub normalizing_factor: T,
    choice: Choice<T>,
    noise_amplitude: T,
}

impl<T: Scalar> Guarantee<T> {
    /// Returns `|b_j|` of a sensor, square root of watts; at most `sqrt(p_b^max)`, exactly.
    pub fn coefficient(&self, gain: &GainBounds<T>) -> T {
        self.choice
            .coefficient(&Ends::of(gain, self.noise_amplitude))
    }

    /// As [`coefficient`](Self::coefficient), of a sensor with error statistics.
    pub fn uncertain_coefficient(&self, gain: &GainBounds<T>, sensor: &SensorUncertainty<T>) -> T {
        self.choice
            .coefficient(&Ends::of(gain, self.noise_amplitude).under(sensor))
    }
}

/// The effective amplitude gains of a link at both ends of its bounds, divided by the noise
/// amplitude: one over square root of watts.
#[derive(Clone, Copy, Debug)]
struct Ends<T> {
    low: T,
    high: T,
    /// `m_j`.
    weight: T,
}

impl<T: Scalar> Ends<T> {
    fn of(gain: &GainBounds<T>, noise_amplitude: T) -> Self {
        Self {
            low: gain.least.amplitude() / noise_amplitude,
            high: gain.most.amplitude() / noise_amplitude,
            weight: T::one(),
        }
    }

    /// Returns the ends for a channel with these error statistics.
    fn under(self, sensor: &SensorUncertainty<T>) -> Self {
        Self {
            low: sensor.effective_amplitude(self.low),
            high: sensor.effective_amplitude(self.high),
            weight: sensor.weight(),
        }
    }
}

/// The two numbers from which the amplitudes of all sensors follow.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Choice<T> {
    /// `eta sigma`.
    eta: T,
    /// The noise-normalized amplitude to which strong sensors reduce their power.
    level: T,
    coefficient_max: T,
}

/// The worst-case error and energy of a choice.
#[derive(Clone, Copy, Debug)]
struct Worst<T> {
    /// `J^2` times the part of the MSE that the user does not cause.
    error: T,
    /// `E`, noise-normalized.
    energy: T,
}

impl<T: Scalar> Choice<T> {
    fn coefficient(&self, ends: &Ends<T>) -> T {
        if ends.low <= T::zero() || self.eta <= T::zero() {
            return T::zero();
        }
        let even = T::of(2.0) / (self.eta * (ends.low + ends.high));
        (self.level / ends.low).min(even).min(self.coefficient_max)
    }

    fn worst(&self, sensors: &[Ends<T>]) -> Worst<T> {
        let noise = T::one();
        let mut worst = Worst {
            error: self.eta * self.eta,
            energy: noise,
        };
        for ends in sensors {
            let b = self.coefficient(ends);
            let short = T::one() - self.eta * b * ends.low;
            let over = self.eta * b * ends.high - T::one();
            let error = short.max(over);
            worst.error += T::one() - ends.weight + ends.weight * error * error;
            worst.energy += ends.weight * b * ends.high * b * ends.high;
        }
        worst
    }

    /// Returns the choice with the least worst-case error: where the derivative by `eta`, `eta -
    /// sum a_j (1 - eta a_j)` over the sensors at full power, changes sign.
    fn quietest(sensors: &[Ends<T>], coefficient_max: T) -> Self {
        let two = T::of(2.0);
        // From this eta on a sensor inverts its channel.
        let even = |ends: &Ends<T>| two / (coefficient_max * (ends.low + ends.high));
        let heard = || sensors.iter().filter(|ends| ends.low > T::zero());
        let mut high = heard().fold(T::zero(), |most, ends| most.max(even(ends)));
        let mut low = high * T::of(1e-12);
        // If no sensor is heard the range is empty: `eta` is 0.
        let halvings = if low > T::zero() { BISECTIONS } else { 0 };
        for _ in 0..halvings {
            // The geometric mean, without leaving the range of the number type.
            let eta = low * (high / low).sqrt();
            let slope = heard().fold(eta, |sum, ends| {
                let a = coefficient_max * ends.low;
                if eta < even(ends) {
                    sum - ends.weight * a * (T::one() - eta * a)
                } else {
                    sum
                }
            });
            if slope < T::zero() {
                low = eta;
            } else {
                high = eta;
            }
        }
        Self {
            eta: high,
            level: T::max_value().unwrap_or(high),
            coefficient_max,
        }
    }
}

impl<T: Scalar, const J: usize> Workspace<T, J> {
    /// Returns the solution for gains within bounds, with `user` served, or nobody (`None`).
    ///
    /// # Errors
    /// Returns an error if a bound is NaN, infinite or negative, if the limits are not those of a
    /// slot problem, or if there are too many sensors.
    pub fn guarantee(
        &mut self,
        limits: &SlotLimits<T>,
        sensors: &[GainBounds<T>],
        user: Option<GainBounds<T>>,
    ) -> Result<Guarantee<T>, SlotError<T>> {
        let bounds = Bounds::<T, J>::of(limits, sensors, user)?;
        let user = bounds.user;
        let for_low_ends = self
            .sensors(limits, &bounds.least)?
            .solve(Some(user.most))?;
        Ok(bounds.guarantee(limits, &for_low_ends, T::zero()))
    }
}

impl<T: Scalar, const J: usize> UncertainWorkspace<T, J> {
    /// Returns the solution for estimates within bounds and errors with these statistics, with `user`
    /// served, or nobody (`None`). The coefficients are those of
    /// [`Guarantee::uncertain_coefficient`].
    ///
    /// # Errors
    /// As [`Workspace::guarantee`], and if there are not as many statistics as sensors.
    pub fn guarantee(
        &mut self,
        limits: &SlotLimits<T>,
        sensors: &[GainBounds<T>],
        user: Option<GainBounds<T>>,
        uncertainty: &SlotUncertainty<'_, T>,
    ) -> Result<Guarantee<T>, SlotError<T>> {
        let mut bounds = Bounds::<T, J>::of(limits, sensors, user)?;
        let user = bounds.user;
        let for_low_ends = self
            .sensors(limits, &bounds.least, uncertainty)?
            .solve(Some(user.most))?;
        for (ends, sensor) in bounds.ends.iter_mut().zip(uncertainty.sensors()) {
            *ends = ends.under(sensor);
        }
        Ok(bounds.guarantee(limits, &for_low_ends, uncertainty.user_error_variance()))
    }
}

/// The checked bounds of a slot.
struct Bounds<T, const J: usize> {
    least: Vec<PowerGain<T>, J>,
    ends: Vec<Ends<T>, J>,
    user: GainBounds<T>,
    noise_amplitude: T,
}

impl<T: Scalar, const J: usize> Bounds<T, J> {
    fn of(
        limits: &SlotLimits<T>,
        sensors: &[GainBounds<T>],
        user: Option<GainBounds<T>>,
    ) -> Result<Self, SlotError<T>> {
        let too_many = SlotError::TooManySensors {
            sensors: sensors.len(),
            capacity: J,
        };
        let noise_amplitude = limits.noise_power.0.sqrt();
        let (mut least, mut ends) = (Vec::<_, J>::new(), Vec::<_, J>::new());
        for gain in sensors {
            least.push(gain.least).map_err(|_| too_many)?;
            let gain_ends = Ends::of(gain, noise_amplitude);
            ends.push(gain_ends).map_err(|_| too_many)?;
        }
        check_gains(sensors.iter().map(|gain| gain.most))?;
        let user = user.unwrap_or_default();
        SlotError::check_user(Some(user.least))?;
        Ok(Self {
            least,
            ends,
            user,
            noise_amplitude,
        })
    }

    /// Returns the better guarantee of the two choices; `for_low_ends` is the optimum for the sensors'
    /// lower bounds.
    fn guarantee(
        &self,
        limits: &SlotLimits<T>,
        for_low_ends: &Solution<T>,
        user_error_variance: T,
    ) -> Guarantee<T> {
        let Self {
            ends,
            user,
            noise_amplitude,
            ..
        } = self;
        let noise_amplitude = *noise_amplitude;
        let coefficient_max = limits.coefficient_max();
        let quietest = Choice::quietest(ends, coefficient_max);
        let leveled = Choice {
            eta: for_low_ends.normalizing_factor * noise_amplitude,
            level: for_low_ends.level / noise_amplitude,
            coefficient_max,
        };
        let promise = |choice| {
            let user = (user, user_error_variance);
            promise(limits, ends, user, noise_amplitude, choice)
        };
        let (a, b) = (promise(leveled), promise(quietest));
        let a_is_better = a.status.is_feasible() && (a.rate > b.rate || !b.status.is_feasible());
        if a_is_better { a } else { b }
    }
}

/// Returns the guarantee of a choice, with the power that it leaves to the user.
fn promise<T: Scalar>(
    limits: &SlotLimits<T>,
    sensors: &[Ends<T>],
    (user, user_error_variance): (&GainBounds<T>, T),
    noise_amplitude: T,
    choice: Choice<T>,
) -> Guarantee<T> {
    let count = T::count(sensors.len());
    let worst = choice.worst(sensors);
    let eta_squared = choice.eta * choice.eta;
    let room = count * count * limits.aim(sensors.len()).mse_threshold - worst.error;
    let mut guarantee = Guarantee {
        status: Status::Guaranteed {
            limited_by: LimitedBy::None,
        },
        rate: T::zero(),
        mse: worst.error / (count * count),
        user_power: Watt(T::zero()),
        normalizing_factor: choice.eta / noise_amplitude,
        choice,
        noise_amplitude,
    };
    if guarantee.mse > limits.mse_threshold {
        let missing = sensors.iter().map(|ends| T::one() - ends.weight);
        let floor = missing.fold(T::zero(), |sum, one| sum + one) / (count * count);
        guarantee.status = Status::infeasible(guarantee.mse, floor, limits);
        return guarantee;
    }
    let power_max = limits.user_power_max.0;
    if user.most.0 <= T::zero() || power_max <= T::zero() {
        return guarantee;
    }
    // The result is infinite or NaN where `eta` is 0: no sensor is heard then, and no user power is
    // possible.
    let user_excess = T::one() + user_error_variance;
    let affordable =
        (room / (eta_squared * user_excess)).max(T::zero()) * (limits.noise_power.0 / user.most.0);
    let (power, limited_by) = if affordable < power_max {
        (affordable, LimitedBy::Accuracy)
    } else {
        (power_max, LimitedBy::Power)
    };
    let signal = |gain: PowerGain<T>| power * (gain.0 / limits.noise_power.0);
    let known = signal(user.least);
    let rate = rate_of_sinr(known / (worst.energy + user_error_variance * known));
    let mse = (worst.error + eta_squared * user_excess * signal(user.most)) / (count * count);
    // With gains at the end of the number type nothing can be guaranteed for the user.
    if rate.finite() && mse.finite() {
        guarantee.status = Status::Guaranteed { limited_by };
        guarantee.user_power = Watt(power);
        guarantee.rate = rate;
        guarantee.mse = mse;
    }
    guarantee
}
