// SPDX-License-Identifier: MIT OR Apache-2.0
//! Sorting of a few values without a panic.

/// Sorts in ascending order. The sorts and selections of `core` contain a panic for an inconsistent
/// order. Worst case: a comparison for each two values.
pub(crate) fn insertion_sort<T>(values: &mut [T], is_less: impl Fn(&T, &T) -> bool) {
    for end in 1..=values.len() {
        let Some((last, before)) = values.get_mut(..end).and_then(<[T]>::split_last_mut) else {
            return;
        };
        let mut hole = last;
        for value in before.iter_mut().rev() {
            if !is_less(hole, value) {
                break;
            }
            core::mem::swap(value, hole);
            hole = value;
        }
    }
}
