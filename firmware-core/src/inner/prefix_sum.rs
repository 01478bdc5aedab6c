// SPDX-License-Identifier: MIT OR Apache-2.0
//! Running sums over sorted sensors.

/// Sums over the sensors below an index in the sorted order.
#[derive(Clone, Copy, Debug, Default)]
pub struct PrefixSum<T> {
    pub(super) amplitude: T,
    pub(super) energy: T,
}
