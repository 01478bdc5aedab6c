// SPDX-License-Identifier: MIT OR Apache-2.0
//! Sensors with weights, for slots whose channels are not known exactly.

use crate::{scalar::Scalar, uncertainty::SlotUncertainty};

/// A sensor's effective amplitude and its weight `m_j`; after sorting, `weight` is the sum over this
/// sensor and all stronger ones.
#[derive(Clone, Copy, Debug, Default)]
pub struct WeightedAmplitude<T> {
    pub(super) amplitude: T,
    pub(super) weight: T,
}

/// The weights of a slot's sensors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights<'w, T> {
    /// In ascending order; entry `k` has the sum of the weights of sensor `k` and all stronger ones.
    pub(super) sorted: &'w [WeightedAmplitude<T>],
    /// In the order of the gains.
    pub(super) uncertainty: SlotUncertainty<'w, T>,
}

impl<T: Scalar> Weights<'_, T> {
    /// Returns the sum of the weights of sensor `k` and all stronger ones, in sorted order.
    pub(super) fn from(&self, k: usize) -> T {
        self.sorted.get(k).map_or(T::zero(), |entry| entry.weight)
    }
}
