//! Total rates by mission and approach: what the verdicts compare.

use super::TotalRow;
use crate::experiment::{
    approach::Approach,
    cell::Cell,
    claims::{Tally, range},
};

/// The rows, from which those of an approach are found by mission.
pub(super) struct Totals<'a>(pub(super) &'a [TotalRow]);

impl Totals<'_> {
    /// Returns the row of an approach on a mission.
    pub(super) fn row(&self, cell: &Cell, approach: Approach) -> Option<&TotalRow> {
        let mut of_cell = self.0.iter().filter(|row| row.is_of(cell));
        of_cell.find(|row| row.approach == approach)
    }

    /// Returns the total of an approach on a mission, bit/s/Hz; NaN if it was not flown.
    pub(super) fn rate(&self, cell: &Cell, approach: Approach) -> f64 {
        self.row(cell, approach)
            .map_or(f64::NAN, |row| row.sum_rate)
    }

    /// Returns the total of an approach as a percentage of another, over the cells in which it was
    /// flown.
    pub(super) fn share(&self, cells: &[Cell], of: Approach, reference: Approach) -> String {
        let shares = cells
            .iter()
            .map(|cell| self.rate(cell, of) / self.rate(cell, reference));
        let (low, high) = range(shares.filter(|share| !share.is_nan()));
        format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high)
    }

    /// Returns in how many of the cells in which both approaches have a confidence interval the one
    /// of `above` is above the one of `below`.
    pub(super) fn intervals_apart(
        &self,
        cells: &[Cell],
        above: Approach,
        below: Approach,
    ) -> Tally {
        let mut tally = Tally::default();
        for cell in cells {
            let row = |approach| {
                let row = self.row(cell, approach)?;
                Some((row.sum_rate, row.interval_95?))
            };
            if let (Some((high, half_high)), Some((low, half_low))) = (row(above), row(below)) {
                tally.add_above(high - half_high, low + half_low);
            }
        }
        tally
    }
}

/// Returns how often a total rises from each mission to the next of the same kind.
pub(super) fn rises(
    totals: &Totals<'_>,
    cells: &[Cell],
    approach: Approach,
    same_kind: impl Fn(&Cell, &Cell) -> bool,
) -> Tally {
    let mut tally = Tally::default();
    for pair in cells
        .windows(2)
        .filter(|pair| same_kind(&pair[0], &pair[1]))
    {
        let (before, after) = (
            totals.rate(&pair[0], approach),
            totals.rate(&pair[1], approach),
        );
        tally.add_above(after, before);
    }
    tally
}

/// Returns whether two missions differ at most in threshold and mission time.
pub(super) fn same_topology_and_noise(a: &Cell, b: &Cell) -> bool {
    a.topology == b.topology && a.noise_dbm == b.noise_dbm
}

/// "Far behind", "an evident gap": less than this fraction of the other.
pub(super) const FAR: f64 = 0.95;
