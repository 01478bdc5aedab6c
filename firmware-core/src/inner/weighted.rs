// SPDX-License-Identifier: MIT OR Apache-2.0
//! The sorted sensors of a slot, with weights where the channels are not known exactly.

use crate::{scalar::Scalar, uncertainty::SlotUncertainty};

/// A sensor's effective amplitude and its weight `m_j`; once sorted, `weight` is the sum over this
/// sensor and all stronger ones.
#[derive(Clone, Copy, Debug, Default)]
pub struct WeightedAmplitude<T> {
    pub(super) amplitude: T,
    pub(super) weight: T,
}

/// Sorted sensors, the weakest first.
pub(super) trait SortedSensors<T>: Copy {
    /// Returns the amplitude of sensor `k`, or 0 if there is none.
    fn amplitude(self, k: usize) -> T;
    /// Returns the sum of the weights of sensor `k` and all stronger ones.
    fn weight_from(self, k: usize) -> T;
}

/// Channels that are known exactly: each sensor has the weight 1.
impl<T: Scalar> SortedSensors<T> for &[T] {
    fn amplitude(self, k: usize) -> T {
        self.get(k).copied().unwrap_or_default()
    }
    fn weight_from(self, k: usize) -> T {
        T::count(self.len().saturating_sub(k))
    }
}

impl<T: Scalar> SortedSensors<T> for &[WeightedAmplitude<T>] {
    fn amplitude(self, k: usize) -> T {
        self.get(k).map_or(T::zero(), |sensor| sensor.amplitude)
    }
    fn weight_from(self, k: usize) -> T {
        self.get(k).map_or(T::zero(), |sensor| sensor.weight)
    }
}

/// The sorted sensors of a slot.
#[derive(Clone, Copy, Debug)]
pub(super) enum Sorted<'w, T> {
    /// The channels are known exactly.
    Known(&'w [T]),
    /// The channels are known up to errors with these statistics, which are in the order of the gains.
    Weighted(&'w [WeightedAmplitude<T>], &'w SlotUncertainty<'w, T>),
}

impl<'w, T: Scalar> Sorted<'w, T> {
    /// Returns the statistics of the channels, or `None` where they are known exactly.
    pub(super) fn uncertainty(&self) -> Option<&'w SlotUncertainty<'w, T>> {
        match self {
            Self::Known(_) => None,
            Self::Weighted(_, uncertainty) => Some(uncertainty),
        }
    }
}
