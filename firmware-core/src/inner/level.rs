// SPDX-License-Identifier: MIT OR Apache-2.0
//! Sensors sorted by strength, and the one-parameter family of amplitudes that contains the
//! solutions of the slot problem (`docs/mathematics.md`, section 3).
//!
//! In noise-normalized units, `a_j = sqrt(p_b^max) |h_j| / sigma`, the best amplitudes are `y_j =
//! min(c, a_j)` for one *level* `c`: strong sensors reduce their amplitude to it, weak ones
//! transmit with full power. With the `a_j` sorted and summed once,
//!
//! ```text
//! A(c) = sum_j min(c, a_j)      E(c) = 1 + sum_j min(c, a_j)^2      f(c) = A^2 / E
//! ```
//!
//! cost a lookup of two running sums, and between two neighbouring `a_j` they are polynomials. `f`
//! is unimodal; its maximum is at the *peak level* `c*`, where `E = c A`.
//!
//! Where channels are not known exactly, sensor `j` has the effective amplitude `t_j = a_j v_j /
//! rho_j` and counts for its weight `m_j = rho_j^2 / v_j` instead of 1, with `v_j = 1 + eps_j`; a
//! user signal `q` counts for `(1 + eps_g) q` (`docs/mathematics.md`, section 10):
//!
//! ```text
//! A(c) = sum_j m_j min(c, t_j)      E(c) = 1 + sum_j m_j min(c, t_j)^2
//! ```
//!
//! Worst case: `O(J log J)` to sort, `O(J)` for the sums, `O(log J)` for the peak.

use super::{
    error::{SlotError, check_gains},
    limits::SlotLimits,
    prefix_sum::PrefixSum,
    sort::sort,
    weighted::{Sorted, SortedSensors, WeightedAmplitude},
};
use crate::{scalar::Scalar, uncertainty::SlotUncertainty, units::PowerGain};

/// Memory for the sorted amplitudes of up to `J` sensors and their running sums.
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
    /// Sorts the sensors of a slot into this workspace: see [`SensorField::new`].
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

    /// As [`sensors`](Self::sensors), from `|h_j|`, for a caller that needs the square roots again
    /// and a processor on which they are expensive.
    ///
    /// # Errors
    /// As [`SensorField::new`].
    pub fn sensors_of_amplitude(
        &mut self,
        limits: &SlotLimits<T>,
        amplitude_gains: &[T],
    ) -> Result<SensorField<'_, T>, SlotError<T>> {
        limits.check(amplitude_gains.len())?;
        // An amplitude is a valid gain exactly where its power is.
        check_gains(amplitude_gains.iter().copied().map(PowerGain))?;
        let room = (&mut self.amplitude[..], &mut self.sums[..]);
        SensorField::sorted(limits, amplitude_gains.iter().copied(), room)
    }
}

/// Memory for a slot whose channels are not known exactly: that of a [`Workspace`], and the weights.
#[derive(Clone, Debug)]
pub struct UncertainWorkspace<T, const J: usize> {
    workspace: Workspace<T, J>,
    weighted: [WeightedAmplitude<T>; J],
}

impl<T: Scalar, const J: usize> Default for UncertainWorkspace<T, J> {
    fn default() -> Self {
        Self {
            workspace: Workspace::default(),
            weighted: [WeightedAmplitude::default(); J],
        }
    }
}

impl<T: Scalar, const J: usize> UncertainWorkspace<T, J> {
    /// Returns the part that a slot with exactly known channels needs.
    pub fn exactly_known(&mut self) -> &mut Workspace<T, J> {
        &mut self.workspace
    }

    /// Sorts the sensors of a slot into this workspace: see [`SensorField::with_uncertainty`].
    ///
    /// # Errors
    /// As [`SensorField::with_uncertainty`].
    pub fn sensors<'w>(
        &'w mut self,
        limits: &SlotLimits<T>,
        sensor_gains: &[PowerGain<T>],
        uncertainty: &'w SlotUncertainty<'w, T>,
    ) -> Result<SensorField<'w, T>, SlotError<T>> {
        let memory = (&mut self.weighted[..], &mut self.workspace.sums[..]);
        SensorField::with_uncertainty(limits, sensor_gains, uncertainty, memory)
    }

    /// As [`sensors`](Self::sensors), from the estimated `|h_j|`, for a caller that needs the square
    /// roots again.
    ///
    /// # Errors
    /// As [`SensorField::with_uncertainty`].
    pub fn sensors_of_amplitude<'w>(
        &'w mut self,
        limits: &SlotLimits<T>,
        amplitude_gains: &[T],
        uncertainty: &'w SlotUncertainty<'w, T>,
    ) -> Result<SensorField<'w, T>, SlotError<T>> {
        limits.check(amplitude_gains.len())?;
        check_gains(amplitude_gains.iter().copied().map(PowerGain))?;
        let memory = (&mut self.weighted[..], &mut self.workspace.sums[..]);
        let amplitude_gains = amplitude_gains.iter().copied();
        SensorField::weighted(limits, amplitude_gains, uncertainty, memory)
    }
}

