//! Verdicts on the paper's claims about total rates.

use std::fmt::Write as _;

use super::{Approach, FAILED, TotalRow, approaches, cells};
use crate::experiment::{
    Experiment,
    cell::{Cell, HIGH_NOISE_DBM, MSE_THRESHOLDS, NOISE_DBM, Preset, Topology},
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

    /// Returns the total of an approach as a percentage of another, over the cells in which it was
    /// flown.
    fn share(&self, cells: &[Cell], of: Approach, reference: Approach) -> String {
        let shares = cells
            .iter()
            .map(|cell| self.rate(cell, of) / self.rate(cell, reference));
        let (low, high) = range(shares.filter(|share| !share.is_nan()));
        format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high)
    }

    /// Returns in how many of the cells in which both approaches have a confidence interval the one
    /// of `above` is above the one of `below`.
    fn intervals_apart(&self, cells: &[Cell], above: Approach, below: Approach) -> Tally {
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

/// Returns the claims about fig:alg: those about learners once for each preset, so that only
/// learners of the same preset are compared.
pub(in crate::experiment) fn claims_of_approaches(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::Approaches));
    let rising = approaches(Experiment::Approaches)
        .iter()
        .map(|&approach| rises(&totals, &cells, approach, same_topology_and_noise))
        .fold(Tally::default(), |sum, tally| sum + tally);
    let mut claims = vec![Claim::new(
        "The total grows with the threshold, for every approach.",
        rising.verdict(),
        format!("It rises in {rising} steps."),
        "",
    )];
    let of_preset = |claim: fn(&Totals<'_>, &[Cell], Preset) -> Claim| {
        Preset::ALL.map(|preset| claim(&totals, &cells, preset))
    };
    for claim in [
        best,
        slightly_inferior,
        straight_line_far_behind,
        above_straight_line,
        near_search,
        lead_grows,
        no_run_failed,
    ] {
        claims.extend(of_preset(claim));
    }
    claims
}

fn best(totals: &Totals<'_>, cells: &[Cell], preset: Preset) -> Claim {
    let (sac, ddpg) = (Approach::sac(preset), Approach::ddpg(preset));
    let (mut above_ddpg, mut above_line) = <(Tally, Tally)>::default();
    for cell in cells {
        let total = totals.rate(cell, sac);
        above_ddpg.add_above(total, totals.rate(cell, ddpg));
        above_line.add_above(total, totals.rate(cell, Approach::StraightLine));
    }
    let apart = totals.intervals_apart(cells, sac, ddpg);
    let intervals = match apart.cases {
        0 => "no cell has the intervals of both learners yet".to_owned(),
        _ => format!("its interval is above DDPG's in {apart} cells with intervals of both"),
    };
    Claim::new(
        format!(
            "SAC is best, above DDPG and above the straight line: {} against {}.",
            sac.title(),
            ddpg.title()
        ),
        (above_ddpg + above_line).verdict(),
        format!(
            "{} is above {} in {above_ddpg} cells ({intervals}) and above the straight line in \
             {above_line}; it reaches {} of the certified bound.",
            sac.title(),
            ddpg.title(),
            totals.share(cells, sac, Approach::Bound),
        ),
        "",
    )
}

fn slightly_inferior(totals: &Totals<'_>, cells: &[Cell], preset: Preset) -> Claim {
    let (sac, ddpg) = (Approach::sac(preset), Approach::ddpg(preset));
    let mut close = Tally::default();
    for cell in cells {
        close.add_above(totals.rate(cell, ddpg), SLIGHTLY * totals.rate(cell, sac));
    }
    Claim::new(
        format!(
            "DDPG is only slightly inferior to SAC: {} against {}.",
            ddpg.title(),
            sac.title()
        ),
        close.verdict(),
        format!(
            "{} has at least {:.0} % of the total of {} in {close} cells; it reaches {} of that \
             total and {} of the certified bound.",
            ddpg.title(),
            100.0 * SLIGHTLY,
            sac.title(),
            totals.share(cells, ddpg, sac),
            totals.share(cells, ddpg, Approach::Bound),
        ),
        "",
    )
}

