//! Orders of service that meet the remaining quotas.

use super::assignment;

/// Reduces the remaining quotas of the users to `slots` in all, the largest first.
pub(super) fn reduce_to<const M: usize>(least: &mut [u32; M], slots: usize) {
    let sum = |least: &[u32; M]| -> usize { least.iter().map(|&count| count as usize).sum() };
    while sum(least) > slots {
        let Some(largest) = least.iter_mut().max() else {
            return;
        };
        *largest -= 1;
    }
}

/// Returns whether an order of service contains valid users only and meets every remaining quota.
pub(super) fn is_fair<const M: usize>(
    least: &[u32; M],
    users: usize,
    served: &[u8],
    slots: usize,
) -> bool {
    let served = served.get(..slots).unwrap_or(&[]);
    let counts: [u32; M] = assignment::counts(served);
    served.iter().all(|&user| usize::from(user) < users)
        && counts
            .iter()
            .zip(least)
            .all(|(count, least)| count >= least)
}

/// Creates a fair order of service without knowledge of rates: in turn, the user with the largest
/// remaining quota first.
pub(super) fn serve_in_turn<const M: usize>(
    least: &[u32; M],
    users: usize,
    served: &mut [u8],
    slots: usize,
) {
    let mut owed = *least;
    for served in served.iter_mut().take(slots) {
        let mut next = 0;
        for user in 1..users.min(M) {
            if owed.get(user) > owed.get(next) {
                next = user;
            }
        }
        *served = next as u8;
        if let Some(owed) = owed.get_mut(next) {
            *owed = owed.saturating_sub(1);
        }
    }
}
