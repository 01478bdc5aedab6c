//! Verdicts on the paper's claims about total rates.

use std::fmt::Write as _;

use super::{Approach, TotalRow, approaches, cells};
use crate::experiment::{
    Experiment,
    cell::{Cell, HIGH_NOISE_DBM, MSE_THRESHOLDS, NOISE_DBM, Topology},
    claims::{Claim, Tally, range},
};

/// "Slightly inferior": at least this fraction of the other.
const SLIGHTLY: f64 = 0.95;
/// "Far behind", "an evident gap": less than this fraction of the other.
const FAR: f64 = 0.95;

/// The rows, from which those of an approach are found by mission.
struct Totals<'a>(&'a [TotalRow]);

impl Totals<'_> {
    fn row(&self, cell: &Cell, approach: Approach) -> Option<&TotalRow> {
        let mut of_cell = self.0.iter().filter(|row| row.is_of(cell));
        of_cell.find(|row| row.approach == approach)
    }

    fn rate(&self, cell: &Cell, approach: Approach) -> f64 {
        self.row(cell, approach)
            .map_or(f64::NAN, |row| row.sum_rate)
    }

    /// Returns the total of the best of SAC's presets, by their means.
    fn sac(&self, cell: &Cell) -> f64 {
        self.rate(cell, Approach::Sac)
            .max(self.rate(cell, Approach::SacTableOne))
    }

    /// Returns the total of an approach as a percentage of another, over the cells in which it was
    /// flown.
    fn share(&self, cells: &[Cell], of: Approach, reference: Approach) -> String {
        self.share_of(cells, |cell| self.rate(cell, of), reference)
    }

    fn share_of(&self, cells: &[Cell], rate: impl Fn(&Cell) -> f64, reference: Approach) -> String {
        let shares = cells
            .iter()
            .map(|cell| rate(cell) / self.rate(cell, reference));
        let (low, high) = range(shares.filter(|share| !share.is_nan()));
        format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high)
    }
}

/// Returns how often a total rises from each mission to the next of the same kind.
fn rises(
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

fn same_topology_and_noise(a: &Cell, b: &Cell) -> bool {
    a.topology == b.topology && a.noise_dbm == b.noise_dbm
}

/// Returns the claims about fig:alg.
pub(in crate::experiment) fn claims_of_approaches(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::Approaches));
    let rising = approaches(Experiment::Approaches)
        .iter()
        .map(|&approach| rises(&totals, &cells, approach, same_topology_and_noise))
        .fold(Tally::default(), |sum, tally| sum + tally);
    let (mut best, mut close, mut far, mut near) = <(Tally, Tally, Tally, Tally)>::default();
    let mut leads = Tally::default();
    let lead = |cell: &Cell| totals.sac(cell) / totals.rate(cell, Approach::Ddpg);
    for cell in &cells {
        let (sac, ddpg) = (totals.sac(cell), totals.rate(cell, Approach::Ddpg));
        let straight = totals.rate(cell, Approach::StraightLine);
        best.add_above(sac, straight);
        best.add_above(sac, ddpg);
        close.add_above(ddpg, SLIGHTLY * sac);
        far.add_above(FAR * sac, straight);
        let search = totals.rate(cell, Approach::Search);
        let bound = totals.rate(cell, Approach::Bound);
        near.add(sac >= 0.97 * search && sac >= 0.95 * bound);
        if cell.noise_dbm == NOISE_DBM {
            leads.add_above(lead(&cell.at_noise(HIGH_NOISE_DBM)), lead(cell));
        }
    }
    let at = |noise_dbm: f64| cells.iter().filter(move |cell| cell.noise_dbm == noise_dbm);
    let leads_at = |noise_dbm: f64| {
        let (least, most) = range(at(noise_dbm).map(lead).filter(|lead| !lead.is_nan()));
        format!("{least:.2} to {most:.2}")
    };
    vec![
        Claim::new(
            "The total grows with the threshold, for every approach.",
            rising.verdict(),
            format!("It rises in {rising} steps."),
            "",
        ),
        Claim::new(
            "SAC is best, above DDPG and above the straight line.",
            best.verdict(),
            format!(
                "The best preset of SAC is above in {best} comparisons; `tuned` comes to {} of the \
                 certified bound, Table I's settings to {}.",
                totals.share(&cells, Approach::Sac, Approach::Bound),
                totals.share(&cells, Approach::SacTableOne, Approach::Bound),
            ),
            "",
        ),
        Claim::new(
            "DDPG is slightly inferior; the straight line is far behind.",
            (close + far).verdict(),
            format!(
                "DDPG comes to {} of the certified bound, the straight line to {}. DDPG has at \
                 least {:.0} % of SAC's total in {close} cells, the straight line less than \
                 {:.0} % in {far}.",
                totals.share(&cells, Approach::Ddpg, Approach::Bound),
                totals.share(&cells, Approach::StraightLine, Approach::Bound),
                100.0 * SLIGHTLY,
                100.0 * FAR,
            ),
            "",
        ),
        Claim::new(
            "SAC comes close to a global search.",
            near.verdict(),
            format!(
                "The best preset comes to {} of the best known mission and {} of the certified \
                 bound; at least 97 % and 95 % in {near} cells.",
                totals.share_of(&cells, |cell| totals.sac(cell), Approach::Search),
                totals.share_of(&cells, |cell| totals.sac(cell), Approach::Bound),
            ),
            "",
        ),
        Claim::new(
            "With more noise SAC's lead over DDPG grows.",
            leads.verdict(),
            format!(
                "SAC's total over DDPG's is {} at {NOISE_DBM} dBm and {} at {HIGH_NOISE_DBM} dBm; \
                 it grows in {leads} cells.",
                leads_at(NOISE_DBM),
                leads_at(HIGH_NOISE_DBM),
            ),
            "",
        ),
    ]
}

