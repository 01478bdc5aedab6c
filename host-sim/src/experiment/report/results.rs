//! `docs/results.md`: the verdicts with their numbers, as a document.

use std::{
    fmt::Write as _,
    path::{Component, Path},
};

use crate::experiment::{
    Experiment, approach::Approach, claims::Verdict, robustness, table, totals::TotalRow,
};

/// Writes `docs/results.md` from the CSV files in `directory`.
///
/// # Errors
/// Returns an error if a CSV file is missing or the file cannot be written.
pub fn write_results(directory: &Path, path: &Path) -> Result<(), String> {
    let figures = relative(path.parent().unwrap_or(Path::new("")), directory);
    table::write_text(path, &results(directory, &figures)?)
}

/// Returns the page of results, with links to the drawings that start with `figures`.
///
/// # Errors
/// Returns an error if a CSV file is missing.
pub fn results(directory: &Path, figures: &str) -> Result<String, String> {
    let mut claims = Vec::new();
    for experiment in Experiment::ALL {
        claims.push((experiment, experiment.claims(directory)?));
    }
    let count = |verdict: Verdict| {
        let all = claims.iter().flat_map(|(_, claims)| claims);
        all.filter(|claim| claim.verdict == verdict).count()
    };
    let approaches: Vec<TotalRow> = table::read(&Experiment::Approaches.csv(directory))?;
    let mut text = format!(
        "# Results\n\n\
         The paper's figures (Sec. VI), measured: `host-sim experiment all --out docs/figures \
         --results docs/results.md` flies\nthe stored policies and writes this page, the \
         drawings and their CSV files. Nothing here is typed by hand.\nThe paper prints no \
         values, no layouts and no seeds, so its claims are compared, not its numbers: \
         agree: {},\nin part: {}, differ: {}, open: {}. A claim about learners is counted once \
         for each preset.\n\n\
         * The policy `shipped`, which `host-sim run` flies by default, is SAC with Table I's \
         settings, seed 1, trained for the\n  mission that it flies; for a mission without \
         such a policy it is the onboard planner.\n\
         * SAC and DDPG are each trained with two presets of the trainer: `tuned`, the best \
         settings found for SAC, which go\n  beyond the paper's Alg. 2 (docs/training.md), and \
         `paper`, written \"Table I\". Learners are compared only within a\n  preset. Every \
         policy is trained for the mission that it flies.\n\
         * n is the number of seeds. From three seeds on, the mean is given with its 95 % \
         interval (Student's t); below that\n  there is no interval. The policies of seed 1 \
         are flown; \"stored\" counts the runs whose totals are read from\n  \
         `models/seeds.csv`, which `host-sim experiment seeds` wrote when it flew them.\n\
         * The figures of single flights, and those with one quantity held fixed, show seed 1 \
         alone.\n\
         * Rates are totals over the mission in bit/s/Hz.\n",
        count(Verdict::Agrees),
        count(Verdict::InPart),
        count(Verdict::Differs),
        count(Verdict::Open)
    );
    text += &seeds_of_learners(&approaches);
    text += &optimality(&approaches);
    for (experiment, claims) in claims {
        let name = experiment.name();
        let _ = write!(
            text,
            "\n## {}\n\n![{name}]({figures}{name}.svg)\n\n\
             | the paper claims | verdict | measured |\n|---|---|---|\n",
            experiment.title()
        );
        for claim in claims {
            let mut measured = claim.measured;
            if !claim.reason.is_empty() {
                let _ = write!(measured, " {}", claim.reason);
            }
            let _ = writeln!(
                text,
                "| {} | {} | {measured} |",
                claim.claimed, claim.verdict
            );
        }
        if matches!(
            experiment,
            Experiment::Noise | Experiment::Strategies | Experiment::MissionTime
        ) {
            text += &totals(&table::read(&experiment.csv(directory))?);
        }
    }
    text += &robustness::section(directory, figures)?;
    Ok(text)
}

const LEARNERS: [Approach; 4] = [
    Approach::SacTuned,
    Approach::SacTableOne,
    Approach::DdpgTuned,
    Approach::DdpgTableOne,
];

/// Returns a table of how many seeds each learner has.
fn seeds_of_learners(rows: &[TotalRow]) -> String {
    let mut text = String::from(
        "\n## Seeds\n\nCells (mission, threshold, noise power) by the number of seeds that this \
         page has of each learner.\n\n| learner | one seed | two seeds | three or more | runs | \
         of them stored |\n|---|---|---|---|---|---|\n",
    );
    for learner in LEARNERS {
        let of_learner = || rows.iter().filter(move |row| row.approach == learner);
        let cells = |is: fn(usize) -> bool| of_learner().filter(|row| is(row.runs)).count();
        let runs: usize = of_learner().map(|row| row.runs).sum();
        let stored: usize = of_learner().map(|row| row.stored).sum();
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {runs} | {stored} |",
            learner.title(),
            cells(|runs| runs == 1),
            cells(|runs| runs == 2),
            cells(|runs| runs > 2),
        );
    }
    text
}

/// Returns the heading of a column of totals. It says if the whole column was read from a table.
fn heading<'a>(approach: Approach, mut rows: impl Iterator<Item = &'a TotalRow>) -> String {
    let title = approach.title();
    match rows.all(|row| row.approach != approach || row.stored == row.runs) {
        true => format!("{title} (stored)"),
        false => title.into(),
    }
}

const STORED_BOUNDS: &str = "\n\"(stored)\": the column is read from a table and not computed with this page. \
                             `search` and `certified bound` are in\n`models/bounds.csv`; \
                             `host-sim experiment bounds --fresh` computes them again.\n";

