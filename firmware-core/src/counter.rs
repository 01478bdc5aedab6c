//! Counters that saturate.

/// Adds one to a counter, which stays at its largest value.
pub(crate) fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}
