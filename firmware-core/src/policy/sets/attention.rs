// SPDX-License-Identifier: MIT OR Apache-2.0
//! Self-attention over the tokens of the mission and the users.

use super::{
    architecture::HEADS,
    columns::USERS,
    panel::{LANES, Lanes, add_product},
};

/// The number of panels that hold all tokens: one per user, and that of the mission.
pub(super) const PANELS: usize = (USERS + 1).div_ceil(LANES);

/// Writes, for every head, the average of the values, weighted by the softmax of `q.k / sqrt(D / 4)`
/// over the first `tokens` tokens, for each vector of the panel `queries` of `width` entries. Each of
/// `keys_values` holds the keys of a panel of tokens, and then their values. `None` means that sizes
/// do not fit together.
pub(super) fn attend<const N: usize>(
    queries: &[Lanes],
    keys_values: &[[Lanes; N]],
    (tokens, width): (usize, usize),
    outputs: &mut [Lanes],
) -> Option<()> {
    let size = width / HEADS;
    let factor = 1.0 / libm::sqrtf(size as f32);
    for head in 0..HEADS {
        let (begin, end) = (head * size, (head + 1) * size);
        let queries = queries.get(begin..end)?;
        // One score per key and query. The last panel may have more keys than there are tokens.
        let mut scores = [[[0.0_f32; LANES]; LANES]; PANELS];
        for (scores, keys_values) in scores.iter_mut().zip(keys_values) {
            for (query, key) in queries.iter().zip(keys_values.get(begin..end)?) {
                for (score, &key) in scores.iter_mut().zip(key) {
                    add_product(score, key, query);
                }
            }
        }
        let (scores_of_tokens, rest) = scores.as_flattened_mut().split_at_mut_checked(tokens)?;
        let total = softmax(scores_of_tokens, factor);
        rest.fill([0.0; LANES]);
        let outputs = outputs.get_mut(begin..end)?;
        outputs.fill([0.0; LANES]);
        for (weights, keys_values) in scores.iter().zip(keys_values) {
            let values = keys_values.get(width + begin..width + end)?;
            for (output, value) in outputs.iter_mut().zip(values) {
                for (weight, &value) in weights.iter().zip(value) {
                    add_product(output, value, weight);
                }
            }
        }
        for (output, total) in outputs.iter_mut().flat_map(|o| o.iter_mut().zip(total)) {
            *output /= total;
        }
    }
    Some(())
}

/// Replaces scores by the exponentials of `factor` times the difference from the largest, lane by
/// lane, and returns their sums.
fn softmax(scores: &mut [Lanes], factor: f32) -> Lanes {
    let mut largest = [f32::NEG_INFINITY; LANES];
    for score in scores.iter() {
        for (largest, &score) in largest.iter_mut().zip(score) {
            *largest = largest.max(score);
        }
    }
    let mut total = [0.0; LANES];
    for score in scores {
        for ((score, total), largest) in score.iter_mut().zip(&mut total).zip(largest) {
            *score = libm::expf((*score - largest) * factor);
            *total += *score;
        }
    }
    total
}
