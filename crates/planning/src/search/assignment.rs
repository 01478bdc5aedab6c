//! The optimal assignment of users to given slots under the fairness constraint eq:a3.

use pathfinding::{kuhn_munkres::kuhn_munkres, matrix::Matrix};

/// Returns the admissible assignment of users to slots with the largest sum of rates: every user
/// has at least as many slots as its quota, and every slot has one user. `rates` is a matrix of
/// slots by users, row by row; `quotas` has one entry per user, in sum at most the number of slots.
///
/// Each user has as many seats as its quota. Each remaining slot is assigned to the user with the
/// highest rate in it. Worst case: cubic in the number of slots.
pub fn assign(rates: &[f64], quotas: &[usize]) -> Vec<usize> {
    let users = quotas.len();
    let slots = rates.len() / users;
    let seats: Vec<usize> = (quotas.iter().enumerate())
        .flat_map(|(user, &quota)| std::iter::repeat_n(user, quota))
        .collect();
    let best = |slot: usize| {
        let row = &rates[slot * users..][..users];
        (1..users).fold(
            0,
            |best, user| if row[user] > row[best] { user } else { best },
        )
    };
    let user_of_seat = |slot: usize, seat: usize| {
        let owner = seats.get(seat).copied();
        owner.unwrap_or_else(|| best(slot))
    };
    // Fixed point: 2^-40 bit/s/Hz is far below the accuracy of a rate.
    let fixed_point = |rate: f64| (rate * 1_099_511_627_776.0) as i64;
    let weights = Matrix::from_fn(slots, slots, |(slot, seat)| {
        fixed_point(rates[slot * users + user_of_seat(slot, seat)])
    });
    let (_, taken) = kuhn_munkres(&weights);
    taken
        .into_iter()
        .enumerate()
        .map(|(slot, seat)| user_of_seat(slot, seat))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Finds the best admissible assignment of a tiny instance by enumeration, counting in base
    /// `users`.
    fn best_by_enumeration(rates: &[f64], users: usize, quota: usize) -> f64 {
        let slots = rates.len() / users;
        (0..users.pow(slots as u32))
            .filter_map(|code| {
                let served = |slot: usize| code / users.pow(slot as u32) % users;
                let fair = (0..users)
                    .all(|user| (0..slots).filter(|&slot| served(slot) == user).count() >= quota);
                fair.then(|| {
                    (0..slots)
                        .map(|slot| rates[slot * users + served(slot)])
                        .sum()
                })
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn matches_enumeration() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(5);
        for (slots, users) in [(1, 1), (4, 2), (5, 2), (6, 3), (7, 3), (2, 3)] {
            for _ in 0..50 {
                let rates: Vec<f64> = (0..slots * users)
                    .map(|_| rng.random_range(0.0..3.0))
                    .collect();
                let quota = slots / users;
                let served = assign(&rates, &vec![quota; users]);
                let sum: f64 = (0..slots)
                    .map(|slot| rates[slot * users + served[slot]])
                    .sum();
                assert!((sum - best_by_enumeration(&rates, users, quota)).abs() < 1e-9);
                for user in 0..users {
                    assert!(served.iter().filter(|&&u| u == user).count() >= quota);
                }
            }
        }
    }
}
