//! The parts of a batch on threads. Their number is fixed and what they compute is added in order, so
//! results do not depend on the number of threads.

use std::{ops::Range, thread};

/// Number of parts of a batch. Each has a gradient of its own; they are added in order.
pub const PARTS: usize = 4;
/// Number of states that are computed together: their activations fit into a second-level cache of
/// 2 MiB, layer by layer.
pub const CHUNK: usize = 16;

/// Returns the states of part `index`, of `states` in all.
pub fn part_of(index: usize, states: usize) -> Range<usize> {
    let share = states.div_ceil(PARTS);
    let end = ((index + 1) * share).min(states);
    (index * share).min(end)..end
}

/// Calls a function for each part and its index, on up to `threads` threads.
pub fn for_each_part<P: Send>(
    parts: &mut [P],
    threads: usize,
    compute: impl Fn(usize, &mut P) + Sync,
) {
    let compute = &compute;
    let per_thread = parts.len().div_ceil(threads.max(1)).max(1);
    thread::scope(|scope| {
        let mut groups = parts.chunks_mut(per_thread).enumerate();
        let first = groups.next();
        for (group, parts) in groups {
            scope.spawn(move || {
                for (index, part) in parts.iter_mut().enumerate() {
                    compute(group * per_thread + index, part);
                }
            });
        }
        for (index, part) in first.into_iter().flat_map(|(_, parts)| parts).enumerate() {
            compute(index, part);
        }
    });
}
