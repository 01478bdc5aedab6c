//! The reports on all figures: `index.html`, `docs/results.md`, the table of `docs/bound.md` and
//! the cards of shipped policies. Everything is derived from the CSV files and from the policies.

use std::{
    fmt::{Display, Write as _},
    path::{Component, Path, PathBuf},
};

use super::{
    Experiment, ExperimentContext,
    cell::{Cell, Learner, Training},
    claims::{Claim, Verdict},
    context::BoundRow,
    table,
    totals::{Approach, TotalRow},
};
use crate::policy::{HostPolicy, PolicyChoice};
use environment::Allocation;
use figures::{
    document,
    markup::{Element, element},
};

/// Draws a figure next to its CSV file, as `NAME.svg`.
///
/// # Errors
/// Returns an error if the CSV file is missing or the directory cannot be written.
pub fn write_drawing(experiment: Experiment, directory: &Path) -> Result<(), String> {
    let svg = experiment.draw(directory)?;
    table::write_text(&directory.join(format!("{}.svg", experiment.name())), &svg)
}

/// Writes `index.html` with all figures: self-contained, each with the paper's claims and the
/// verdicts.
///
/// # Errors
/// Returns an error if a CSV file is missing or the directory cannot be written.
pub fn write_index(directory: &Path) -> Result<(), String> {
    let head = element("head")
        .with(element("meta").set("charset", "utf-8"))
        .with(
            element("meta")
                .set("name", "viewport")
                .set("content", "width=device-width"),
        )
        .with(element("title").text(TITLE))
        .with(element("style").verbatim(STYLE));
    let mut body = element("body")
        .with(element("h1").text(TITLE))
        .with(element("p").text(
            "Under each drawing: what the paper claims of it, whether these numbers show it, and \
             the numbers. Learners are compared only within a preset of the trainer: tuned, or \
             the paper's Table I. Drawn and judged from the CSV files beside this page.",
        ));
    for experiment in Experiment::ALL {
        body.push(element("h2").text(experiment.title()));
        body.push(inline(&experiment.draw(directory)?, experiment.name()));
        let claims = experiment.claims(directory)?.into_iter();
        body.push(element("dl").with_all(claims.flat_map(entries)));
    }
    let page = element("html").set("lang", "en").with(head).with(body);
    table::write_text(
        &directory.join("index.html"),
        &format!("<!DOCTYPE html>\n{page}\n"),
    )
}

const TITLE: &str = "The paper's figures, measured";
const STYLE: &str = ":root{color-scheme:light dark}\
                     body{max-width:82rem;margin:2rem auto;padding:0 1rem;font:16px/1.5 sans-serif}\
                     p,dl{max-width:56rem}figure{margin:0;overflow-x:auto}\
                     svg{max-width:100%;height:auto;border:1px solid #ddd;background:#fff}\
                     h2{margin-top:3rem}dt{margin-top:.8rem}dd{margin-left:1.5rem}\
                     b{display:inline-block;min-width:4.5rem}\
                     @media screen and (max-width:84rem){svg{max-width:none}}\
                     @media print{figure,dt,dd{break-inside:avoid}h2,dt{break-after:avoid}\
                     h2{margin-top:1.5rem}}";

/// Returns a claim with its verdict, and the measured numbers.
fn entries(claim: Claim) -> [Element; 2] {
    [
        element("dt")
            .with(element("b").text(claim.verdict.to_string()))
            .text(format!(" {}", claim.claimed)),
        element("dd").text(format!("{} {}", claim.measured, claim.reason)),
    ]
}

