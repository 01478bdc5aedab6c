//! Verdicts on the paper's claims about fig:alg: how the approaches to the outer problem compare.

use std::fmt::Write as _;

use super::{
    FAILED, TotalRow, approaches,
    by_mission::{FAR, Totals, rises, same_topology_and_noise},
    cells,
};
use crate::experiment::{
    Experiment,
    approach::Approach,
    cell::{Cell, HIGH_NOISE_DBM, NOISE_DBM, Preset},
    claims::{Claim, Tally, range},
};

/// "Slightly inferior": at least this fraction of the other.
const SLIGHTLY: f64 = 0.95;

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
        "A run counts as failed if its total is below {:.0} % of the median of the same cell's other \
         seeds. None counts as failed in {sound} cases (a learner and a cell) with several seeds",
        100.0 * FAILED
    );
    if alone > 0 {
        let _ = write!(measured, "; {alone} cases have one seed only");
    }
    measured.push('.');
    if !failed.is_empty() {
        let _ = write!(
            measured,
            " Runs that count as failed: {}.",
            failed.join("; ")
        );
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
