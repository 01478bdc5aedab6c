// SPDX-License-Identifier: MIT OR Apache-2.0
//! Orders of service that meet the remaining quotas.

use super::assignment;

/// Returns whether an order of service contains only users that are `present` and meets every
/// remaining quota.
pub(super) fn is_fair<const M: usize>(
    least: &[u32; M],
    present: impl Fn(usize) -> bool,
    served: &[u8],
    slots: usize,
) -> bool {
    let served = served.get(..slots).unwrap_or(&[]);
    let counts: [u32; M] = assignment::counts(served);
    served.iter().all(|&user| present(user.into()))
        && counts
            .iter()
            .zip(least)
            .all(|(count, least)| count >= least)
}

/// Creates a fair order of service of users that are `present` without knowledge of rates: in turn,
/// the user with the largest remaining quota first.
pub(super) fn serve_in_turn<const M: usize>(
    least: &[u32; M],
    present: impl Fn(usize) -> bool,
    served: &mut [u8],
    slots: usize,
) {
    let mut owed = *least;
    for served in served.iter_mut().take(slots) {
        let mut next: Option<(usize, u32)> = None;
        for (user, &owed) in owed.iter().enumerate() {
            if present(user) && next.is_none_or(|(_, most)| owed > most) {
                next = Some((user, owed));
            }
        }
        let (next, _) = next.unwrap_or_default();
        *served = next as u8;
        if let Some(owed) = owed.get_mut(next) {
            *owed = owed.saturating_sub(1);
        }
    }
}
