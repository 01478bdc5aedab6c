//! Model cards: a description of a shipped policy and of its training, and its learning curve as SVG.

use std::fmt::Write as _;

use figures::markup::element;

use crate::{
    checkpoint::{Evaluated, Progress},
    compare::References,
    metrics::{EVALUATION, Row},
};

/// Returns the model card in Markdown. `name` is the stem of the files' names, and `command` is the
/// command that trained the policy.
pub fn markdown(
    name: &str,
    command: &str,
    progress: &Progress,
    best: &Evaluated,
    references: &References,
) -> String {
    let s = &progress.settings;
    let rate = best.flight.sum_rate;
    let compared = |other: f64| format!("{other:.3} (policy: {:.1} % of it)", 100.0 * rate / other);
    let rows = [
        ("Scenario", progress.scenario.clone()),
        ("Scenario digest", format!("`{}`", progress.scenario_digest)),
        ("Made by", format!("`{command}`")),
        ("Algorithm", s.algorithm.name().to_uppercase()),
        ("Seed", s.seed.to_string()),
        (
            "Episodes, slots",
            format!("{}, {}", progress.episode, progress.global_step),
        ),
        ("Kept after episode", best.episode.to_string()),
        (
            "Total rate",
            format!(
                "**{rate:.3}** bit/s/Hz over {} slots",
                best.flight.path_m.len()
            ),
        ),
        ("Straight line", compared(references.straight_line)),
        ("Search", compared(references.search)),
        ("No mission has more than", compared(references.bound)),
        (
            "Constraints",
            format!(
                "arrived: {}, fair: {}, slots over Gamma: {}",
                yes(best.flight.arrived),
                yes(best.flight.fair),
                best.flight.mse_violations
            ),
        ),
        (
            "Slots in which the shield acted",
            best.flight.shield_interventions.to_string(),
        ),
    ];
    let mut card = format!("# {name}\n\n| | |\n|---|---|\n");
    for (key, value) in rows {
        // Writing to a string cannot fail.
        let _ = writeln!(card, "| {key} | {value} |");
    }
    let _ = write!(
        card,
        "\nThe same command writes the same bytes, with any of the vector instructions that \
         docs/training.md names.\nSearch and bound are those of `host-sim bound`. The shield acts in most slots because steps are asked for in a \
         square and cut to the speed disc, and because\nusers that have had their slots are \
         passed over.\n\n![Learning curve]({name}.svg)\n"
    );
    card
}

/// Returns "yes" or "no".
fn yes(is: bool) -> &'static str {
    if is { "yes" } else { "no" }
}

/// Width of the drawing, pixels.
const WIDTH: f64 = 640.0;
/// Height of the drawing, pixels.
const HEIGHT: f64 = 320.0;
/// Margin around the axes, pixels.
const MARGIN: f64 = 48.0;
/// Number of episodes that a point of the curve averages over.
const WINDOW: usize = 40;

/// Returns the learning curve as SVG: the sum rate over episodes, with exploration (means over 40
/// episodes) and of the deterministic policy.
pub fn learning_curve(rows: &[Row], references: &References) -> String {
    let explored: Vec<(f64, f64)> = rows
        .chunks(WINDOW)
        .map(|rows| {
            let sum: f64 = rows
                .iter()
                .filter_map(|row| row.get("charts/sum_rate"))
                .sum();
            (
                f64::from(rows[rows.len() - 1].episode),
                sum / rows.len() as f64,
            )
        })
        .collect();
    let evaluated: Vec<(f64, f64)> = rows
        .iter()
        .filter_map(|row| Some((f64::from(row.episode), row.get(EVALUATION)?)))
        .collect();
    let last = explored.last().map_or(1.0, |point| point.0);
    let levels = explored.iter().chain(&evaluated).map(|point| point.1);
    let levels = levels.chain([references.straight_line, references.search]);
    let (low, high) = levels.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), y| {
        (low.min(y), high.max(y))
    });
    let (low, high) = (low.floor(), high.ceil().max(low.floor() + 1.0));
    let x = |episode: f64| MARGIN + episode / last * (WIDTH - 2.0 * MARGIN);
    let y = |rate: f64| HEIGHT - MARGIN - (rate - low) / (high - low) * (HEIGHT - 2.0 * MARGIN);
    let line = |points: &[(f64, f64)], color: &'static str| {
        let points: Vec<String> = points
            .iter()
            .map(|point| format!("{:.1},{:.1}", x(point.0), y(point.1)))
            .collect();
        element("polyline")
            .set("fill", "none")
            .set("stroke", color)
            .set("points", points.join(" "))
    };
    let text = |x: f64, y: f64, anchor: &'static str, words: String| {
        element("text")
            .set("x", format!("{x:.0}"))
            .set("y", format!("{y:.0}"))
            .set("text-anchor", anchor)
            .text(words)
    };
    let level = |rate: f64, dashes: &'static str| {
        line(&[(0.0, rate), (last, rate)], "#888").set("stroke-dasharray", dashes)
    };
    let name = |rate: f64, words: &str| text(x(last), y(rate) - 4.0, "end", words.into());
    let (straight_line, search) = (references.straight_line, references.search);
    let svg = element("svg")
        .set("xmlns", "http://www.w3.org/2000/svg")
        .set("viewBox", format!("0 0 {WIDTH} {HEIGHT}"))
        .set("font-family", "sans-serif")
        .set("font-size", "12")
        .with(
            element("rect")
                .set("width", WIDTH.to_string())
                .set("height", HEIGHT.to_string())
                .set("fill", "white"),
        )
        .with(line(&[(0.0, high), (0.0, low), (last, low)], "black"))
        .with_all(
            [low, high].map(|rate| text(MARGIN - 6.0, y(rate) + 4.0, "end", rate.to_string())),
        )
        .with(text(
            x(last),
            HEIGHT - MARGIN + 16.0,
            "end",
            last.to_string(),
        ))
        .with(text(WIDTH / 2.0, HEIGHT - 12.0, "middle", "episode".into()))
        .with(text(
            MARGIN,
            MARGIN - 24.0,
            "start",
            "total rate, bit/s/Hz".into(),
        ))
        .with(level(straight_line, "2 4"))
        .with(name(straight_line, "straight line"))
        .with(level(search, "6 4"))
        .with(name(search, "search"))
        .with(line(&explored, "#9ab").set("stroke-width", "1.5"))
        .with(line(&evaluated, "#c40").set("stroke-width", "1.2"))
        .with(text(
            x(last),
            HEIGHT - MARGIN - 24.0,
            "end",
            "blue: exploring; red: deterministic".into(),
        ));
    svg.to_string()
}