/// Returns a drawing that scales with the page: its size becomes its view box.
fn inline(svg: &str, name: &str) -> Element {
    let start = svg.find("<svg").unwrap_or(0);
    let label = format!("<svg role=\"img\" aria-label=\"{name}\"");
    element("figure").verbatim(svg[start..].replacen("<svg", &label, 1))
}

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
         settings, seed 1, trained for the\n  very mission that it flies; for a mission without \
         such a policy it is the onboard planner.\n\
         * SAC and DDPG are each trained with two presets of the trainer: `tuned`, the best \
         settings found for SAC, which go\n  beyond the paper's Alg. 2 (docs/training.md), and \
         `paper`, written \"Table I\". Learners are compared only within a\n  preset. Every \
         policy is trained for the mission that it flies.\n\
         * n is the number of seeds. From three seeds on, the mean is given with its 95 % \
         interval (Student's t); below that\n  there is no interval. The policies of seed 1 \
         are flown; \"stored\" counts the runs whose totals are read from\n  \
         `models/seeds.csv`, which `host-sim experiment seeds` wrote when it flew them.\n\
         * The figures of single flights, and those with something held fixed, show seed 1 \
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
        .chain([Approach::StraightLine]);
    let compared: Vec<Approach> = compared.collect();
    let mut text = format!(
        "\n## Optimality\n\nTotal rates, and in brackets the fraction of the certified bound \
         (`docs/bound.md`): no mission has more than the bound.\n\n| topology | dBm | Gamma | {} |",
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
    if rows.iter().any(|row| row.stored > 0) {
        text += STORED_BOUNDS;
    }
    text
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
        text += "\n\"missed\": slots in which Gamma could not be met; they carry nothing.\n";
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

/// Writes the table of bounds between the markers of a page.
///
/// # Errors
/// Returns an error if the page cannot be read, has no markers `bounds`, or cannot be written.
pub fn write_bounds(rows: &[BoundRow], path: &Path) -> Result<(), String> {
    let mut body = String::from(
        "| scenario | T, s | noise, dBm | Gamma | upper | lower | gap | seconds | processor s |\n\
         |---|---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let _ = writeln!(
            body,
            "| {} | {} | {} | {:.3} | {:.4} | {:.4} | {:.3} % | {:.1} | {:.1} |",
            row.topology.name(),
            row.mission_time_s,
            row.noise_dbm,
            row.mse_threshold,
            row.upper,
            row.lower,
            100.0 * (row.upper - row.lower) / row.upper,
            row.seconds,
            row.processor_seconds
        );
    }
    document::write_table(path, "bounds", &body)
}

/// Writes the card of all available policies of the figures' cells: how each was trained, and its
/// result when it is flown.
///
/// # Errors
/// Returns an error if a policy cannot be loaded, does not fit or cannot be flown, or if a file
/// cannot be written.
pub fn write_cards(context: &mut ExperimentContext<'_>, path: &Path) -> Result<(), String> {
    let mut text = String::from(
        "# Policies of the figures\n\n\
         Written by `host-sim experiment cards`, which flies every policy here on its mission \
         (controller, links, ideal vehicle).\nA file's name says how it was made: topology, \
         mission time in seconds, noise in minus dBm, Gamma, algorithm, preset,\nseed; so \
         `separated-t60-n95-g0.010-sac-tuned-s1.onnx` is `policy.onnx` of\n\n    \
         trainer train --scenario separated --mse-threshold 0.01 --algorithm sac --preset tuned \
         --seed 1\n\nand `host-sim experiment --train` makes any of them with these arguments. \
         For other times and noise powers the scenario\nis the shipped one with `slots` and \
         `noise_dbm` changed. 4,000 episodes each; the best of the evaluations every 20\nepisodes \
         is kept, after the episode in the table. Input, outputs and metadata: \
         docs/training.md. Every policy is for its own\nmission alone: another threshold or \
         noise power is another optimum.\n\n\
         | policy | scenario digest | kept after | total rate | of the bound | straight line | \
         arrived, fair | slots over Gamma | shield acted |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    let seeds = context.settings().seeds;
    for cell in Cell::all() {
        for learner in Learner::ALL {
            for seed in 1..=seeds {
                let training = Training::new(cell, learner, seed);
                if let Some(file) = context.find(&training) {
                    let row = card(context, &training, file)?;
                    let _ = writeln!(text, "{row}");
                }
            }
        }
    }
    table::write_text(path, &text)
}

fn card(
    context: &mut ExperimentContext<'_>,
    training: &Training,
    file: PathBuf,
) -> Result<impl Display + use<>, String> {
    let cell = &training.cell;
    let choice = PolicyChoice::File(file);
    let (policy, _) = HostPolicy::load(&choice, &cell.scenario()?)?;
    let provenance = policy.provenance();
    let kept = provenance.map_or(0, |provenance| provenance.episodes);
    let flown = context.fly(cell, &choice, Allocation::Exact)?.summary();
    let digest = provenance.map_or("", |provenance| &provenance.scenario_digest);
    if digest != flown.scenario_digest {
        return Err(format!(
            "{training}.onnx was trained on another mission than its name says"
        ));
    }
    let line = context.fly(cell, &PolicyChoice::StraightLine, Allocation::Exact)?;
    let bound = context.bound(cell)?;
    let yes = |is: bool| if is { "yes" } else { "no" };
    Ok(format!(
        "| {training} | `{}` | {kept} | {:.3} | {:.1} % | {:.3} | {}, {} | {} | {} |",
        &digest[..12.min(digest.len())],
        flown.sum_rate,
        100.0 * flown.sum_rate / bound.upper,
        line.summary().sum_rate,
        yes(flown.arrived),
        yes(flown.fair),
        flown.mse_violations,
        flown.shield_interventions,
    ))
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
