// SPDX-License-Identifier: MIT OR Apache-2.0
//! Collecting into vectors of a fixed capacity.

use heapless::Vec;

/// Collects items up to the capacity; further ones are dropped. (`Vec::from_iter` panics there.)
pub(crate) fn collect_first<T, const N: usize>(items: impl IntoIterator<Item = T>) -> Vec<T, N> {
    let mut collected = Vec::new();
    for item in items {
        if collected.push(item).is_err() {
            break;
        }
    }
    collected
}