/// Returns a table of every approach as a fraction of the certified bound.
fn optimality(rows: &[TotalRow]) -> String {
    let compared = [Approach::Search]
        .into_iter()
        .chain(LEARNERS)
        .chain([Approach::AnyMission, Approach::StraightLine]);
    let compared: Vec<Approach> = compared.collect();
    let mut text = format!(
        "\n## Optimality\n\nTotal rates, and in brackets the fraction of the certified bound \
         (`docs/bound.md`), which no mission exceeds.\n\n| topology | dBm | Gamma | {} |",
        heading(Approach::Bound, rows.iter())
    );
    for &approach in &compared {
        let _ = write!(text, " {} |", heading(approach, rows.iter()));
    }
    let columns = 4 + compared.len();
    let _ = writeln!(text, "\n{}|", "|---".repeat(columns));
    for bound in rows.iter().filter(|row| row.approach == Approach::Bound) {
        let _ = write!(
            text,
            "| {} | {} | {:.3} | {:.2} |",
            bound.topology.name(),
            bound.noise_dbm,
            bound.mse_threshold,
            bound.sum_rate
        );
        for &approach in &compared {
            let mut of_approach = rows.iter().filter(|row| row.approach == approach);
            text += &match of_approach.find(|row| row.is_of_mission(bound)) {
                None => " |".to_owned(),
                Some(row) => {
                    let share = 100.0 * row.sum_rate / bound.sum_rate;
                    format!(" {} ({share:.1} %){} |", rate(row), seeds(row))
                }
            };
        }
        text.push('\n');
    }
    text += &any_mission(rows);
    if rows.iter().any(|row| row.stored > 0) {
        text += STORED_BOUNDS;
    }
    text
}

/// Compares the policy for any mission with those that were trained for the missions.
fn any_mission(rows: &[TotalRow]) -> String {
    let mut above = 0;
    let mut shares = Vec::new();
    for any in rows
        .iter()
        .filter(|row| row.approach == Approach::AnyMission)
    {
        let rate = |approach| {
            let mut of_mission = rows.iter().filter(|row| row.is_of_mission(any));
            Some(of_mission.find(|row| row.approach == approach)?.sum_rate)
        };
        if let (Some(tuned), Some(table_one)) =
            (rate(Approach::SacTuned), rate(Approach::SacTableOne))
        {
            above += usize::from(any.sum_rate > table_one);
            shares.push(any.sum_rate / tuned);
        }
    }
    if shares.is_empty() {
        return String::new();
    }
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    format!(
        "\nThe policy for any mission (`models/any.onnx`) was trained on none of these missions. It is above the \
         mean of SAC\nwith Table I's settings, trained for the very mission, in {above} of {} cells, and has \
         {:.1} % of the total of tuned SAC\non average.\n",
        shares.len(),
        100.0 * mean
    )
}

fn rate(row: &TotalRow) -> String {
    match row.interval_95 {
        Some(half) => format!("{:.2} ± {half:.2}", row.sum_rate),
        None => format!("{:.2}", row.sum_rate),
    }
}

/// Returns the number of seeds of a learner, and how many of them are stored.
fn seeds(row: &TotalRow) -> String {
    match (row.approach.learner(), row.stored) {
        (None, _) => String::new(),
        (Some(_), 0) => format!(", n {}", row.runs),
        (Some(_), stored) => format!(", n {} ({stored} stored)", row.runs),
    }
}

/// Returns a table of the totals of a figure: a row per mission, a column per approach.
fn totals(rows: &[TotalRow]) -> String {
    let mut approaches: Vec<Approach> = Vec::new();
    for row in rows {
        if !approaches.contains(&row.approach) {
            approaches.push(row.approach);
        }
    }
    let mut text = String::from("\n| topology | s | dBm | Gamma |");
    for &approach in &approaches {
        let _ = write!(text, " {} |", heading(approach, rows.iter()));
    }
    let _ = writeln!(
        text,
        "\n|---|---|---|---|{}",
        "---|".repeat(approaches.len())
    );
    for mission in rows.chunk_by(TotalRow::is_of_mission) {
        let first = &mission[0];
        let _ = write!(
            text,
            "| {} | {} | {} | {:.3} |",
            first.topology.name(),
            first.mission_time_s,
            first.noise_dbm,
            first.mse_threshold
        );
        for row in mission {
            let missed = match row.missed_slots {
                0.0 => String::new(),
                slots => format!(", {slots:.0} missed"),
            };
            let _ = write!(text, " {}{}{missed} |", rate(row), seeds(row));
        }
        text.push('\n');
    }
    if rows.iter().any(|row| row.missed_slots > 0.0) {
        text += "\n\"missed\": slots in which Gamma could not be met; their rate is 0.\n";
    }
    if rows
        .iter()
        .any(|row| row.approach == Approach::Bound && row.stored > 0)
    {
        text += STORED_BOUNDS;
    }
    text
}

/// Returns the relative path from one directory to another, with a slash at the end; empty if they
/// are the same.
fn relative(from: &Path, to: &Path) -> String {
    let parts = |path: &Path| -> Vec<String> {
        let named = path.components().filter(|part| *part != Component::CurDir);
        named
            .map(|part| part.as_os_str().to_string_lossy().into_owned())
            .collect()
    };
    let (from, to) = (parts(from), parts(to));
    let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n("..", from.len() - common);
    let down = to[common..].iter().map(String::as_str);
    up.chain(down).map(|part| format!("{part}/")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawings_are_linked_from_where_the_page_lies() {
        let link = |from: &str, to: &str| relative(Path::new(from), Path::new(to));
        assert_eq!(link("docs", "docs/figures"), "figures/");
        assert_eq!(link("docs", "./docs/figures"), "figures/");
        assert_eq!(link("a/b", "a/c"), "../c/");
        assert_eq!(link("", ""), "");
    }
}