fn straight_line_far_behind(totals: &Totals<'_>, cells: &[Cell], preset: Preset) -> Claim {
    let sac = Approach::sac(preset);
    let mut far = Tally::default();
    for cell in cells {
        let line = totals.rate(cell, Approach::StraightLine);
        far.add_above(FAR * totals.rate(cell, sac), line);
    }
    Claim::new(
        format!("The straight line is far behind SAC: {}.", sac.title()),
        far.verdict(),
        format!(
            "It has less than {:.0} % of the total of {} in {far} cells; it reaches {} of that \
             total.",
            100.0 * FAR,
            sac.title(),
            totals.share(cells, Approach::StraightLine, sac),
        ),
        "",
    )
}

fn above_straight_line(totals: &Totals<'_>, cells: &[Cell], preset: Preset) -> Claim {
    let ddpg = Approach::ddpg(preset);
    let (mut above, mut below) = (Tally::default(), Vec::new());
    for cell in cells {
        let (total, line) = (
            totals.rate(cell, ddpg),
            totals.rate(cell, Approach::StraightLine),
        );
        above.add_above(total, line);
        if total < line {
            below.push(format!("{} ({:.1} %)", named(cell), 100.0 * total / line));
        }
    }
    let mut measured = format!("{} is above it in {above} cells.", ddpg.title());
    if !below.is_empty() {
        let _ = write!(
            measured,
            " It is below, with the fraction of the straight line's total, in: {}.",
            below.join("; ")
        );
    }
    Claim::new(
        format!("DDPG is above the straight line: {}.", ddpg.title()),
        above.verdict(),
        measured,
        "",
    )
}

fn near_search(totals: &Totals<'_>, cells: &[Cell], preset: Preset) -> Claim {
    let sac = Approach::sac(preset);
    let mut near = Tally::default();
    for cell in cells {
        let of = |approach| totals.rate(cell, sac) / totals.rate(cell, approach);
        near.add(of(Approach::Search) >= 0.97 && of(Approach::Bound) >= 0.95);
    }
    Claim::new(
        format!("SAC comes close to a global search: {}.", sac.title()),
        near.verdict(),
        format!(
            "{} reaches {} of the best known mission and {} of the certified bound; at least 97 % \
             and 95 % in {near} cells.",
            sac.title(),
            totals.share(cells, sac, Approach::Search),
            totals.share(cells, sac, Approach::Bound),
        ),
        "",
    )
}

fn lead_grows(totals: &Totals<'_>, cells: &[Cell], preset: Preset) -> Claim {
    let (sac, ddpg) = (Approach::sac(preset), Approach::ddpg(preset));
    let lead = |cell: &Cell| totals.rate(cell, sac) / totals.rate(cell, ddpg);
    let mut leads = Tally::default();
    for cell in cells.iter().filter(|cell| cell.noise_dbm == NOISE_DBM) {
        leads.add_above(lead(&cell.at_noise(HIGH_NOISE_DBM)), lead(cell));
    }
    let leads_at = |noise_dbm: f64| {
        let cells = cells.iter().filter(|cell| cell.noise_dbm == noise_dbm);
        let (least, most) = range(cells.map(lead).filter(|lead| !lead.is_nan()));
        format!("{least:.3} to {most:.3}")
    };
    Claim::new(
        format!(
            "With more noise SAC's lead over DDPG grows: {} against {}.",
            sac.title(),
            ddpg.title()
        ),
        leads.verdict(),
        format!(
            "The total of {} divided by that of {} is {} at {NOISE_DBM} dBm and {} at \
             {HIGH_NOISE_DBM} dBm; it grows in {leads} cells.",
            sac.title(),
            ddpg.title(),
            leads_at(NOISE_DBM),
            leads_at(HIGH_NOISE_DBM),
        ),
        "",
    )
}