/// Returns the claims about fig:sigma.
pub(in crate::experiment) fn claims_of_noise(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::Noise));
    let mut falls = Tally::default();
    let mut losses = Vec::new();
    for cell in cells.iter().filter(|cell| cell.noise_dbm == NOISE_DBM) {
        let quiet = totals.rate(cell, Approach::Sac);
        let noisy = totals.rate(&cell.at_noise(HIGH_NOISE_DBM), Approach::Sac);
        falls.add_above(quiet, noisy);
        losses.push(100.0 * (1.0 - noisy / quiet));
    }
    let rising = rises(&totals, &cells, Approach::Sac, same_topology_and_noise);
    let (least, most) = range(losses);
    vec![
        Claim::new(
            "The total falls with noise, in both topologies and at every threshold.",
            falls.verdict(),
            format!("It falls in {falls} cells, by {least:.1} to {most:.1} %."),
            "",
        ),
        Claim::new(
            "It grows with the threshold at either noise power.",
            rising.verdict(),
            format!("It rises in {rising} steps."),
            "",
        ),
    ]
}

/// Returns the claims about fig:diffing.
pub(in crate::experiment) fn claims_of_strategies(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::Strategies));
    let growth = |approach: Approach| {
        Topology::ALL.map(|topology| {
            let at = |index: usize| {
                let cell = Cell::table_one(topology).at_threshold(MSE_THRESHOLDS[index]);
                totals.rate(&cell, approach)
            };
            100.0 * (at(3) / at(2) - 1.0)
        })
    };
    let mut levels_off = Tally::default();
    let sensor = growth(Approach::FixedSensorPower);
    for (late, sac_late) in sensor.iter().zip(growth(Approach::Sac)) {
        levels_off.add_above(0.5 * sac_late, *late);
    }
    let missed = rows
        .iter()
        .filter(|row| row.approach == Approach::FixedSensorPower)
        .map(|row| row.missed_slots);
    let (fewest, most) = range(missed);
    vec![
        best_of_strategies(&totals, &cells),
        Claim::new(
            "With fixed sensor power the total levels off as the threshold grows.",
            levels_off.verdict(),
            format!(
                "From 0.020 to 0.025 it grows by {:.1} % (separated) and {:.1} % (mixed); in \
                 {fewest:.0} to {most:.0} of 60 slots sensors of equal power cannot meet the \
                 threshold at all, and such a slot carries nothing.",
                sensor[0], sensor[1]
            ),
            "Sensors that all send with full power arrive with unequal amplitudes, which alone \
             exceeds a tight threshold; a looser one lets more slots through, so the total grows \
             with it. The paper gives neither the power nor what a slot counts that misses Gamma.",
        ),
    ]
}

fn best_of_strategies(totals: &Totals<'_>, cells: &[Cell]) -> Claim {
    const FIXED: [Approach; 3] = [
        Approach::FixedPosition,
        Approach::FixedUserPower,
        Approach::FixedSensorPower,
    ];
    let (mut best, mut evident) = <(Tally, Tally)>::default();
    let mut text = String::new();
    for approach in FIXED {
        for cell in cells {
            let sac = totals.rate(cell, Approach::Sac);
            best.add_above(sac, totals.rate(cell, approach));
            evident.add_above(FAR * sac, totals.rate(cell, approach));
        }
        let of_sac = totals.share(cells, approach, Approach::Sac);
        let _ = write!(text, " {}: {of_sac} of SAC's total.", approach.title());
    }
    Claim::new(
        "SAC is best, with an evident gap to every scheme that holds something fixed.",
        (best + evident).verdict(),
        format!(
            "Above in {best} comparisons, the scheme below {:.0} % of it in {evident}.{text}",
            100.0 * FAR
        ),
        "",
    )
}

/// Returns the claims about fig:diffint.
pub(in crate::experiment) fn claims_of_mission_time(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::MissionTime));
    let rising = rises(&totals, &cells, Approach::Sac, |a, b| {
        a.topology == b.topology
    });
    let per_second: Vec<f64> = cells
        .iter()
        .map(|cell| totals.rate(cell, Approach::Sac) / f64::from(cell.slots))
        .collect();
    let (low, high) = range(per_second);
    vec![
        best_of_strategies(&totals, &cells),
        Claim::new(
            "The total grows with the mission time.",
            rising.verdict(),
            format!(
                "It rises in {rising} steps, at {low:.3} to {high:.3} bit/s/Hz per slot; SAC comes \
                 to {} of the certified bound.",
                totals.share(&cells, Approach::Sac, Approach::Bound),
            ),
            "",
        ),
    ]
}