/// A level with the sums `A` and `E` at it, noise-normalized.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level<T> {
    /// `c`.
    pub(super) c: T,
    /// `A(c)`.
    pub(super) sum: T,
    /// `E(c)`, the noise's 1 included.
    pub(super) energy: T,
}

impl<T: Scalar> Level<T> {
    /// Returns `f = A^2 / E`, computed so that nothing overflows or underflows in single precision.
    pub(super) fn efficiency(&self) -> T {
        self.sum * (self.sum / self.energy)
    }
}

/// The levels between two neighbouring amplitudes, where the same sensors reduce their power.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment<T> {
    /// The number of sensors at the level, `J - k`; where they have weights, the sum of these.
    pub(super) strong: T,
    /// The sums over the `k` sensors below it, which transmit with full power.
    pub(super) below: PrefixSum<T>,
}

impl<T: Scalar> Segment<T> {
    /// Returns `A` and `E` at a level `c` of this segment.
    pub(super) fn level(&self, c: T) -> Level<T> {
        let Self { strong, below } = *self;
        Level {
            c,
            sum: below.amplitude + strong * c,
            energy: T::one() + below.energy + strong * c * c,
        }
    }
}

/// The sensors of one slot at one position, sorted, with the peak level: everything that does not
/// depend on the user.
#[derive(Clone, Debug)]
pub struct SensorField<'w, T> {
    pub(super) sorted: Sorted<'w, T>,
    /// `sums[k]`: the sums over the `k` weakest sensors.
    pub(super) sums: &'w [PrefixSum<T>],
    pub(super) peak: Level<T>,
    /// `kappa` of the threshold that solutions aim at: see [`SlotLimits::aim`].
    pub(super) kappa: T,
    pub(super) limits: SlotLimits<T>,
    /// `sigma`, square root of watts.
    pub(super) noise_amplitude: T,
    /// The largest coefficient whose square does not exceed `p_b^max`.
    pub(super) coefficient_max: T,
}

impl<'w, T: Scalar> SensorField<'w, T> {
    /// Sorts the sensors into the caller's buffers and finds the peak. `amplitude` and `sums` must
    /// hold at least as many entries as there are sensors.
    ///
    /// # Errors
    /// Returns an error if a gain is NaN, infinite or negative, if the limits are not those of a
    /// slot problem (for example `Gamma >= 1/J`), or if the buffers are too small.
    pub fn new(
        limits: &SlotLimits<T>,
        sensor_gains: &[PowerGain<T>],
        amplitude: &'w mut [T],
        sums: &'w mut [PrefixSum<T>],
    ) -> Result<Self, SlotError<T>> {
        limits.check(sensor_gains.len())?;
        check_gains(sensor_gains.iter().copied())?;
        let amplitude_gains = sensor_gains.iter().map(|gain| gain.amplitude());
        Self::sorted(limits, amplitude_gains, (amplitude, sums))
    }

    /// Creates the field of checked limits and gains `|h_j|`.
    fn sorted(
        limits: &SlotLimits<T>,
        amplitude_gains: impl ExactSizeIterator<Item = T>,
        (amplitude, sums): (&'w mut [T], &'w mut [PrefixSum<T>]),
    ) -> Result<Self, SlotError<T>> {
        let sensors = amplitude_gains.len();
        let capacity = amplitude.len().min(sums.len());
        if sensors > capacity {
            return Err(SlotError::TooManySensors { sensors, capacity });
        }
        let amplitude = &mut amplitude[..sensors];
        let mut field = Self::unsorted(limits, sensors);
        let normalized = field.normalization();
        for (a, gain) in amplitude.iter_mut().zip(amplitude_gains) {
            *a = normalized(gain);
        }
        let sums = &mut sums[..sensors];
        sort(amplitude, sums);
        let mut running = PrefixSum::default();
        for (sum, &a) in sums.iter_mut().zip(amplitude.iter()) {
            *sum = running;
            running.amplitude += a;
            running.energy += a * a;
        }
        let amplitude = &*amplitude;
        field.sorted = Sorted::Known(amplitude);
        field.sums = sums;
        field.peak = field.find_peak(amplitude);
        Ok(field)
    }

