// SPDX-License-Identifier: MIT OR Apache-2.0
//! Sorting of amplitudes, with or without weights.
//!
//! Runs of eight by a sorting network, then merges of neighbouring runs. The sorts of `core` take
//! more instructions at 36 numbers, need three times as much code, and contain a panic for an
//! inconsistent order.
//!
//! Worst case: `O(J log J)`, and few instructions more than on average.

use super::{prefix_sum::PrefixSum, weighted::WeightedAmplitude};
use crate::{scalar::Scalar, sort::insertion_sort};

/// The length of the runs that the network sorts.
const RUN: usize = 8;

/// What is sorted, by an amplitude that is neither NaN nor infinite. Between two merges it is stored
/// in the memory of the running sums.
pub(super) trait Sortable<T>: Copy {
    /// Returns an item that is stronger than any other.
    fn end() -> Self;
    /// Returns the amplitude.
    fn amplitude(&self) -> T;
    /// Stores the item.
    fn store(self, memory: &mut PrefixSum<T>);
    /// Returns the item that was stored.
    fn load(memory: &PrefixSum<T>) -> Self;
}

impl<T: Scalar> Sortable<T> for T {
    fn end() -> Self {
        T::of(f64::INFINITY)
    }
    fn amplitude(&self) -> T {
        *self
    }
    fn store(self, memory: &mut PrefixSum<T>) {
        memory.amplitude = self;
    }
    fn load(memory: &PrefixSum<T>) -> Self {
        memory.amplitude
    }
}

impl<T: Scalar> Sortable<T> for WeightedAmplitude<T> {
    fn end() -> Self {
        Self {
            amplitude: T::of(f64::INFINITY),
            weight: T::zero(),
        }
    }
    fn amplitude(&self) -> T {
        self.amplitude
    }
    fn store(self, memory: &mut PrefixSum<T>) {
        memory.amplitude = self.amplitude;
        memory.energy = self.weight;
    }
    fn load(memory: &PrefixSum<T>) -> Self {
        Self {
            amplitude: memory.amplitude,
            weight: memory.energy,
        }
    }
}

/// Sorts items in ascending order. `scratch`, as long as `values`, is used as memory in between.
pub(super) fn sort<T: Scalar, V: Sortable<T>>(values: &mut [V], scratch: &mut [PrefixSum<T>]) {
    let (runs, rest) = values.as_chunks_mut::<RUN>();
    for run in runs {
        sort_run(run);
    }
    insertion_sort(rest, |a, b| a.amplitude() < b.amplitude());
    let mut run = RUN;
    while run < values.len() {
        merge_runs(values, run, scratch);
        for (value, merged) in values.iter_mut().zip(scratch.iter()) {
            *value = V::load(merged);
        }
        run *= 2;
    }
}

/// Merges each two neighbouring runs of length `run` of `values` into one, in `merged`.
fn merge_runs<T: Scalar, V: Sortable<T>>(values: &[V], run: usize, merged: &mut [PrefixSum<T>]) {
    // Behind the end of a run.
    let end = V::end();
    let mut merged = merged.iter_mut();
    for pair in values.chunks(2 * run) {
        let (left, right) = pair.split_at_checked(run).unwrap_or((pair, &[]));
        let (mut left, mut right) = (left.iter().copied(), right.iter().copied());
        let (mut a, mut b) = (left.next().unwrap_or(end), right.next().unwrap_or(end));
        for merged in merged.by_ref().take(pair.len()) {
            if b.amplitude() < a.amplitude() {
                b.store(merged);
                b = right.next().unwrap_or(end);
            } else {
                a.store(merged);
                a = left.next().unwrap_or(end);
            }
        }
    }
}

/// Sorts eight items, by a network of 19 comparisons.
fn sort_run<T: Scalar, V: Sortable<T>>([a, b, c, d, e, f, g, h]: &mut [V; RUN]) {
    order(a, c);
    order(b, d);
    order(e, g);
    order(f, h);

    order(a, e);
    order(b, f);
    order(c, g);
    order(d, h);

    order(a, b);
    order(c, d);
    order(e, f);
    order(g, h);

    order(c, e);
    order(d, f);

    order(b, e);
    order(d, g);

    order(b, c);
    order(d, e);
    order(f, g);
}

fn order<T: Scalar, V: Sortable<T>>(low: &mut V, high: &mut V) {
    let (a, b) = (*low, *high);
    let swap = b.amplitude() < a.amplitude();
    (*low, *high) = if swap { (b, a) } else { (a, b) };
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    fn sorted(mut values: Vec<f32>) -> Vec<f32> {
        let mut scratch = Vec::from_iter(values.iter().map(|_| PrefixSum::default()));
        sort(&mut values, &mut scratch);
        values
    }

    /// A network sorts every input if it sorts every input of zeros and ones, and so does a merge
    /// of every two runs: here each number of zeros in the first runs.
    #[test]
    fn zeros_and_ones_are_sorted() {
        for length in 0..=12_u32 {
            for bits in 0..1_u32 << length {
                let values = Vec::from_iter((0..length).map(|index| (bits >> index & 1) as f32));
                let result = sorted(values);
                let ones = bits.count_ones() as usize;
                let zeros = result.len() - ones;
                assert!(
                    result[..zeros].iter().all(|&x| x == 0.0),
                    "{length} {bits:b}"
                );
                assert!(
                    result[zeros..].iter().all(|&x| x == 1.0),
                    "{length} {bits:b}"
                );
            }
        }
    }

    /// Every length, in ascending, descending and mixed order, with equal numbers among them.
    #[test]
    fn every_length_is_sorted() {
        for length in 0..=130_usize {
            for (factor, modulus) in [(1, 997), (996, 997), (389, 997), (7, 13)] {
                let number = |index: usize| (index * factor % modulus) as f32 / 8.0;
                let values = Vec::from_iter((0..length).map(number));
                let mut expected = values.clone();
                expected.sort_by(f32::total_cmp);
                assert_eq!(sorted(values.clone()), expected, "{length} {factor}");
                let weight = |index: usize| index as f32;
                let mut pairs = Vec::from_iter((0..length).map(|index| WeightedAmplitude {
                    amplitude: values[index],
                    weight: weight(index),
                }));
                let mut scratch = Vec::from_iter(pairs.iter().map(|_| PrefixSum::default()));
                sort(&mut pairs, &mut scratch);
                for (pair, expected) in pairs.iter().zip(&expected) {
                    assert_eq!(pair.amplitude, *expected);
                    // Each weight stays with its amplitude.
                    assert_eq!(values[pair.weight as usize], *expected, "{length} {factor}");
                }
                let mut weights = Vec::from_iter(pairs.iter().map(|pair| pair.weight));
                weights.sort_by(f32::total_cmp);
                assert_eq!(weights, Vec::from_iter((0..length).map(weight)));
            }
        }
    }
}
