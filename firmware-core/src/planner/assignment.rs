// SPDX-License-Identifier: MIT OR Apache-2.0
//! The assignment of users to the slots of a path that maximizes the sum of rates, with every user
//! in at least as many slots as its quota asks (eq:a3).
//!
//! A transportation problem with few users and many slots. Every slot first takes its best user;
//! while a user is short of slots, the cheapest chain of reassignments gives it one. Because each
//! chain is the cheapest, the result is optimal (successive shortest paths), up to rounding.

use crate::scalar::Scalar;

/// Assigns every slot to its best user. `rates` is slots by users, row by row.
pub(super) fn assign_best<T: Scalar>(rates: &[T], users: usize, assigned: &mut [u8]) {
    for (row, assigned) in rates.chunks_exact(users.max(1)).zip(assigned) {
        let mut best = (0, T::of(f64::NEG_INFINITY));
        for (user, &rate) in row.iter().enumerate() {
            if rate > best.1 {
                best = (user, rate);
            }
        }
        *assigned = best.0 as u8;
    }
}

/// Returns the number of slots per user.
pub(super) fn counts<const M: usize>(assigned: &[u8]) -> [u32; M] {
    let mut counts = [0; M];
    for &user in assigned {
        if let Some(count) = counts.get_mut(usize::from(user)) {
            *count += 1;
        }
    }
    counts
}

/// Returns the number of operations of one [`augment`].
pub(super) fn operations(slots: usize, users: usize) -> u64 {
    (4 * slots * users + 4 * users * users * users) as u64
}

/// The cheapest reassignment of a slot from one user to another: its loss of rate, and the slot.
#[derive(Clone, Copy)]
struct Edge<T> {
    loss: T,
    slot: usize,
}

/// Gives one more slot to a user that is short of `least`, at the smallest loss of rate. Returns
/// whether that was needed and done; call until it returns false. Needs `sum(least) <= slots` to
/// succeed. Worst case: `O(slots M + M^3)`.
pub(super) fn augment<T: Scalar, const M: usize>(
    rates: &[T],
    users: usize,
    least: &[u32],
    assigned: &mut [u8],
) -> bool {
    let users = users.min(M).min(least.len());
    let count: [u32; M] = counts(assigned);
    let owed = |user: usize| least.get(user).copied().unwrap_or(0);
    let held = |user: usize| count.get(user).copied().unwrap_or(0);
    if !(0..users).any(|user| held(user) < owed(user)) {
        return false;
    }
    let infinite = T::of(f64::INFINITY);
    let nothing = Edge {
        loss: infinite,
        slot: 0,
    };
    let mut edges = [[nothing; M]; M];
    for (slot, (row, &user)) in rates.chunks_exact(users.max(1)).zip(&*assigned).enumerate() {
        let user = usize::from(user);
        let (Some(edges), Some(&rate)) = (edges.get_mut(user), row.get(user)) else {
            continue;
        };
        for (edge, &other) in edges.iter_mut().zip(row) {
            let loss = rate - other;
            if loss < edge.loss {
                *edge = Edge { loss, slot };
            }
        }
    }
    // Shortest chains from the users that can spare a slot (Bellman-Ford).
    let mut distance = [infinite; M];
    let mut before = [usize::MAX; M];
    for (user, distance) in distance.iter_mut().enumerate().take(users) {
        if held(user) > owed(user) {
            *distance = T::zero();
        }
    }
    // Rounding must not make a cycle look like a gain.
    let slack = T::EPSILON * T::of(16.0);
    for _ in 0..users {
        let mut changed = false;
        for from in 0..users {
            if !distance[from].finite() {
                continue;
            }
            for to in 0..users {
                let through = distance[from] + edges[from][to].loss;
                let known = distance[to];
                if to != from && through < known - slack * (T::one() + through.abs()) {
                    distance[to] = through;
                    before[to] = from;
                    changed = true;
                }
            }
        }
        if !changed {
            break;
        }
    }
    let short = (0..users).filter(|&user| held(user) < owed(user));
    let nearest = short.min_by(|&a, &b| distance[a].order(&distance[b]));
    let Some(end) = nearest.filter(|&user| distance[user].finite()) else {
        return false;
    };
    // The chain is applied from its end. Rounding could close it to a cycle, in which no user gains
    // a slot; then the end takes its slot from the user that loses least.
    let spares = |user: usize| user < users && held(user) > owed(user);
    let mut start = end;
    for _ in 0..users {
        if start >= users || spares(start) {
            break;
        }
        start = before[start];
    }
    if !spares(start) {
        let spare = (0..users).filter(|&user| spares(user));
        let cheapest = spare.min_by(|&a, &b| edges[a][end].loss.order(&edges[b][end].loss));
        let Some(cheapest) = cheapest else {
            return false;
        };
        before[end] = cheapest;
    }
    let mut user = end;
    for _ in 0..users {
        let from = before[user];
        if from >= users {
            break;
        }
        if let Some(slot) = assigned.get_mut(edges[from][user].slot) {
            *slot = user as u8;
        }
        user = from;
        if spares(user) {
            break;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every fair assignment of a tiny instance, by counting in base `users`.
    fn best_by_enumeration(rates: &[f64], users: usize, least: &[u32]) -> f64 {
        let slots = rates.len() / users;
        let mut best = f64::NEG_INFINITY;
        for code in 0..users.pow(slots as u32) {
            let served = |slot: usize| code / users.pow(slot as u32) % users;
            let fair = (0..users).all(|user| {
                (0..slots).filter(|&slot| served(slot) == user).count() >= least[user] as usize
            });
            if fair {
                let sum = (0..slots).map(|slot| rates[slot * users + served(slot)]);
                best = best.max(sum.sum());
            }
        }
        best
    }

    #[test]
    fn matches_enumeration() {
        let mut state = 1_u64;
        let mut random = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f64 / (1_u64 << 24) as f64
        };
        let cases: [(usize, &[u32]); 5] = [
            (4, &[2, 2]),
            (5, &[2, 1]),
            (6, &[2, 2, 2]),
            (7, &[0, 3, 2]),
            (6, &[1, 1, 1, 1]),
        ];
        for (slots, least) in cases {
            let users = least.len();
            for _ in 0..100 {
                let rates: std::vec::Vec<f64> = (0..slots * users).map(|_| random()).collect();
                let mut assigned = std::vec![0; slots];
                assign_best(&rates, users, &mut assigned);
                while augment::<_, 4>(&rates, users, least, &mut assigned) {}
                let count: [u32; 4] = counts(&assigned);
                assert!(count.iter().zip(least).all(|(held, owed)| held >= owed));
                let served = assigned.iter().enumerate();
                let sum: f64 = served
                    .map(|(slot, &u)| rates[slot * users + u as usize])
                    .sum();
                let expected = best_by_enumeration(&rates, users, least);
                assert!((sum - expected).abs() < 1e-9, "{sum} {expected}");
            }
        }
    }
}