    /// Sorts sensors whose channels are not known exactly: the gains are estimates, and
    /// `uncertainty` has one entry per gain. The memory must have at least as many entries as there
    /// are sensors. With statistics that are all zero the field has the same bits as that of
    /// [`new`](Self::new).
    ///
    /// # Errors
    /// As [`new`](Self::new), and if there are not as many statistics as gains.
    pub fn with_uncertainty(
        limits: &SlotLimits<T>,
        sensor_gains: &[PowerGain<T>],
        uncertainty: &'w SlotUncertainty<'w, T>,
        memory: (&'w mut [WeightedAmplitude<T>], &'w mut [PrefixSum<T>]),
    ) -> Result<Self, SlotError<T>> {
        limits.check(sensor_gains.len())?;
        check_gains(sensor_gains.iter().copied())?;
        let amplitude_gains = sensor_gains.iter().map(|gain| gain.amplitude());
        Self::weighted(limits, amplitude_gains, uncertainty, memory)
    }

    /// Creates the weighted field of checked limits and gains `|h_j|`.
    fn weighted(
        limits: &SlotLimits<T>,
        amplitude_gains: impl ExactSizeIterator<Item = T>,
        uncertainty: &'w SlotUncertainty<'w, T>,
        (weighted, sums): (&'w mut [WeightedAmplitude<T>], &'w mut [PrefixSum<T>]),
    ) -> Result<Self, SlotError<T>> {
        let sensors = amplitude_gains.len();
        let capacity = weighted.len().min(sums.len());
        if sensors > capacity {
            return Err(SlotError::TooManySensors { sensors, capacity });
        }
        let statistics = uncertainty.sensors();
        if statistics.len() != sensors {
            let statistics = statistics.len();
            return Err(SlotError::UncertaintyCount {
                statistics,
                sensors,
            });
        }
        let weighted = &mut weighted[..sensors];
        let sums = &mut sums[..sensors];
        let mut field = Self::unsorted(limits, sensors);
        let normalized = field.normalization();
        let known = amplitude_gains.zip(statistics);
        for (entry, (gain, sensor)) in weighted.iter_mut().zip(known) {
            entry.amplitude = normalized(sensor.effective_amplitude(gain));
            entry.weight = sensor.weight();
        }
        sort(weighted, sums);
        let mut running = PrefixSum::default();
        for (sum, &WeightedAmplitude { amplitude, weight }) in sums.iter_mut().zip(&*weighted) {
            *sum = running;
            let counted = weight * amplitude;
            running.amplitude += counted;
            running.energy += counted * amplitude;
        }
        // From the strongest on: a difference from the sum over all would cancel.
        let mut strong = T::zero();
        for entry in weighted.iter_mut().rev() {
            strong += entry.weight;
            entry.weight = strong;
        }
        let weighted = &*weighted;
        field.sorted = Sorted::Weighted(weighted, uncertainty);
        field.sums = sums;
        field.peak = field.find_peak(weighted);
        Ok(field)
    }

    /// Returns a field without sensors, of a slot of checked limits with `sensors` sensors.
    fn unsorted(limits: &SlotLimits<T>, sensors: usize) -> Self {
        Self {
            sorted: Sorted::Known(&[]),
            sums: &[],
            peak: Level {
                c: T::zero(),
                sum: T::zero(),
                energy: T::one(),
            },
            kappa: limits.aim(sensors).kappa(sensors),
            limits: *limits,
            noise_amplitude: limits.noise_power.0.sqrt(),
            coefficient_max: limits.coefficient_max(),
        }
    }

    /// Returns the function from an amplitude gain to the noise-normalized amplitude that arrives over
    /// it at full power.
    fn normalization(&self) -> impl Fn(T) -> T + use<T> {
        // Beside a sensor this strong the noise is below rounding, and `f` does not distinguish it
        // from a stronger one: the cap has no effect on the result, and sums of squares stay
        // finite.
        let strongest = T::one() / T::EPSILON;
        let (coefficient_max, noise_amplitude) = (self.coefficient_max, self.noise_amplitude);
        move |gain| (coefficient_max * gain / noise_amplitude).min(strongest)
    }

    /// Returns the limits of the slot.
    pub fn limits(&self) -> &SlotLimits<T> {
        &self.limits
    }

    /// Returns the number of sensors.
    pub fn sensor_count(&self) -> usize {
        self.sums.len()
    }

    /// Returns whether `Gamma` can be met: `f(c*) >= kappa`.
    pub fn is_feasible(&self) -> bool {
        self.peak.efficiency() >= self.limits.kappa(self.sensor_count())
    }

    /// Returns the least MSE that these channels allow with the user silent: `(J - f(c*)) / J^2`.
    pub fn least_mse(&self) -> T {
        let sensors = T::count(self.sensor_count());
        (sensors - self.peak.efficiency()) / (sensors * sensors)
    }