fn no_run_failed(totals: &Totals<'_>, cells: &[Cell], preset: Preset) -> Claim {
    let learners = [Approach::sac(preset), Approach::ddpg(preset)];
    let (mut sound, mut failed, mut alone) = (Tally::default(), Vec::new(), 0);
    for cell in cells {
        for row in learners.map(|learner| totals.row(cell, learner)) {
            let Some(row) = row else { continue };
            if row.runs < 2 {
                alone += 1;
                continue;
            }
            sound.add(row.failed_seeds.is_empty());
            if !row.failed_seeds.is_empty() {
                let title = row.approach.title();
                failed.push(format!(
                    "{title}, {}: seed {}",
                    named(cell),
                    row.failed_seeds
                ));
            }
        }
    }
    let mut measured = format!(
        "A run looks failed if its total is below {:.0} % of the median of the same cell's other \
         seeds. All look sound in {sound} cases (a learner and a cell) with several seeds",
        100.0 * FAILED
    );
    if alone > 0 {
        let _ = write!(measured, "; {alone} cases have one seed only");
    }
    measured.push('.');
    if !failed.is_empty() {
        let _ = write!(measured, " Runs that look failed: {}.", failed.join("; "));
    }
    Claim::new(
        format!(
            "No training fails (not a claim of the paper): {}, {}.",
            learners[0].title(),
            learners[1].title()
        ),
        sound.verdict(),
        measured,
        "",
    )
}

/// Returns the values that distinguish the cells of fig:alg.
fn named(cell: &Cell) -> String {
    format!(
        "{}, {} dBm, {:.3}",
        cell.topology.name(),
        cell.noise_dbm,
        cell.mse_threshold
    )
}

/// Returns the claims about fig:sigma.
pub(in crate::experiment) fn claims_of_noise(rows: &[TotalRow]) -> Vec<Claim> {
    let (totals, cells) = (Totals(rows), cells(Experiment::Noise));
    let mut falls = Tally::default();
    let mut losses = Vec::new();
    for cell in cells.iter().filter(|cell| cell.noise_dbm == NOISE_DBM) {
        let quiet = totals.rate(cell, Approach::SacTuned);
        let noisy = totals.rate(&cell.at_noise(HIGH_NOISE_DBM), Approach::SacTuned);
        falls.add_above(quiet, noisy);
        losses.push(100.0 * (1.0 - noisy / quiet));
    }
    let rising = rises(&totals, &cells, Approach::SacTuned, same_topology_and_noise);
    let (least, most) = range(losses);
    vec![
        Claim::new(
            "The total falls with noise, in both topologies and at every threshold: SAC (tuned).",
            falls.verdict(),
            format!("It falls in {falls} cells, by {least:.1} to {most:.1} %."),
            "",
        ),
        Claim::new(
            "It grows with the threshold at either noise power: SAC (tuned).",
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
    for (late, sac_late) in sensor.iter().zip(growth(Approach::SacTuned)) {
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
            let sac = totals.rate(cell, Approach::SacTuned);
            best.add_above(sac, totals.rate(cell, approach));
            evident.add_above(FAR * sac, totals.rate(cell, approach));
        }
        let of_sac = totals.share(cells, approach, Approach::SacTuned);
        let _ = write!(
            text,
            " {}: {of_sac} of the total of SAC (tuned).",
            approach.title()
        );
    }
    Claim::new(
        "SAC is best, with an evident gap to every scheme that holds something fixed: SAC \
         (tuned), seed 1, and the same policy with fixed powers.",
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
    let rising = rises(&totals, &cells, Approach::SacTuned, |a, b| {
        a.topology == b.topology
    });
    let per_second: Vec<f64> = cells
        .iter()
        .map(|cell| totals.rate(cell, Approach::SacTuned) / f64::from(cell.slots))
        .collect();
    let (low, high) = range(per_second);
    vec![
        best_of_strategies(&totals, &cells),
        Claim::new(
            "The total grows with the mission time: SAC (tuned), seed 1.",
            rising.verdict(),
            format!(
                "It rises in {rising} steps, at {low:.3} to {high:.3} bit/s/Hz per slot; SAC \
                 (tuned) reaches {} of the certified bound.",
                totals.share(&cells, Approach::SacTuned, Approach::Bound),
            ),
            "",
        ),
    ]
}