    /// Returns the MSE that no transmit power can reach, at any position: `(J - w) / J^2` with `w`
    /// the sum of the weights `m_j`; 0 where the channels are known exactly.
    pub fn error_floor(&self) -> T {
        let sensors = T::count(self.sensor_count());
        let missing = match self.sorted {
            Sorted::Known(_) => T::zero(),
            Sorted::Weighted(weighted, _) => sensors - weighted.weight_from(0),
        };
        missing.max(T::zero()) / (sensors * sensors)
    }

    /// Returns `(1 + eps_g) Q`, where `Q = p^max |g|^2 / sigma^2`, or infinity where that exceeds the number type.
    pub(super) fn normalized_budget(&self, user: PowerGain<T>) -> T {
        let power = self.limits.user_power_max.0;
        if power <= T::zero() {
            return T::zero();
        }
        let budget = power * (user.0 / self.limits.noise_power.0);
        match self.sorted.uncertainty() {
            None => budget,
            Some(uncertainty) => budget * uncertainty.user_excess(),
        }
    }

    /// Returns the strongest amplitude.
    pub(super) fn strongest(&self) -> T {
        match self.sorted {
            Sorted::Known(sensors) => sensors.amplitude(self.last()),
            Sorted::Weighted(sensors, _) => sensors.amplitude(self.last()),
        }
    }

    /// Returns the level at which all sensors transmit with full power: the strongest amplitude.
    pub(super) fn at_full_power(&self) -> Level<T> {
        let segment = match self.sorted {
            Sorted::Known(sensors) => self.segment(sensors, self.last()),
            Sorted::Weighted(sensors, _) => self.segment(sensors, self.last()),
        };
        segment.level(self.strongest())
    }

    /// Returns the level with the least `c` that satisfies a predicate of levels, where that is
    /// false up to some `c` and true from there on. `enough` is the predicate at the ends of the
    /// segments: at an amplitude, with the segment below it. `within` solves it within the segment
    /// found; its result is limited to the segment and to `ceiling`. Worst case: `log2 J`
    /// evaluations of the predicate.
    pub(super) fn first_level(
        &self,
        ceiling: T,
        enough: impl Fn(Segment<T>, T) -> bool,
        within: impl FnOnce(Segment<T>) -> T,
    ) -> Level<T> {
        match self.sorted {
            Sorted::Known(sensors) => self.search(sensors, ceiling, enough, within),
            Sorted::Weighted(sensors, _) => self.search(sensors, ceiling, enough, within),
        }
    }

    /// Returns what [`first_level`](Self::first_level) does, for the sorted sensors of this field.
    fn search(
        &self,
        sensors: impl SortedSensors<T>,
        ceiling: T,
        enough: impl Fn(Segment<T>, T) -> bool,
        within: impl FnOnce(Segment<T>) -> T,
    ) -> Level<T> {
        let (mut low, mut high) = (0, self.last());
        while low < high {
            let middle = low + (high - low) / 2;
            let c = sensors.amplitude(middle);
            if c >= ceiling || enough(self.segment(sensors, middle), c) {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        let weaker = low.checked_sub(1);
        let floor = weaker.map_or(T::zero(), |k| sensors.amplitude(k));
        let segment = self.segment(sensors, low);
        let top = sensors.amplitude(low).min(ceiling);
        let c = within(segment);
        // Where rounding leads out of the segment, its end is returned; also for a quotient 0/0,
        // which occurs only in an empty segment.
        let c = if c < top { c.max(floor) } else { top };
        segment.level(c)
    }

    /// Returns the index of the strongest sensor.
    fn last(&self) -> usize {
        self.sensor_count().saturating_sub(1)
    }

    /// Returns segment `k`, which ends at the amplitude of sensor `k`. There are `J` segments, `J >=
    /// 1`, and callers ask for no other, so the default is never used.
    fn segment(&self, sensors: impl SortedSensors<T>, k: usize) -> Segment<T> {
        Segment {
            strong: sensors.weight_from(k),
            below: self.sums.get(k).copied().unwrap_or_default(),
        }
    }

    /// Returns `c*`: the level where `E - c A` reaches 0, or the strongest amplitude where it never
    /// does. With `k` sensors below, the quadratic terms cancel: `E - c A = 1 + energy_k - c
    /// amplitude_k`, which is decreasing.
    fn find_peak(&self, sensors: impl SortedSensors<T>) -> Level<T> {
        let rest = |below: &PrefixSum<T>| T::one() + below.energy;
        self.search(
            sensors,
            sensors.amplitude(self.last()),
            |Segment { below, .. }, c| rest(&below) <= c * below.amplitude,
            |Segment { below, .. }| rest(&below) / below.amplitude,
        )
    }
}
